"""The tick's kernels. Only what compiles them imports this package: it needs numba, a node does not."""
