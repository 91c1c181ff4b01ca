"""The player: runs a scene in one process, by the rules of the nodes."""
