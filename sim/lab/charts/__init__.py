"""Charts of speed against accuracy."""
