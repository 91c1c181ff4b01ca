"""The player: a scene in one process, with the rules of the nodes."""
