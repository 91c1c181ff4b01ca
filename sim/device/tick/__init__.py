"""The virtual driver's tick without the interpreter: driver and device in one kernel. See nodes/tick."""
