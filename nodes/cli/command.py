"""The command ``haptic`` itself: quiet when it is interrupted before it can do anything."""

import gc
import os
import signal
import sys


def main() -> int:
    """Import the command line and run it."""
    # A loop's matrices are small: threads of the linear algebra only wait for each other, five
    # times the processor's time, and in a node they would do so beside the loop. Whoever wants them
    # says so; what a verb starts inherits it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # What imports make stays: looking through it after every 700 objects takes a tenth of the time
    # that most verbs take.
    gc.set_threshold(100_000)
    # Importing takes some tenths of a second, in which Ctrl-C would be answered with a traceback.
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    from nodes.cli.main import main as run

    try:
        signal.signal(signal.SIGINT, before)
        code = run()
    except KeyboardInterrupt:
        # Before the verb could take it, or behind its end.
        code = 130
    finally:
        # Nothing is left to be put in order: what comes now ends the process without a word.
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # It all ends now, without being looked through once more.
    gc.freeze()
    return code


if __name__ == "__main__":
    sys.exit(main())
