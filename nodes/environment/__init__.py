"""The environment: surfaces, and the nodes that find the proxy on them."""
