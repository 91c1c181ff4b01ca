"""Compiling the ticks, once, into the cache of compiled code: a node that ticks needs neither numba nor its memory.

numba makes a kernel from the functions that the plain tick calls, and LLVM writes it as an object file. Where the machine has
a linker it becomes a shared library, which costs a node nothing; otherwise llvmlite loads the object file. In a process of its
own, which compiles one kernel after the other, with ``--idle`` only what is missing and when nothing else has to be done::

    python -m nodes.compiled.build [--idle] MODULE...
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from nodes.compiled import cache
from nodes.compiled.message_fields import NotCompilableError

ENTRY: Final = "haptic_tick"  # name of a kernel in its file
TIMEOUT: Final = 300.0  # how long compiling may take [s]; about ten seconds are usual
_LINKERS: Final = ("cc", "gcc", "clang")
_FAILED: Final = "Failed in nopython mode pipeline"


def find(module: str) -> cache.CacheEntry | None:
    """Find a kernel compiled from what is installed now; CacheRefusedError when it would not be this user's own."""
    return cache.read(f"{module}.tick")


def reason(entry: cache.CacheEntry | None) -> str:
    """Say why a kernel cannot be compiled here, as it turned out in the background; empty for one that can."""
    return entry.content.decode() if entry is not None and entry.kind == "failed" else ""


def build_in_background(modules: Sequence[str]) -> None:
    """Compile kernels when nobody else wants the processor, in a process that outlives this one."""
    nothing = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_RDWR, 0) for stream in range(3)]
    command = [sys.executable, "-m", "nodes.compiled.build", "--idle", *modules]
    os.posix_spawn(sys.executable, command, os.environ, file_actions=nothing, setsid=True)


