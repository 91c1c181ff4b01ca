"""First checks of a real device: find it, identify it, test axes and forces, free it."""
