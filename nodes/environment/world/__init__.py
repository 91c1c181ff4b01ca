"""A world of one body to feel: mass, spring and damper to ground, by integrators that answer in the same tick or later."""
