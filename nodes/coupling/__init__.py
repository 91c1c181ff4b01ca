"""The coupling: renders a law over the history of deflections; changes laws between ticks."""
