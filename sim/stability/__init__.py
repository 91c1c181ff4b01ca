"""Stability that no launch judges: sequences of delays, rest, two hands, two rates."""
