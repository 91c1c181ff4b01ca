"""Shapes to touch in three dimensions, and the proxy on them: geometry as plain functions on tables of floats."""
