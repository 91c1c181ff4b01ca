"""Parameters of a node: typed, validated, changed all or nothing, stored as YAML."""
