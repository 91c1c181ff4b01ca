"""The first hour with a real device: what is found, what it is, whether it moves and pushes rightly, setting it free."""
