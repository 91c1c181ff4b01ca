"""Faults provoked on real processes, and what the loop makes of them."""
