"""The verbs that nodes and recordings do not need: studies and benchmarks, one per file."""
