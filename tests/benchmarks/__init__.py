"""Benchmarks of kernels, run once by default; with ``pytest -n 0 tests/benchmarks --benchmark-enable`` they are timed."""
