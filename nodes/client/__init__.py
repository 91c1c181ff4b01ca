"""A running launch, seen from outside: find it, know which node has which part, ask the nodes."""
