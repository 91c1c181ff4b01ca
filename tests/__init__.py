"""Tests of haptic-nodes."""
