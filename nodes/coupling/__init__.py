"""The coupling: renders a law over the history of deflections, and swaps laws between two ticks."""
