"""Laws designed for a device and its delay."""
