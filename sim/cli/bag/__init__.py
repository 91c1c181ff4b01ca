"""Sub-verbs of `haptic bag` that need the simulation."""
