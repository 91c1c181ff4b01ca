"""Speeds measured: the bare loop as a yardstick, taps, pictures of the page, scenes, the simulator."""
