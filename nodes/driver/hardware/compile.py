"""Compiling a servo loop or linking a vendor's static library, cached per source version."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from nodes.compiled import cache
from nodes.compiled.source_files import ROOT, source_of


def shared_library(
    name: str, sources: Iterable[Path], options: Sequence[str | Path], what: str
) -> Any:
    """Return the shared library that a C compiler makes; OSError without one, or if it fails."""
    # an absolute path stands for itself
    digests = {}
    for path in sources:
        known = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
        digests[str(known)] = source_of(path)
    try:
        found = cache.read(name)
    except cache.CacheRefusedError:
        found = None
    if found is None:
        found = cache.CacheEntry(kind="so", content=_compiled(options, what))
        # without a cache it is compiled at each start
        with contextlib.suppress(cache.CacheRefusedError):
            cache.write(name, found, digests)
    return cache.load(found.content)


def servo_library(source: Path) -> Any:
    """Return a servo loop's library, compiled once per version of its source."""
    sources = [source, Path(__file__).with_name("mailbox.h")]
    name = f"{source.parent.name}-{source.stem}.so"
    return shared_library(
        name,
        sources,
        ["-pthread", source, "-lm"],
        f"the servo loop {source.parent.name}/{source.name}",
    )


def compiler() -> str:
    """Return the path of a C compiler."""
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if found is None:
        raise OSError(
            "no C compiler: a device's servo loop is compiled once, at first use; install gcc or"
            " clang"
        )
    return found


def _compiled(options: Sequence[str | Path], what: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="haptic-servo-") as folder:
        library = Path(folder) / "made.so"
        command = [compiler(), "-O2", "-shared", "-fPIC", "-o", library, *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise OSError(f"{command[0]} cannot compile {what}: {done.stderr[-1000:]}")
        return library.read_bytes()
