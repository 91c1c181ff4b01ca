"""Stopwatches and launches for measurements."""
