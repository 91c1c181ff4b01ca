"""Benchmarks of kernels; run once by default, timed with ``--benchmark-enable``.

``pytest -n 0 tests/benchmarks --benchmark-enable``
"""
