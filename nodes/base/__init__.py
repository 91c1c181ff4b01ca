"""Base of every node: its process, loop, control thread and reports."""
