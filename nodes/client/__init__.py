"""Client of a running launch: find it, know its nodes, send them requests."""
