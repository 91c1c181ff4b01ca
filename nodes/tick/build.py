"""Compiling the ticks, once, into files: a node that ticks needs neither numba nor its memory.

numba makes a kernel from the functions that the plain tick calls, and LLVM writes it as an object file. Where the machine has
a linker it becomes a shared library, which costs a node nothing; otherwise llvmlite loads the object file. Beside it stands
what it was made of (source files, versions, processor), so what is found is what would be compiled. In a process of its own::

    python -m nodes.tick.build MODULE...
"""

from __future__ import annotations

import hashlib
import importlib
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import msgspec

from nodes.tick.fields import NotCompilableError

ENTRY: Final = "haptic_tick"
"""Name of a kernel in its file."""

TIMEOUT: Final = 300.0
"""How long compiling may take [s]; some ten seconds are usual."""

_ROOT: Final = Path(__file__).parents[2]
_LINKERS: Final = ("cc", "gcc", "clang")


class Built(msgspec.Struct, frozen=True, kw_only=True):
    """A kernel in the folder.

    Attributes
    ----------
    file : str
        Its name in the folder: ``.so`` or ``.o``.
    sources : dict of str to str
        What it was made of, and the digest of each.
    """

    file: str
    sources: dict[str, str]


@cache
def folder() -> Path:
    """Find the folder of the kernels for this installation, these compilers and this processor."""
    text = [str(_ROOT), str(sys.version_info[:2]), platform.machine()]
    for package in ("numba", "llvmlite", "numpy"):
        try:
            text.append(version(package))
        except PackageNotFoundError:
            text.append("none")
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    text += sorted({line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))})
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "haptic-nodes" / f"tick-{hashlib.sha256('|'.join(text).encode()).hexdigest()[:16]}"


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def find(module: str) -> Path | None:
    """Find a kernel that was compiled before, from what is installed now."""
    try:
        built = msgspec.json.decode((folder() / f"{module}.json").read_bytes(), type=Built)
        fresh = all(_digest(_ROOT / name) == digest for name, digest in built.sources.items())
    except (OSError, msgspec.DecodeError):
        return None
    path = folder() / built.file
    return path if fresh and path.exists() else None


def build(modules: Sequence[str]) -> None:
    """Compile kernels, each in a process of its own."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "nodes.tick.build", module],
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
            failed = failed or f"{module}: {(errors.strip().splitlines() or ['no reason given'])[-1]}"
    if failed:
        raise NotCompilableError(failed)


# -- in the process that compiles ------------------------------------------------------------------------------------


def _object_file(module: str) -> bytes:
    """Compile a kernel: machine code that refers to nothing but libm."""
    import llvmlite.binding as llvm
    import numba

    ticks: Any = importlib.import_module(module).ticks
    # Of numba's options a type checker knows only the common ones.
    compile_: Any = numba.njit
    compiled = compile_(["int64(int64)"], no_cpython_wrapper=True, no_cfunc_wrapper=True)(ticks.py_func)
    (result,) = compiled.overloads.values()
    unit = llvm.parse_assembly(result.library.get_llvm_str())
    entry = unit.get_function(result.fndesc.llvm_func_name)
    for function in unit.functions:
        if not function.is_declaration and function.name != entry.name:
            function.linkage = "internal"
    entry.name = ENTRY
    target = llvm.Target.from_triple(llvm.get_process_triple()).create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        reloc="pic",
        codemodel="default",
    )
    # Helpers of numba's that the kernel does not use would refer to numba's library.
    llvm.initialize_native_asmprinter()
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    llvm.create_pass_builder(target, options).getModulePassManager().run(
        unit, llvm.create_pass_builder(target, options)
    )
    made: bytes = target.emit_object(unit)
    return made


def _compile(module: str) -> None:
    place = folder()
    place.mkdir(parents=True, exist_ok=True)
    made = _object_file(module)
    stem = f"{module}-{hashlib.sha256(made).hexdigest()[:16]}"
    path = place / f"{stem}.o"
    draft = place / f"{stem}.{os.getpid()}.o"
    draft.write_bytes(made)
    draft.replace(path)
    linker = next(filter(None, map(shutil.which, _LINKERS)), None)
    if linker is not None:
        linked = draft.with_suffix(".so")
        done = subprocess.run([linker, "-shared", "-o", linked, path, "-lm"], capture_output=True, check=False)
        if done.returncode == 0:
            path = path.with_suffix(".so")
            linked.replace(path)
    sources = {}
    for loaded in list(sys.modules.values()):
        file = getattr(loaded, "__file__", None)
        if file and Path(file).is_relative_to(_ROOT) and loaded.__name__.split(".")[0] in ("messages", "nodes", "sim"):
            sources[str(Path(file).relative_to(_ROOT))] = _digest(Path(file))
    sources["nodes/tick/build.py"] = _digest(Path(__file__))
    note = place / f"{module}.{os.getpid()}.json"
    note.write_bytes(msgspec.json.encode(Built(file=path.name, sources=sources)))
    note.replace(place / f"{module}.json")


if __name__ == "__main__":
    # Of a loop's node it would inherit processor and priority.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    for _module in sys.argv[1:]:
        _compile(_module)
