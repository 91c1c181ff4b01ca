"""Studies: the verb `haptic study`, one study a file."""