def build(modules: Sequence[str]) -> None:
    """Compile kernels, each in a process of its own."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "nodes.compiled.build", module],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for module in modules
    ]
    failed = ""
    for module, process in zip(modules, processes, strict=True):
        try:
            _, errors = process.communicate(timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            errors = f"not compiled within {TIMEOUT:g} s"
        if process.returncode:
            lines = errors.strip().splitlines() or [f"the compiler ended with exit code {process.returncode}"]
            failed = failed or f"{module}: {lines[-1]}"
    if failed:
        raise NotCompilableError(failed)


# -- in the process that compiles ------------------------------------------------------------------------------------


def _by_c(name: str, made: str, signature: str) -> str:
    """Write a function with C's way of calling around one of numba's, which takes where its result and an error go first."""
    kinds = ["double" if kind == "float64" else "i64" for kind in signature[:-1].split("(")[1].split(",")]
    given = ", ".join(f"{kind} %a{n}" for n, kind in enumerate(kinds))
    return f"""
        declare i32 @"{made}"(ptr, ptr, {", ".join(kinds)})
        define i32 @{name}({given}) {{
            %result = alloca i64
            %error = alloca ptr
            %failed = call i32 @"{made}"(ptr %result, ptr %error, {given})
            %told = load i64, ptr %result
            %status = trunc i64 %told to i32
            %good = icmp eq i32 %failed, 0
            %out = select i1 %good, i32 %status, i32 -1
            ret i32 %out
        }}
    """


def _object_file(module: str) -> bytes:
    """Compile a kernel: machine code that refers to nothing but libm."""
    import llvmlite.binding as llvm
    import numba

    loaded: Any = importlib.import_module(module)
    # What the compiler makes lives until this process ends: looking for garbage in it takes a twelfth of the time.
    gc.disable()
    # Of numba's options a type checker knows only the common ones.
    compile_: Any = numba.njit
    called = getattr(loaded, "ENTRIES", None)
    entries = {ENTRY: (loaded.ticks, "int64(int64)")} if called is None else called
    unit, names = None, {}
    for name, (function, signature) in entries.items():
        compiled = compile_([signature], no_cpython_wrapper=True, no_cfunc_wrapper=True)(function.py_func)
        (result,) = compiled.overloads.values()
        part = llvm.parse_assembly(result.library.get_llvm_str())
        names[name] = result.fndesc.llvm_func_name
        if unit is None:
            unit = part
        else:
            unit.link_in(part)
    assert unit is not None  # noqa: S101  # a kernel has entries
    if called is not None:
        unit.link_in(llvm.parse_assembly("\n".join(_by_c(name, names[name], entries[name][1]) for name in entries)))
    for function in unit.functions:
        if not function.is_declaration and function.name not in (*entries, *names.values()):
            function.linkage = "internal"
    for name, made_name in names.items():
        if called is None:
            unit.get_function(made_name).name = name
        else:
            unit.get_function(made_name).linkage = "internal"
    target = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=llvm.get_host_cpu_features().flatten(), opt=3, reloc="pic", codemodel="default"
    )
    # Helpers of numba's that the kernel does not use would refer to numba's library.
    llvm.initialize_native_asmprinter()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    llvm.create_pass_builder(target, options).getModulePassManager().run(unit, llvm.create_pass_builder(target, options))
    made: bytes = target.emit_object(unit)
    return made


def _linked(made: bytes) -> cache.CacheEntry:
    """Make a shared library of an object file, where there is a linker."""
    linker = next(filter(None, map(shutil.which, _LINKERS)), None)
    if linker is not None:
        with tempfile.TemporaryDirectory(prefix="haptic-tick-") as folder:
            draft, linked = Path(folder) / "tick.o", Path(folder) / "tick.so"
            draft.write_bytes(made)
            done = subprocess.run([linker, "-shared", "-o", linked, draft, "-lm"], capture_output=True, check=False)
            if done.returncode == 0:
                return cache.CacheEntry(kind="so", content=linked.read_bytes())
    return cache.CacheEntry(kind="o", content=made)


def _cause(error: Exception) -> str:
    """Say in a line why a kernel could not be compiled, and where: numba reports it innermost, below all that called it."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [type(error).__name__]
    failed = [n for n, line in enumerate(lines[:-1]) if _FAILED in line]
    if not failed:
        return lines[-1]
    cause = lines[failed[-1] + 1]
    where = next((line.removeprefix("File ").rstrip(":") for line in lines[failed[-1] :] if line.startswith("File ")), "")
    if cause.startswith("Untyped global name"):
        cause += "; a function that a tick calls must be named in its kernel"
    return f"{cause} ({where})" if where else cause


def _compile(module: str, keep_failure: bool) -> None:
    # Before compiling: what is changed meanwhile was not compiled.
    sources = {**cache.sources_of(module), **cache.sources_of("nodes.compiled.build")}
    try:
        entry = _linked(_object_file(module))
    except Exception as error:
        if not keep_failure:
            raise NotCompilableError(_cause(error)) from error
        # It would fail at each launch.
        entry = cache.CacheEntry(kind="failed", content=f"{module}: {_cause(error)}".encode())
    cache.write(f"{module}.tick", entry, sources)


def _idle(modules: Sequence[str]) -> None:
    """Compile what is missing, when nothing else wants a processor that this process may use."""
    os.nice(19)
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    os.chdir("/")
    if cache.alone() is not None:
        for module in modules:
            if find(module) is None:
                _compile(module, keep_failure=True)


def _main(words: Sequence[str]) -> None:
    try:
        if words[:1] == ["--idle"]:
            _idle(words[1:])
            return
        # Of a loop's node it would inherit processor and priority.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        # Refused where this container has others.
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, range(os.cpu_count() or 1))
        for module in words:
            with cache.making(f"{module}.tick"):
                found = find(module)
                if found is None or reason(found):
                    _compile(module, keep_failure=False)
    except NotCompilableError as error:
        # All that the compiler says, and last what came of it.
        traceback.print_exc()
        sys.exit(str(error))
    except cache.CacheRefusedError as error:
        sys.exit(f"not kept: {error}")


if __name__ == "__main__":
    _main(sys.argv[1:])
