"""Read topics of a ROS bag as a table: a row per message of the position's topic.

A force on another topic is that of the last message before the row. Times are those of the
headers, or else of the receipt. Needs rosbags, which reads bags of ROS 2 (MCAP, SQLite) and ROS 1.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.parameters.nearest import did_you_mean
from nodes.recording.facts import FASTEST, SLOWEST
from nodes.recording.foreign_table import LARGEST, ForeignTable
from nodes.recording.import_words import words
from nodes.recording.mcap_walk import CHANNEL, CHUNK, parse_channel, unpack_chunk, walk
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Column = np.ndarray[Any, Any]

VECTORS = {
    "position": (
        "pose.position",
        "pose.pose.position",
        "point",
        "transform.translation",
        "position",
    ),
    "force": ("wrench.force", "force", "vector"),
}
"""Fields of messages that may be a position or a force, by role, the preferred first."""

OWN = ("/haptic/device/pose", "/haptic/device/force", "/haptic/parameters")
"""Topics by which a bag of our own export is recognised."""

_MOST = 64  # numbers of one message that become columns
_NANO = 1e-9


def is_bag(path: Path) -> bool:
    """Whether a path is the folder of a ROS 2 bag, one of its files alone, or a ROS 1 bag."""
    if (path / "metadata.yaml").is_file():
        return True
    suffix = path.suffix.lower()
    if not path.is_file() or suffix not in (".bag", ".db3", ".mcap"):
        return False
    return suffix != ".mcap" or _begins_with_cdr(path)


def bag_of(path: Path) -> Path | None:
    """Return the bag that a path names, or None.

    A bag's file stands for the folder with its ``metadata.yaml``; without one the bag is that file,
    also where its folder is named and has no other.
    """
    stored = path.suffix.lower() in (".db3", ".mcap") and path.is_file()
    if stored and is_bag(path.parent):
        return path.parent
    if is_bag(path):
        return path
    if path.is_dir():
        files = (one for suffix in ("mcap", "db3") for one in path.glob(f"*.{suffix}"))
        found = list(itertools.islice(filter(is_bag, files), 2))
        return found[0] if len(found) == 1 else None
    return None


def _begins_with_cdr(path: Path) -> bool:
    """Whether the first channel of an MCAP file is one of ROS 2."""
    try:
        for record in walk(path):
            inner = (
                unpack_chunk(path, record) if record.opcode == CHUNK else iter([record])
            )
            for one in inner:
                if one.opcode == CHANNEL:
                    return parse_channel(path, one).encoding == "cdr"
    except RecordError:
        return False  # the error is raised by whatever reads the file
    return False


def read_bag(
    path: Path, columns: Mapping[str, Sequence[str]]
) -> tuple[ForeignTable, Any]:
    """Return the chosen topics of a bag as a table, and the columns of each role.

    Parameters
    ----------
    path : Path
        Folder of a ROS 2 bag, one of its files, or a ROS 1 bag.
    columns : mapping of str to sequence of str
        For ``position`` and ``force`` a topic, or its fields as ``/topic.field.x``; by default the
        only topic of a kind that has one.

    Returns
    -------
    table : ForeignTable
        Columns named ``/topic.field``, and ``time`` in nanoseconds; of our own export those of its
        table of ticks.
    columns : dict of str to list of str
        Columns of each role.

    Raises
    ------
    RecordError
        If the bag cannot be read, or its topics leave a choice; the text names them.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise RecordError(
            f"{path}: a ROS bag needs rosbags: pip install 'haptic-nodes[rosbag]'"
        ) from error
    size = sum(
        file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path])
    )
    if size > LARGEST:
        raise RecordError(f"{path}: larger than {LARGEST >> 20} MiB; cut it first")
    try:
        with AnyReader(
            [path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)
        ) as bag:
            return _table(path, bag, columns)
    except RecordError:
        raise
    # rosbags raises many kinds for a damaged bag.
    except Exception as error:
        # of a broken metadata.yaml it has several lines
        text = " ".join(str(error).split())
        raise RecordError(f"{path}: cannot be read as a ROS bag: {text}") from error


