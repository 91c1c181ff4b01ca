"""Fault injection on real processes, and evaluation of the loop's response."""
