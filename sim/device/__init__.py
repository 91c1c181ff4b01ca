"""The virtual device: its model, its state, its driver."""
