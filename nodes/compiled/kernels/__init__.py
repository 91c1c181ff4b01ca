"""Kernels of the tick; imported only for compiling, because they need numba."""
