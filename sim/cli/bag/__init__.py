"""What `haptic bag` can do with the simulation at hand."""
