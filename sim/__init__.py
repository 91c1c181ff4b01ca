"""What replaces reality, and what studies it: virtual device, sim driver, one-process loop, stability studies."""
