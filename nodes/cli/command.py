"""The command ``haptic`` itself: quiet when it is interrupted before it can do anything."""

import signal
import sys


def main() -> int:
    """Import the command line and run it."""
    # Importing takes some tenths of a second, in which Ctrl-C would be answered with a traceback.
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    from nodes.cli.main import main as run

    signal.signal(signal.SIGINT, before)
    return run()


if __name__ == "__main__":
    sys.exit(main())
