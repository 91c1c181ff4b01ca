"""Worker processes on this machine, which never outlive the process that started them.

Each has a pipe, and a thread here that feeds it. A terminal sends Ctrl-C to all of them. The signal
is blocked from the start of a worker, because a handler of its own would come too late; the parent
decides whether to end the workers or to let them finish. If one dies, nothing is lost: another
repeats its job. The standard library's pool fails as a whole when a worker dies, and its workers
answer a Ctrl-C in their first seconds with tracebacks.
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

TRIES = 4  # workers that try a job, one after another, if they die


@contextlib.contextmanager
def _later() -> Iterator[None]:
    """Defer Ctrl-C until the block ends; processes started in it never get it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Worker(NamedTuple):
    process: subprocess.Popen[bytes]
    pipe: Connection


class Workers(Executor):
    """Up to `count` processes, started on demand; an exception in a with block ends them."""

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(count, "worker")
        self._own = threading.local()
        self._starting = threading.Lock()
        self._there: list[_Worker] = []
        self._over = False

    def submit(
        self, work: Callable[P, R], /, *args: P.args, **options: P.kwargs
    ) -> Future[R]:
        """Run `work`, a function of a module, with picklable arguments in a worker."""
        packed = pickle.dumps((work, args, options))
        with _later():
            # inherited by a thread started here, and by its worker
            return self._threads.submit(self._done, packed)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait until all submitted jobs are done, and end the workers."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            self.end()

    def end(self) -> None:
        """Kill the workers."""
        with _later():
            with self._starting:
                self._over = True
                for worker in self._there:
                    if worker.process.returncode is None:
                        os.kill(worker.process.pid, signal.SIGKILL)
            self._threads.shutdown(cancel_futures=True)
            for worker in self._there:
                worker.pipe.close()
                # Linux 6.18 was seen to take a minute to reap a dead process
                threading.Thread(
                    target=worker.process.wait, name="reap", daemon=True
                ).start()
            self._there.clear()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Wait for the workers; kill them after an exception, e.g. Ctrl-C."""
        if kind is None:
            self.shutdown()
        else:
            self.end()

    # -- on the threads --

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
                # Neither the module of -m nor the caller's script is run again: a worker imports
                # its job only.
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
                    # the JSON result of a command is the last line of standard output
                    stdout=sys.__stderr__,
                    pass_fds=(there.fileno(),),
                )
            worker = self._own.worker = _Worker(process, here)
            self._there.append(worker)
        with contextlib.suppress(OSError):
            # already gone: `_done` notices
            here.send(sys.path)
        return worker


def serve(pipe: Connection) -> None:
    """Run jobs from the pipe until it closes."""
    sys.path[:] = pipe.recv()
    while True:
        try:
            packed = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        try:
            # from the process that started this one
            work, args, options = pickle.loads(packed)  # noqa: S301
            answer = (True, work(*args, **options))
        except Exception as error:  # noqa: BLE001  # any exception belongs to the caller
            error.add_note("".join(traceback.format_exception(error)))
            answer = (False, error)
        try:
            pipe.send(answer)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            pipe.send(
                (False, TypeError(f"{answer[1]!r:.200} cannot be sent back: {error}"))
            )


def main() -> None:
    """Serve the parent process: ``python -m nodes.base.workers DESCRIPTOR PARENT``."""
    from nodes.base.realtime import die_with_parent

    die_with_parent(int(sys.argv[2]))
    with Connection(int(sys.argv[1])) as pipe:
        serve(pipe)


if __name__ == "__main__":
    main()
