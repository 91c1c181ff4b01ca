"""Workers: processes of this machine that do what they are given, and never outlive who gave it.

Each has a pipe, and a thread here that feeds it. A terminal sends Ctrl-C to all of them. It is
blocked where a worker is started, and so in the worker from the first: a handler of its own would
come too late. Who asked for the work decides, and ends the workers at once or lets them finish. One
that dies loses nothing: another does what it was at. The standard library's pool is given up whole
when one dies, and its workers answer a Ctrl-C in their first seconds with tracebacks.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, ParamSpec, TypeVar

from messages.errors import RefusedError

P = ParamSpec("P")
R = TypeVar("R")

TRIES = 4  # to so many workers a job is given, one after another, when they die


@contextlib.contextmanager
def _later() -> Iterator[None]:
    """Let Ctrl-C come after this block; what is started in it never sees any."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Worker(NamedTuple):
    process: subprocess.Popen[bytes]
    pipe: Connection


class Workers(Executor):
    """Processes that are started when there is work, at most `count`; a with block that is left by an exception ends them."""

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(count, "worker")
        self._own = threading.local()
        self._starting = threading.Lock()
        self._there: list[_Worker] = []
        self._over = False

    def submit(self, work: Callable[P, R], /, *args: P.args, **options: P.kwargs) -> Future[R]:
        """Give work to a worker: a function of a module, by name, with what can be pickled."""
        packed = pickle.dumps((work, args, options))
        with _later():
            # The thread, which may be started here, and its worker inherit it.
            return self._threads.submit(self._done, packed)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let them finish what they were given, and go."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            self.end()

    def end(self) -> None:
        """End them now, whatever they are at."""
        with _later():
            with self._starting:
                self._over = True
                for worker in self._there:
                    if worker.process.returncode is None:
                        os.kill(worker.process.pid, signal.SIGKILL)
            self._threads.shutdown(cancel_futures=True)
            for worker in self._there:
                worker.pipe.close()
                # Linux 6.18 was seen to spend a minute on taking a dead process from its table.
                threading.Thread(target=worker.process.wait, name="reap", daemon=True).start()
            self._there.clear()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Wait for them; after an exception, Ctrl-C for one, nobody wants their answers."""
        if kind is None:
            self.shutdown()
        else:
            self.end()

    # -- on the threads
    # ----------------------------------------------------------------------------------------------

    def _done(self, packed: bytes) -> Any:
        ended = 0
        for _ in range(TRIES):
            if self._over:
                raise RefusedError("the workers were ended")
            worker: _Worker = getattr(self._own, "worker", None) or self._start()
            try:
                worker.pipe.send_bytes(packed)
                good, answer = worker.pipe.recv()
            except (EOFError, OSError):
                self._own.worker = None
                ended = 0 if self._over else worker.process.wait()
                continue
            if good:
                return answer
            raise answer
        how = signal.Signals(-ended).name if ended < 0 else f"exit code {ended}"
        raise RefusedError(
            f"{TRIES} workers, one after another, ended with {how} at the same job: memory most"
            " often"
        )

    def _start(self) -> _Worker:
        with self._starting:
            if self._over:
                raise RefusedError("the workers were ended")
            here, there = Pipe()
            with there:
                # Neither -m's module nor the caller's script is run again: a worker imports what it
                # is given.
                process = subprocess.Popen(
                    [
                        sys.executable,
                        "-P",
                        "-m",
                        "nodes.base.workers",
                        str(there.fileno()),
                        str(os.getpid()),
                    ],
                    stdin=subprocess.DEVNULL,
                    # An answer in JSON is the last line of standard output.
                    stdout=sys.__stderr__,
                    pass_fds=(there.fileno(),),
                )
            worker = self._own.worker = _Worker(process, here)
            self._there.append(worker)
        with contextlib.suppress(OSError):
            # Gone already: `_done` sees it.
            here.send(sys.path)
        return worker


def serve(pipe: Connection) -> None:
    """Do what comes, until nobody is left who sends."""
    sys.path[:] = pipe.recv()
    while True:
        try:
            packed = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        try:
            work, args, options = pickle.loads(packed)  # noqa: S301  # from who started this process
            answer = (True, work(*args, **options))
        except Exception as error:  # noqa: BLE001  # whatever it is, it is the caller's
            error.add_note("".join(traceback.format_exception(error)))
            answer = (False, error)
        try:
            pipe.send(answer)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            pipe.send((False, TypeError(f"{answer[1]!r:.200} cannot be sent back: {error}")))


def main() -> None:
    """Serve who started this process: ``python -m nodes.base.workers DESCRIPTOR PARENT``."""
    from nodes.base.realtime import die_with_parent

    die_with_parent(int(sys.argv[2]))
    with Connection(int(sys.argv[1])) as pipe:
        serve(pipe)


if __name__ == "__main__":
    main()
