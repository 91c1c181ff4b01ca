"""Loading compiled kernels, and finding the C functions that they call (libzmq, libc).

Sockets belong to the libzmq that made them, so it must be the very one that pyzmq has loaded:
beside its wheel, within its extension, or the system's.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import zmq

from nodes.compiled import cache
from nodes.compiled.build import ENTRY, find, reason
from nodes.compiled.message_fields import NotCompilableError

_ZMQ: Final = ("zmq_recv", "zmq_send", "zmq_getsockopt")
_LIBC: Final = ("clock_gettime", "clock_nanosleep", "ppoll", "sched_yield")

# maps the address of a node's state to the number of ticks done
Kernel: TypeAlias = Callable[[int], int]
_kept: list[Any] = []  # must live as long as its functions may be called


def library_of_pyzmq() -> str:
    """Return the path of the libzmq that pyzmq has loaded."""
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
        mapped = sorted(
            {line.split(maxsplit=5)[5].strip() for line in maps if ".so" in line}
        )
    candidates = [path for path in mapped if "zmq" in Path(path).name]
    for path in sorted(
        candidates, key=lambda path: not Path(path).name.startswith("libzmq")
    ):
        library = ctypes.CDLL(path)
        if all(hasattr(library, name) for name in (*_ZMQ, "zmq_version")):
            numbers = [ctypes.c_int() for _ in range(3)]
            library.zmq_version(*map(ctypes.byref, numbers))
            if tuple(number.value for number in numbers) == zmq.zmq_version_info():
                return path
    raise NotCompilableError(
        f"pyzmq's libzmq is not to be found among {', '.join(candidates) or 'what is loaded'}"
    )


def functions() -> dict[str, int]:
    """Return the addresses of the C functions that kernels call."""
    libzmq = ctypes.CDLL(library_of_pyzmq())
    libc = ctypes.CDLL(None)
    found = {}
    for library, names in ((libzmq, _ZMQ), (libc, _LIBC)):
        for name in names:
            found[name] = (
                ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0
            )
    return found


def _addresses(entry: cache.CacheEntry, names: Sequence[str]) -> list[int]:
    """Load a compiled entry and return the addresses of its functions."""
    if entry.kind == "so":
        library = cache.load(entry.content)
        _kept.append(library)
        return [
            ctypes.cast(library[name], ctypes.c_void_p).value or 0 for name in names
        ]
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(entry.content))
    engine.finalize_object()
    _kept.append(engine)
    return [engine.get_function_address(name) for name in names]


def obtain(module: str) -> Kernel:
    """Return a compiled kernel; it must exist, because compiling would delay the node."""
    return _kernel_at(*obtain_calls(module, (ENTRY,)))


def obtain_calls(module: str, names: Sequence[str]) -> list[int]:
    """Return the addresses of compiled functions; NotCompilableError if not available."""
    try:
        entry = find(module)
    except cache.CacheRefusedError as error:
        raise NotCompilableError(f"{module}: {error}") from error
    if failed := reason(entry):
        raise NotCompilableError(failed)
    if entry is None:
        raise NotCompilableError(
            f"{module} is not compiled on this machine; `haptic launch floor_drop --tick compiled`"
            " builds it once"
        )
    try:
        return _addresses(entry, names)
    except (OSError, ImportError, AttributeError, RuntimeError) as error:
        raise NotCompilableError(f"{module}: {error}") from error


def _kernel_at(address: int) -> Kernel:
    # numba's calling convention: address of the result, of the exception, and the argument
    function = ctypes.CFUNCTYPE(
        ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64
    )(address)
    result = ctypes.c_int64()
    error = ctypes.c_void_p()
    at = ctypes.addressof(result)
    message = ctypes.addressof(error)

    def call(state: int) -> int:
        if function(at, message, state):
            raise NotCompilableError("a kernel failed: see nodes/compiled")
        return result.value

    _kept.append((result, error))
    return call
