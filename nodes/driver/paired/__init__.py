"""Two devices, coupled position to position by one law."""
