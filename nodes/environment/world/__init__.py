"""A world of one body (mass, spring and damper to ground) with a choice of integrators."""
