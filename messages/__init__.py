"""What travels between the processes: message types, codec, topics and sockets (wire protocol: PROTOCOL.md)."""
