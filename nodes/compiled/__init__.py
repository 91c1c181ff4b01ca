"""The tick without the interpreter: environment, coupling and virtual driver as compiled functions on pyzmq's own sockets.

A compiled tick does what is usual and nothing else: receive, decode, the kernels that the plain
tick calls too, encode, send. Whatever is unusual (a message out of the ordinary, a request, a
change of law, an error, the end) returns to the plain tick with everything as the plain tick would
have found it: messages already taken off the socket are put back. So there is one meaning of a
tick, and it is written in Python.
"""
