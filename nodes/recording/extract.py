"""A part of a recording as a recording: a while of it, or some of its topics; what was recorded with it comes along."""

from __future__ import annotations

import math
from collections.abc import Collection
from pathlib import Path

from nodes.recording.export import begin_of
from nodes.recording.reader import Recording
from nodes.recording.recover import Copy
from nodes.recording.writer import Output, RecordError, discard, mcap_writer, versions

EXTRACT = "extract"
"""Name of the metadata record that tells which part of which file it is."""


def extract(
    recording: Recording,
    out: Path,
    topics: Collection[str],
    start: float = 0.0,
    stop: float = math.inf,
    *,
    overwrite: bool = False,
) -> dict[str, int]:
    """Copy the messages of some topics whose stamps lie in a while, in seconds from the first tick on; how many of each."""
    if out.exists() and out.samefile(recording.path):
        raise RecordError(f"{out}: is the recording itself; give another name")
    zero = round(begin_of(recording) * 1e9)
    low = zero + round(start * 1e9)
    high = math.inf if math.isinf(stop) else zero + round(stop * 1e9)
    output = Output(out, overwrite)
    try:
        copy = Copy(
            mcap_writer(output, f"haptic-nodes {versions()['haptic-nodes']}"), recording.schemas, recording.channels
        )
        for name, values in recording.metadata.items():
            copy.writer.add_metadata(name, values)
        part = {"source": str(recording.path), "from_s": repr(start), "to_s": repr(stop)}
        copy.writer.add_metadata(EXTRACT, part)
        for topic, raw, _ in recording.raw():
            if topic in topics and low <= raw.publish_time - recording.publish_offset <= high:
                copy.message(raw)
        if not copy.counts:
            raise RecordError(f"{recording.path}: no message of these topics from {start:g} s to {stop:g} s")
        copy.writer.finish()
    except RecordError:
        discard(out)
        raise
    finally:
        output.close()
    return copy.counts
