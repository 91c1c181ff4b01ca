"""Reading and writing YAML: bounded, unambiguous, and never half-written.

Numbers are what they look like (``1e3`` is a number, ``010`` is ten, ``1:30`` and ``off`` are
text), keys are unique, and aliases are rejected because a kilobyte of them expands to gigabytes.
`parse_yaml` reads what `write_yaml` writes to the same bits.
"""

import contextlib
import errno
import fcntl
import functools
import os
import re
import stat
from typing import Any, ClassVar

import yaml

from nodes.parameters.store import ParameterError

MAX_CHARACTERS = 1_000_000  # longest document: several laws of maximum length

MAX_KEPT = 20_000  # longest document that is parsed once [characters]: a launch file

MAX_DEPTH = 32
MAX_INT = 2**63 - 1  # integers are sent between processes as 64 bits

_BREAKS = re.compile("[\x85\u2028\u2029]")

# plain scalars that are not text: those of YAML 1.2, with optional _ between digits
_RESOLVED = (
    ("bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), "tTfF"),
    ("null", re.compile(r"^(?:~|null|Null|NULL|)$"), ["~", "n", "N", ""]),
    ("int", re.compile(r"^(?:[-+]?[0-9][0-9_]*|0x[0-9a-fA-F]+)$"), "-+0123456789"),
    (
        "float",
        re.compile(
            r"^(?:[-+]?(?:[0-9][0-9_]*\.[0-9_]*(?:[eE][-+]?[0-9]+)?"
            r"|\.[0-9][0-9_]*(?:[eE][-+]?[0-9]+)?"
            r"|[0-9][0-9_]*[eE][-+]?[0-9]+|\.(?:inf|Inf|INF))|\.(?:nan|NaN|NAN))$"
        ),
        "-+0123456789.",
    ),
)


class _Loader(yaml.SafeLoader):
    """Builds mappings, lists, text, numbers, booleans and None, whatever tag is written."""

    yaml_constructors: ClassVar[dict[str | None, Any]] = {
        f"tag:yaml.org,2002:{name}": yaml.SafeLoader.yaml_constructors[
            f"tag:yaml.org,2002:{name}"
        ]
        for name in ("map", "seq", "str", "null", "float")
    }
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012  # as PyYAML declares it
    depth = 0

    def _mark(self) -> str:
        event: yaml.events.Event = self.peek_event()  # type: ignore[no-untyped-call]
        return str(event.start_mark)

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            raise yaml.YAMLError(
                f"aliases are not accepted; write the value out{self._mark()}"
            )
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise yaml.YAMLError(f"nested deeper than {MAX_DEPTH}{self._mark()}")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.YAMLError(f"expected a mapping{node.start_mark}")
        seen = set()
        for key, _ in node.value:
            name = self.construct_object(key, deep=True)
            if not isinstance(name, str):
                raise yaml.YAMLError(
                    f"key {name!r} is not text; put it in quotes{key.start_mark}"
                )
            if name in seen:
                raise yaml.YAMLError(f"{name!r} stands twice{key.start_mark}")
            seen.add(name)
        return super().construct_mapping(node, deep)

    def construct_bool(self, node: Any) -> bool:
        text = str(self.construct_scalar(node)).lower()
        if text not in ("true", "false"):
            raise yaml.YAMLError(
                f"{text[:40]!r} is neither true nor false{node.start_mark}"
            )
        return text == "true"

    def construct_int(self, node: Any) -> int:
        text = str(self.construct_scalar(node)).replace("_", "")
        # Length first: Python refuses very long integers with advice that does not help here.
        value = (
            int(text, 16 if text.startswith("0x") else 10)
            if len(text) < 100
            else MAX_INT + 1
        )
        if not -MAX_INT <= value <= MAX_INT:
            raise yaml.YAMLError(
                f"{text[:40]}: limit ±{MAX_INT}; write a float{node.start_mark}"
            )
        return value


class _Dumper(yaml.SafeDumper):
    """Quotes text that `_Loader` would not read as text."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012  # as PyYAML declares it

    def ignore_aliases(self, data: Any) -> bool:
        del data
        return True


for _name, _pattern, _first in _RESOLVED:
    for _class in (_Loader, _Dumper):
        _class.add_implicit_resolver(
            f"tag:yaml.org,2002:{_name}", _pattern, list(_first)
        )
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_int)
_Loader.add_constructor("tag:yaml.org,2002:bool", _Loader.construct_bool)
_Loader.yaml_constructors[None] = yaml.SafeLoader.construct_undefined


_TAB = r"found character '\t' that cannot start any token"

# PyYAML's name for text without a file; the file's name precedes it
_NAMELESS = ' in "<unicode string>"'


def parse_yaml(text: str, source: str) -> Any:
    """Return the content of a YAML document, bounded in size and depth."""
    if len(text) > MAX_CHARACTERS:
        raise ParameterError(
            f"{len(text)} characters, limit {MAX_CHARACTERS}", path=source
        )
    try:
        return _copied(_parsed(text)) if len(text) <= MAX_KEPT else _load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        reason = (
            " ".join(str(error).split())
            .replace(_TAB, "a tab, where YAML takes spaces")
            .replace(_NAMELESS, "")
        )
        raise ParameterError(f"not valid YAML: {reason}", path=source) from error


def _load(text: str) -> Any:
    # _Loader is a SafeLoader and constructs builtins only.
    return yaml.load(text, Loader=_Loader)  # noqa: S506


# A study plays one launch file some thousand times, and PyYAML takes 20 ms for each.
_parsed = functools.lru_cache(maxsize=64)(_load)


def _copied(data: Any) -> Any:
    """Return a copy of builtins whose mappings and lists the caller may change."""
    if isinstance(data, dict):
        return {name: _copied(value) for name, value in data.items()}
    return [_copied(value) for value in data] if isinstance(data, list) else data


def lines_of(path: str | os.PathLike[str]) -> dict[str, int]:
    """Return the line number of each value of a YAML file, by path."""
    found: dict[str, int] = {}

    def walk(node: Any, place: str) -> None:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                below = f"{place}.{key.value}" if place else str(key.value)
                found[below] = key.start_mark.line + 1
                walk(value, below)
        elif isinstance(node, yaml.SequenceNode):
            for i, value in enumerate(node.value):
                found[f"{place}[{i}]"] = value.start_mark.line + 1
                walk(value, f"{place}[{i}]")

    with (
        contextlib.suppress(yaml.YAMLError, OSError, ValueError),
        open(path, encoding="utf-8") as file,
    ):
        walk(yaml.compose(file.read(4 * MAX_CHARACTERS), Loader=_Loader), "")
    return found


def write_yaml(data: Any, width: int = 120) -> str:
    """Return builtins as YAML that `parse_yaml` reads back unchanged."""
    for plain in (True, False):
        text: str = yaml.dump(
            data,
            Dumper=_Dumper,
            sort_keys=False,
            allow_unicode=plain,
            default_flow_style=None,
            width=width,
        )
        # PyYAML writes Unicode line breaks unescaped and reads them as blanks; escaped they are
        # safe.
        if not _BREAKS.search(text):
            break
    return text


def read_yaml(path: str | os.PathLike[str]) -> Any:
    """Return the content of a YAML file."""
    try:
        with open(path, "rb") as file:
            # A document of that many characters has at most four times as many bytes; a device
            # never ends.
            content = file.read(4 * MAX_CHARACTERS + 1)
        if len(content) > 4 * MAX_CHARACTERS:
            raise ParameterError(
                f"more than {4 * MAX_CHARACTERS} bytes, limit {MAX_CHARACTERS} characters",
                path=str(path),
            )
        return parse_yaml(content.decode("utf-8"), str(path))
    except OSError as error:
        raise ParameterError(f"{error.strerror}", path=str(path)) from error
    except UnicodeDecodeError as error:
        raise ParameterError(f"not UTF-8: {error}", path=str(path)) from error


class WatchedFile:
    """A YAML file whose saved changes are detected, never half-written ones.

    A file is read only when size and time have stayed the same for two polls and the kernel
    confirms, by granting a read lease, that no process has it open for writing. A writer that opens
    it while the lease is held makes the kernel send SIGIO, which ends a process that does not
    ignore it: nodes do (nodes/base/node.py).
    """

    def __init__(self, path: str, applied: tuple[int, int, int] | None = None) -> None:
        self.path = path
        self._seen: tuple[int, int, int] | None = None
        # last save that was returned: time, size and inode number
        self.applied = applied

    def _signature(self) -> tuple[int, int, int] | None:
        try:
            found = os.stat(self.path)
        except FileNotFoundError:
            return None
        return found.st_mtime_ns, found.st_size, found.st_ino

    def poll(self) -> Any:
        """Return the file's content if it was saved since the last poll, else None.

        The first poll counts as a save, unless it equals `applied`.
        """
        try:
            signature = self._signature()
            steady = signature == self._seen
            self._seen = signature
            if signature is None or not steady or signature == self.applied:
                return None
            # Opening a pipe would block the thread that answers requests.
            descriptor = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                os.close(descriptor)
                raise OSError(errno.EINVAL, "is not a regular file, and is not watched")
            with open(descriptor, "rb") as file:
                if not self._lease(file.fileno(), fcntl.F_RDLCK):
                    return None
                content = file.read(4 * MAX_CHARACTERS + 1)
                self._lease(file.fileno(), fcntl.F_UNLCK)
            # Saved or replaced while it was read: a later poll reads it again.
            if self._signature() != signature:
                return None
            self.applied = signature
            text = content.decode("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            self.applied = self._seen
            raise ParameterError(f"{error}", path=self.path) from error
        return parse_yaml(text, self.path)

    @staticmethod
    def _lease(descriptor: int, kind: int) -> bool:
        try:
            fcntl.fcntl(descriptor, fcntl.F_SETLEASE, kind)
        except BlockingIOError:
            return False
        except OSError:
            # No leases on this file system or for this owner (NFS, another user's file): two equal
            # polls must suffice.
            return True
        return True
