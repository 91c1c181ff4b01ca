"""Transport of messages: endpoints, sockets, keys, authentication, requests and replies."""
