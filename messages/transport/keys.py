"""Keys of machines: this machine's identity and the allowed ones, in private files.

There is one CURVE key pair per user and machine, below ``$HAPTIC_KEYS`` (or
``~/.config/haptic/keys``)::

    identity.key      secret and public key of this machine, mode 0600
    allowed/NAME.key  public key of another machine, mode 0600

A key is written as 64 hexadecimal digits, which need no quoting in a shell. An allowed machine may
listen, publish and send control requests; there are no partial permissions.
"""

import os
import re
import stat
import struct
from pathlib import Path

import msgspec
import zmq
from zmq.utils import z85

from messages.errors import HapticError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")
_KEY = re.compile(r"[0-9a-f]{64}")


class KeyRefusedError(HapticError, ValueError):
    """A key or key file that cannot be used; the text has the reason and the remedy."""


class Identity(msgspec.Struct, frozen=True):
    """Key pair of this machine: 64 hexadecimal digits each."""

    public: str
    secret: str


def key_dir() -> Path:
    """Return the directory of the keys."""
    if "HAPTIC_KEYS" in os.environ:
        return Path(os.environ["HAPTIC_KEYS"])
    return (
        Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config")
        / "haptic"
        / "keys"
    )


def _others_may(found: os.stat_result) -> bool:
    """Whether another user owns what was found, or may read or write it."""
    return found.st_uid != os.getuid() or bool(stat.S_IMODE(found.st_mode) & 0o077)


def _private_dir(path: Path) -> None:
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise KeyRefusedError(
            f"{path}: cannot be made: {error.strerror}; name a folder of your own in $HAPTIC_KEYS"
        ) from error
    found = path.lstat()
    if not stat.S_ISDIR(found.st_mode) or _others_may(found):
        raise KeyRefusedError(
            f"{path}: must be a directory of user {os.getuid()} with mode 0700; chmod 700 it"
        )


def _write(path: Path, text: str, replace: bool = False) -> None:
    """Write a file that is private from its first byte on, never through a link."""
    _private_dir(path.parent)
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    descriptor = os.open(
        draft,
        os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC,
        0o600,
    )
    try:
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if replace:
            os.replace(draft, path)
        else:
            os.link(draft, path)
    except FileExistsError as error:
        raise KeyRefusedError(
            f"{path}: already exists; remove it first, or use --replace"
        ) from error
    finally:
        draft.unlink(missing_ok=True)


def _read(path: Path) -> list[str]:
    """Return the words of a key file, which must be private."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError as error:
        raise KeyRefusedError(f"{path}: {error.strerror}") from error
    with os.fdopen(descriptor, encoding="ascii", errors="replace") as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode) or _others_may(found):
            raise KeyRefusedError(
                f"{path}: must be a file of user {os.getuid()} with mode 0600; chmod 600 it"
            )
        return file.read(4096).split()


def parse_key(text: str) -> str:
    """Return a key, given in hexadecimal or Z85, in hexadecimal."""
    if len(text) == 40:
        try:
            return bytes(z85.decode(text)).hex()
        except (ValueError, KeyError, struct.error) as error:
            raise KeyRefusedError(
                f"{text!r}: 40 characters that are not Z85"
            ) from error
    key = text.lower()
    if not _KEY.fullmatch(key):
        raise KeyRefusedError(
            f"{text!r}: a key is 64 hexadecimal digits (or 40 characters of Z85); got {len(text)}"
        )
    return key


def new_identity(replace: bool = False) -> Identity:
    """Create this machine's key pair."""
    public, secret = (bytes(z85.decode(key)).hex() for key in zmq.curve_keypair())
    _write(key_dir() / "identity.key", f"{public}\n{secret}\n", replace)
    return Identity(public, secret)


def identity(folder: Path | None = None) -> Identity:
    """Return this machine's key pair."""
    path = (folder or key_dir()) / "identity.key"
    if not path.exists():
        raise KeyRefusedError(
            f"{path}: no such file; this machine has no keys yet: haptic keys new"
        )
    words = _read(path)
    if len(words) != 2 or not all(_KEY.fullmatch(word) for word in words):
        raise KeyRefusedError(
            f"{path}: not a public and a secret key; make new ones: haptic keys new --replace"
        )
    if (
        bytes(z85.decode(zmq.curve_public(z85.encode(bytes.fromhex(words[1]))))).hex()
        != words[0]
    ):
        raise KeyRefusedError(
            f"{path}: public and secret key do not belong together: haptic keys new --replace"
        )
    return Identity(words[0], words[1])


def allow(name: str, key: str, replace: bool = False) -> Path:
    """Allow another machine."""
    if not _NAME.fullmatch(name):
        raise KeyRefusedError(
            f"{name!r}: a name is letters, digits, dots, - and _, at most 63"
        )
    path = key_dir() / "allowed" / f"{name}.key"
    _write(path, f"{parse_key(key)}\n", replace)
    return path


def allowed(folder: Path | None = None) -> dict[str, str]:
    """Return the allowed machines and their keys."""
    found = {}
    for path in sorted(((folder or key_dir()) / "allowed").glob("*.key")):
        words = _read(path)
        if len(words) != 1:
            raise KeyRefusedError(
                f"{path}: not one public key; remove it, and: haptic keys allow {path.stem} KEY"
            )
        found[path.stem] = parse_key(words[0])
    return found


def trusted(folder: Path | None = None) -> tuple[dict[str, str], str]:
    """Return the allowed keys and names, and why keys could not be read.

    An unreadable file allows nobody.
    """
    found: dict[str, str] = {}
    why = ""
    try:
        found = {key: name for name, key in allowed(folder).items()}
    except (KeyRefusedError, OSError) as error:
        why = str(error)
    try:
        found[identity(folder).public] = "self"
    except (KeyRefusedError, OSError) as error:
        why = why or str(error)
    return found, why


def revoke(name: str) -> Path:
    """Revoke a machine's key; running nodes end its connections within a second."""
    path = key_dir() / "allowed" / f"{name}.key"
    if not _NAME.fullmatch(name) or (not path.is_symlink() and not path.exists()):
        there = sorted(found.stem for found in (key_dir() / "allowed").glob("*.key"))
        raise KeyRefusedError(
            f"no key of {name!r} is allowed here; available: {', '.join(there) or 'none'}"
        )
    path.unlink()
    return path


def key_of(name: str) -> str:
    """Return the public key of an allowed machine."""
    there = allowed()
    if name not in there:
        raise KeyRefusedError(
            f"no key of {name!r} is allowed here (available: {', '.join(there) or 'none'}); on that"
            f" machine: haptic keys new, then here: haptic keys allow {name} KEY"
        )
    return there[name]
