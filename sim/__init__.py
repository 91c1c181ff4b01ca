"""What replaces reality, and what studies it: virtual device, sim driver, the loop in one process, stability studies."""