def _table(
    path: Path, bag: Any, columns: Mapping[str, Sequence[str]]
) -> tuple[ForeignTable, Any]:
    if not columns and set(OWN) <= set(bag.topics):
        return _own(path, bag), {}
    chosen = {role: list(columns[role]) for role in VECTORS if role in columns}
    if other := set(columns) - set(VECTORS):
        raise RecordError(
            f"{path}: columns: {min(other)!r} is not chosen of a bag: it has stamps"
        )
    topics = {role: _topic_of(path, bag, role, chosen.get(role)) for role in VECTORS}
    if topics["position"] is None:
        known = ", ".join(f"{name} ({one.msgtype})" for name, one in bag.topics.items())
        raise RecordError(
            f"{path}: which topic is the position? There are {known}; choose with"
            f" {words.get().columns({'position': '/TOPIC'})}, or position /TOPIC.FIELD.x"
        )
    place, push = topics["position"], topics["force"]
    read = {topic: _series(bag, topic) for topic in {place, push} if topic is not None}
    names = {
        role: _fields(path, role, topic, chosen.get(role), read[topic])
        for role, topic in topics.items()
        if topic is not None
    }
    time, values = read[place]
    found = {name: values[name] for name in names["position"]}
    if push is not None:
        time, found = _with_force(path, read, place, push, names["force"], found)
    return ForeignTable(path, {"time": time, **found}, {"time": "ns"}), names


def _with_force(
    path: Path,
    read: Mapping[str, tuple[Column, dict[str, Column]]],
    place: str,
    push: str,
    names: Sequence[str],
    found: dict[str, Column],
) -> tuple[Column, dict[str, Column]]:
    """Add to each row the last force before it; rows before the first force are left out."""
    import numpy as np

    time = read[place][0]
    pushed_at, forces = read[push]
    row = np.searchsorted(pushed_at, time, side="right") - 1
    known = row >= 0
    if known.sum() < 2:
        raise RecordError(f"{path}: no position after the first force on {push}")
    rows = {name: values[known] for name, values in found.items()}
    rows |= {name: forces[name][row[known]] for name in names}
    return time[known], rows


def _topic_of(
    path: Path, bag: Any, role: str, chosen: Sequence[str] | None
) -> str | None:
    """Return the topic of a role: the chosen one, or the only one that can be it."""
    if chosen is not None:
        names = {column.partition(".")[0] for column in chosen}
        for name in names - set(bag.topics):
            hint = did_you_mean(name, bag.topics)
            raise RecordError(
                f"{path}: no topic {name!r}{hint}; there are {', '.join(bag.topics)}"
            )
        if len(names) > 1:
            raise RecordError(
                f"{path}: the {role} is on several topics: {', '.join(sorted(names))}"
            )
        return next(iter(names))
    kinds = {
        "position": ("Pose", "Point", "Odometry", "Transform"),
        "force": ("Wrench",),
    }[role]
    likely = [
        name
        for name, one in bag.topics.items()
        if (one.msgtype or "").rpartition("/")[2].startswith(kinds)
    ]
    if len(likely) > 1:
        raise RecordError(
            f"{path}: several topics may be the {role}: {', '.join(likely)}; choose with"
            f" {words.get().columns({role: likely[0]})}"
        )
    return likely[0] if likely else None


def _series(bag: Any, topic: str) -> tuple[Column, dict[str, Column]]:
    """Return times [ns] and the numbers of each message of a topic, in the order of time."""
    import numpy as np

    stamps: list[int] = []
    rows: list[dict[str, float]] = []
    lines = [line for line in bag.connections if line.topic == topic]
    for line, received, raw in bag.messages(connections=lines):
        message = bag.deserialize(raw, line.msgtype)
        stamps.append(_stamp(message) or received)
        rows.append(dict(_numbers(message, topic)))
    time = np.array(stamps, dtype=np.int64)
    order = np.argsort(time, kind="stable")
    columns = {
        name: np.array([row.get(name, np.nan) for row in rows])
        for name in (rows or [{}])[0]
    }
    return time[order], {name: values[order] for name, values in columns.items()}


