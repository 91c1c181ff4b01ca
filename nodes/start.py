"""The entry of a node's process: ``python -m nodes.start SETUP_FILE``."""

import sys

from nodes.base import start

if __name__ == "__main__":
    sys.exit(start(sys.argv[1:]))
