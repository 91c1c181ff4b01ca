"""The entry of a node's process: ``python -m nodes SETUP_FILE``."""

import signal
import sys
from types import FrameType


def _end(number: int, frame: FrameType | None) -> None:
    """End quietly while the node is still being imported; later it has handlers of its own."""
    del frame
    sys.exit(128 + number)


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _end)
    from nodes.base.process import start

    sys.exit(start(sys.argv[1:]))
