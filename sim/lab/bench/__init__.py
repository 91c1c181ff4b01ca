"""Benchmarks: bare loop, tap sums, page pictures, scenes and simulator."""
