"""Compiled code on disk: loaded only if this user wrote it, from the installed sources.

Compiled code is executed, so a file that somebody else could have written is never opened. All
entries are in one folder of the user's own: nobody else can write to it or to its parents, and it
is entered without following a link. An entry is one file: the digest of the rest, its sources
(every source file, by digest), and the code. It is written to a draft and moved into place, so that
it is complete or absent; a truncated, damaged or outdated entry counts as absent and is compiled
again. It is not outdated by a change of comments, docstrings or layout. An entry is read into
memory, its digest checked, and that copy loaded.

The folder's name contains versions and processor.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import hashlib
import os
import platform
import pwd
import re
import stat
import sys
import time
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

import msgspec

from messages.errors import HapticError
from nodes.compiled.source_files import ROOT, Source, is_current
from nodes.parameters.installed import version

# largest entry [bytes]; a kernel has some hundred thousand
LARGEST: Final = 256 * 2**20
# longest wait for another process that compiles an entry, before it is compiled twice [s]
LOCK_TIMEOUT: Final = 120.0
_DIGEST: Final = 64
_BARE: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
_SEALS: Final = (
    fcntl.F_SEAL_SEAL | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_WRITE
)


class CacheRefusedError(HapticError, OSError):
    """A folder that is not trusted for compiled code, or unusable; the text has the reason."""


class _About(msgspec.Struct, frozen=True, kw_only=True):
    """Kind of an entry's code, and its source files by path in the installation."""

    kind: str
    sources: dict[str, Source]


class CacheEntry(msgspec.Struct, frozen=True, kw_only=True):
    """Compiled code in the cache.

    kind: Kind of `content`: ``so``, ``o``, ``numba``; or ``failed``, with the reason.
    content: The code.
    """

    kind: str
    content: bytes


@cache
def _versions() -> str:
    """Return an identifier of this installation, its compilers and this processor."""
    text = [str(ROOT), sys.implementation.cache_tag or "", platform.machine()]
    for package in ("numba", "llvmlite", "numpy"):
        text.append(version(package) or "none")
    try:
        lines = (
            Path("/proc/cpuinfo")
            .read_text(encoding="utf-8", errors="replace")
            .splitlines()
        )
    except OSError:
        lines = []
    text += sorted(
        {
            line
            for line in lines
            if line.startswith(("model name", "flags", "Features", "CPU part"))
        }
    )
    return hashlib.sha256("|".join(text).encode()).hexdigest()[:16]


def folder() -> Path:
    """Return the folder of compiled code, which need not exist.

    It is below ``NUMBA_CACHE_DIR``, ``XDG_CACHE_HOME`` or ``~/.cache``.
    """
    base = (
        os.environ.get("NUMBA_CACHE_DIR")
        or os.environ.get("XDG_CACHE_HOME")
        or Path.home() / ".cache"
    )
    return Path(base).absolute() / "haptic-nodes" / f"compiled-{_versions()}"


def _others_write(found: os.stat_result) -> bool:
    """Return whether others than this user and root may write to a file."""
    if found.st_uid not in (0, os.getuid()):
        return True
    if found.st_mode & stat.S_IWOTH:
        return True
    if not found.st_mode & stat.S_IWGRP or found.st_gid == 0:
        return False
    # many systems have a group per user, with write permission
    user = pwd.getpwuid(os.getuid())
    return found.st_gid != user.pw_gid or found.st_gid != user.pw_uid


def _safe(path: Path, depth: int = 0) -> None:
    """Check that nobody else can replace a path, link by link and folder by folder."""
    if depth > 16:
        raise CacheRefusedError(f"{path}: too many symbolic links")
    for step in (*reversed(path.parents), path):
        found = step.lstat()
        if stat.S_ISLNK(found.st_mode):
            if found.st_uid not in (0, os.getuid()):
                raise CacheRefusedError(f"{step}: a symbolic link of another user")
            _safe((step.parent / step.readlink()).absolute(), depth + 1)
        # in a sticky folder like /tmp only the owner can replace an entry
        elif _others_write(found) and not (
            found.st_uid == 0 and found.st_mode & stat.S_ISVTX
        ):
            raise CacheRefusedError(
                f"{step}: others than user {os.getuid()} may write there"
            )


