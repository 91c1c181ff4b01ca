"""Emit the project's rules as JavaScript that gives the same bits."""
