"""From an identified device to a law that was tried on it: design, predict, knock, and deliver what held."""
