"""Virtual device, sim driver, one-process loop and stability studies."""
