"""What every node is built on: its process, its loop, its control thread, its words."""
