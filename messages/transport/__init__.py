"""How messages travel: endpoints, sockets, keys, the gate that authenticates, requests and replies."""
