"""Messages between processes: types, codec, topics, sockets (wire protocol: PROTOCOL.md)."""
