"""Benchmarks of kernels, run once by default; with ``pytest tests/benchmarks --benchmark-enable`` they are timed."""
