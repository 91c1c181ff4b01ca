"""Ticks without the interpreter: compiled functions on pyzmq's own sockets.

A compiled tick handles the usual case and nothing else: receive, decode, the kernels that the plain
tick calls too, encode, send. Every other case (an unusual message, a request, a change of law, an
error, the end) is handed back to the plain tick, which processes the message from scratch: messages
already received are put back. So there is one definition of a tick, written in Python.
"""