def _enter(name: str, make: bool) -> int:
    """Return a descriptor of an entry's folder, opened without following its last two links."""
    if not _BARE.fullmatch(name):
        raise CacheRefusedError(f"{name!r}: is no name of an entry")
    path = folder()
    base = path.parent.parent
    try:
        if make:
            base.mkdir(mode=0o700, parents=True, exist_ok=True)
        _safe(base)
        at = os.open(base, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        for step in path.parts[-2:]:
            outer = at
            try:
                if make:
                    with contextlib.suppress(FileExistsError):
                        os.mkdir(step, 0o700, dir_fd=outer)
                at = os.open(
                    step,
                    os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC,
                    dir_fd=outer,
                )
            finally:
                os.close(outer)
            found = os.fstat(at)
            if found.st_uid != os.getuid() or _others_write(found):
                os.close(at)
                raise CacheRefusedError(
                    f"{path}: {step} must belong to user {os.getuid()}, with write permission for"
                    " nobody else; remove it"
                )
    except (CacheRefusedError, FileNotFoundError):
        raise
    except OSError as error:
        raise CacheRefusedError(f"{path}: {error.strerror}") from error
    return at


def read(name: str) -> CacheEntry | None:
    """Return an entry that is complete and up to date, or None.

    Raises CacheRefusedError if another user could have written it.
    """
    try:
        at = _enter(name, make=False)
    except FileNotFoundError:
        return None
    try:
        descriptor = os.open(
            name, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK, dir_fd=at
        )
    except FileNotFoundError:
        return None
    except OSError as error:
        raise CacheRefusedError(f"{folder() / name}: {error.strerror}") from error
    finally:
        os.close(at)
    found = os.fstat(descriptor)
    if (
        not stat.S_ISREG(found.st_mode)
        or found.st_uid != os.getuid()
        or _others_write(found)
    ):
        os.close(descriptor)
        raise CacheRefusedError(
            f"{folder() / name}: must be a file of user {os.getuid()} that nobody else may write"
            " to; remove it"
        )
    with os.fdopen(descriptor, "rb") as file:
        whole = file.read(LARGEST) if found.st_size <= LARGEST else b""
    digest = whole[:_DIGEST]
    rest = whole[_DIGEST:]
    if hashlib.sha256(rest).hexdigest().encode() != digest:
        return None
    about, _, content = rest.partition(b"\n")
    try:
        known = msgspec.json.decode(about, type=_About)
        fresh = all(
            is_current(ROOT / name, source) for name, source in known.sources.items()
        )
        return CacheEntry(kind=known.kind, content=content) if fresh else None
    except (msgspec.DecodeError, OSError):
        return None


def write(name: str, entry: CacheEntry, sources: Mapping[str, Source]) -> None:
    """Write an entry atomically; CacheRefusedError if that fails, e.g. on a full disk."""
    about = msgspec.json.encode(_About(kind=entry.kind, sources=dict(sources)))
    rest = about + b"\n" + entry.content
    at = _enter(name, make=True)
    draft = f".{name}.{os.getpid()}.{os.urandom(4).hex()}"
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with os.fdopen(os.open(draft, flags, 0o600, dir_fd=at), "wb") as file:
            file.write(hashlib.sha256(rest).hexdigest().encode() + rest)
        os.rename(draft, name, src_dir_fd=at, dst_dir_fd=at)
    except OSError as error:
        with contextlib.suppress(OSError):
            os.unlink(draft, dir_fd=at)
        raise CacheRefusedError(f"{folder() / name}: {error.strerror}") from error
    finally:
        os.close(at)


# entries being made by this process's threads, which must not wait for each other
_made_here: set[str] = set()


@contextlib.contextmanager
def making(name: str) -> Iterator[None]:
    """Lock an entry while it is made; CacheRefusedError if it cannot be written.

    Another process that holds it is waited for, but not for ever.
    """
    if name in _made_here:
        yield
        return
    at = _enter(name, make=True)
    lock = f".{name}.making"
    until = time.monotonic() + LOCK_TIMEOUT
    held = None
    _made_here.add(name)
    try:
        try:
            while (held := _locked(at, lock)) is None and time.monotonic() < until:
                time.sleep(0.02)
        except OSError as error:
            raise CacheRefusedError(f"{folder() / name}: {error.strerror}") from error
        yield
    finally:
        _made_here.discard(name)
        if held is not None:
            with contextlib.suppress(OSError):
                os.unlink(lock, dir_fd=at)
            os.close(held)
        os.close(at)


def _locked(at: int, lock: str) -> int | None:
    """Return a locked descriptor, or None if another process has the lock.

    The holder may remove the file in the end.
    """
    held = os.open(
        lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600, dir_fd=at
    )
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # it may have been removed between opening and locking
        if (
            os.stat(lock, dir_fd=at, follow_symlinks=False).st_ino
            == os.fstat(held).st_ino
        ):
            return held
    except (BlockingIOError, FileNotFoundError):
        pass
    except BaseException:
        os.close(held)
        raise
    os.close(held)
    return None


def alone() -> int | None:
    """Return the lock of background compilation; None if another process has it."""
    at = _enter("background.lock", make=True)
    try:
        return _locked(at, "background.lock")
    except OSError as error:
        raise CacheRefusedError(f"{folder()}: {error.strerror}") from error
    finally:
        os.close(at)


# descriptors of libraries: a loader would reuse a library of a known name
_open: list[int] = []


def load(library: bytes) -> Any:
    """Load a shared library from sealed memory, which nobody can change."""
    descriptor = os.memfd_create(
        "haptic-compiled", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING
    )
    with open(descriptor, "wb", closefd=False) as file:
        file.write(library)
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _SEALS)
    _open.append(descriptor)
    return ctypes.CDLL(f"/proc/self/fd/{descriptor}")
