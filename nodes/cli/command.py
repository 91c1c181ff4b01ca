"""The command ``haptic``: imports the command line; exits quietly if interrupted early."""

import gc
import os
import signal
import sys


def main() -> int:
    """Import the command line and run it."""
    # A loop's matrices are small: BLAS threads only wait for each other, taking five times the
    # processor time, also beside the loop. Child processes inherit the setting; users can override
    # it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Imported objects live until the end; collecting after every 700 of them takes a tenth of most
    # verbs' time.
    gc.set_threshold(100_000)
    # During the import, some tenths of a second, Ctrl-C would print a traceback.
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    from nodes.cli.main import main as run

    try:
        signal.signal(signal.SIGINT, before)
        code = run()
    except KeyboardInterrupt:
        # Ctrl-C before the verb handles it, or after its end.
        code = 130
    finally:
        # No cleanup is left: from here a signal ends the process silently.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Skip the collection at exit.
    gc.freeze()
    return code


if __name__ == "__main__":
    sys.exit(main())
