"""The address at which a page is served, in a module that does not import the server."""

from __future__ import annotations

from nodes.parameters.store import ParameterError

ADDRESS = "127.0.0.1"  # the only address bound
# Host names used by a browser on this machine or behind an ssh tunnel.
LOCAL = ("127.0.0.1", "localhost")


def check_address(address: str, port: int) -> None:
    """Refuse any non-local address: whoever reaches the page can command the loop."""
    if address in LOCAL:
        return
    import getpass
    import socket

    shown = port or 8080
    raise ParameterError(
        f"{address} is refused: anyone who reaches the page can command the loop, so"
        f" it is served on {ADDRESS} only. From another machine, set view.port to {shown}, run ssh"
        f" -L {shown}:{ADDRESS}:{shown} {getpass.getuser()}@{socket.gethostname()} there, and open"
        " the printed URL",
        path="view.address",
    )
