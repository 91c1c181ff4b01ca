"""Benchmarks: the verb `haptic bench`, one benchmark a file."""