def _stamp(message: Any) -> int:
    """Return the stamp in a message's header [ns]; 0 without one."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _numbers(message: Any, before: str) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message by path, but for its header."""
    import numpy as np

    count = 0
    waiting = [(before, message)]
    while waiting and count < _MOST:
        name, value = waiting.pop(0)
        if dataclasses.is_dataclass(value):
            waiting += [
                (f"{name}.{field.name}", getattr(value, field.name))
                for field in dataclasses.fields(value)
                if field.name not in ("header", "__msgtype__")
            ]
        elif isinstance(value, bool | int | float | np.number | np.bool_):
            count += 1
            yield name, float(value)
        elif _is_row(value):
            waiting += [
                (f"{name}.{part}", one)
                for part, one in zip(_parts_of(message, value), value, strict=True)
            ]


def _is_row(value: Any) -> bool:
    """Whether a value is a short row of numbers, such as the positions of joints."""
    dtype = getattr(value, "dtype", None)
    return dtype is not None and dtype.kind in "biuf" and 0 < len(value) <= _MOST


def _parts_of(message: Any, row: Any) -> Sequence[str]:
    """Return the names of a row's numbers: those of the joints if they have any, else places."""
    names = getattr(message, "name", None)
    if isinstance(names, list) and len(set(names)) == len(names) == len(row):
        return [str(name) for name in names]
    return [str(place) for place in range(len(row))]


def _fields(
    path: Path,
    role: str,
    topic: str,
    chosen: Sequence[str] | None,
    read: tuple[Column, dict[str, Column]],
) -> list[str]:
    """Return the columns of a role on its topic: those chosen, or its vector."""
    known = read[1]
    if chosen is not None and list(chosen) != [topic]:
        for name in chosen:
            if name not in known:
                hint = did_you_mean(name, known)
                raise RecordError(
                    f"{path}: no {name!r}{hint}; there are {', '.join(known)}"
                )
        return list(chosen)
    for field in VECTORS[role]:
        names = [f"{topic}.{field}.{axis}" for axis in "xyz"]
        if set(names) <= set(known):
            return names
    raise RecordError(
        f"{path}: {topic} has no {role} as a vector: {', '.join(known) or 'no number'}; choose with"
        f" {words.get().columns({role: f'{topic}.FIELD'})}"
    )


def _own(path: Path, bag: Any) -> ForeignTable:
    """Return the table of ticks of our own export: what a bag holds of it."""
    import numpy as np

    pose, force = (topic for topic in OWN[:2])
    lines = [line for line in bag.connections if line.topic == OWN[2]]
    facts = json.loads(
        next(
            bag.deserialize(raw, line.msgtype).data
            for line, _, raw in bag.messages(lines)
        )
    )
    rate = float(facts["manifest"].get("rate_hz", "nan"))
    time, values = _series(bag, pose)
    period = (
        1.0 / rate
        if SLOWEST <= rate <= FASTEST
        else float(np.median(np.diff(time))) * _NANO
    )
    seq = np.rint((time - time[0]) * _NANO / period).astype(np.int64)
    table: dict[str, Column] = {"seq": seq, "stamp": seq * period}

    def enter(name: str, topic: str, field: str, later: int = 0) -> None:
        at, found = _series(bag, topic)
        row = np.searchsorted(at, time)
        there = np.append(at, 0)[np.minimum(row, len(at))]
        hit = (row < len(at)) & (there == time)
        for axis in "xyz":
            column = np.full(len(time) + later, np.nan)
            column[: len(time)][hit] = found[f"{topic}.{field}.{axis}"][row[hit]]
            table[f"{name}_{axis}"] = column[later:]

    for axis in "xyz":
        table[f"position_{axis}"] = values[f"{pose}.pose.position.{axis}"]
    # A state reports the force of the tick before it.
    enter("force", force, "wrench.force", later=1)
    follows = np.append(np.diff(seq) == 1, False)
    for axis in "xyz":
        table[f"force_{axis}"] = np.where(follows, table[f"force_{axis}"], np.nan)
        table[f"mean_force_{axis}"] = table[f"force_{axis}"]
    for name, topic, field in (
        ("proxy", "/haptic/proxy/pose", "pose.position"),
        ("force_asked", "/haptic/coupling/force", "wrench.force"),
    ):
        if topic in bag.topics and bag.topics[topic].msgcount:
            enter(name, topic, field)
    table |= {"changed_at": np.zeros(len(seq)), "force_seq": seq}
    return ForeignTable(path, table, rate=1.0 / period)
