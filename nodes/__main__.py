"""The entry of a node's process: ``python -m nodes SETUP_FILE LAUNCHER``."""

import gc
import signal
import sys

if __name__ == "__main__":
    # Before anything starts a thread: a signal that comes while the node is being imported waits
    # until the node heeds it.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM, signal.SIGHUP})
    # Until all is imported: what imports make stays, and looking through it again and again takes a
    # tenth of the start.
    gc.disable()
    from nodes.base.process import start
    from nodes.compiled.load import load_kernel

    sys.exit(start(sys.argv[1:], load_kernel))
