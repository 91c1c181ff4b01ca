"""The one address at which a page is served; who only checks it does without the server."""

from __future__ import annotations

from nodes.parameters.store import ParameterError

ADDRESS = "127.0.0.1"  # the one address that is bound
# names under which a browser of this machine, or behind an ssh tunnel, asks for it
LOCAL = ("127.0.0.1", "localhost")


def check_address(address: str, port: int) -> None:
    """Refuse every address but this machine's own: who reaches the page can command the loop."""
    if address in LOCAL:
        return
    import getpass
    import socket

    shown = port or 8080
    raise ParameterError(
        f"view.address: {address} is refused: anyone who reaches the page can command the loop, so"
        f" it is served on {ADDRESS} only. From another machine, set view.port to {shown}, run ssh"
        f" -L {shown}:{ADDRESS}:{shown} {getpass.getuser()}@{socket.gethostname()} there, and open"
        " the printed URL"
    )
