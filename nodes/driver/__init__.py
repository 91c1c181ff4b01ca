"""The driver: the clock of the loop, the device behind it, and the safety in front of it."""
