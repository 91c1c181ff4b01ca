"""Parameters of a node: typed and validated, changed all or nothing, read from and written to YAML."""
