"""A whole scene in one process: the loop of the nodes, compiled."""
