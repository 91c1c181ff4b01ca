"""The tick without the interpreter: environment, coupling and virtual driver as compiled functions on pyzmq's own sockets.

A compiled tick does what is usual and nothing else: receive, decode, the kernels that the plain tick calls too, encode, send.
Whatever is unusual (a message out of the ordinary, a request, a change of law, an error, the end) returns to the plain tick
with everything as the plain tick would have found it: messages already taken off the socket are put back. So there is one
meaning of a tick, and it is written in Python.

===================  ==================================================================================================
layout               What both sides of the border hold: structs, written once as ctypes.
fields               What the kernels know of a message, read from its type.
kernels/             The compiled functions; only a process that compiles them imports numba.
cache                Compiled code on disk: the user's own, whole, of today's sources.
build                Compiles them, once per version and processor, into the cache.
library              Loads them, and finds libzmq.
answering            The Python side: enters the compiled ticks of a node, and comes back.
choose               Which tick a launch takes.
===================  ==================================================================================================
"""
