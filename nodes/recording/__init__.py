"""Recordings: write, read, recover, export, replay and plot them."""
