"""The environment: surfaces, and the node that finds the proxy on them."""
