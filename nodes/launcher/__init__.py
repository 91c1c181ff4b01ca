"""Starts the nodes of a launch file, watches over them, and ends them."""
