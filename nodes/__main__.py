"""Entry point of a node's process: ``python -m nodes SETUP_FILE LAUNCHER``."""

import gc
import signal
import sys

if __name__ == "__main__":
    # Before any thread starts: signals during the import wait until the node handles them.
    signal.pthread_sigmask(
        signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    )
    # Imported objects stay, and collecting again and again takes a tenth of the start-up.
    gc.disable()
    from nodes.base.process import start
    from nodes.compiled.load import load_kernel

    sys.exit(start(sys.argv[1:], load_kernel))
