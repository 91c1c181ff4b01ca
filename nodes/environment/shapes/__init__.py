"""Shapes in three dimensions and their proxy: geometry as plain functions on floats."""
