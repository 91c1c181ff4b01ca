"""Command line of ``haptic``: one module per verb."""
