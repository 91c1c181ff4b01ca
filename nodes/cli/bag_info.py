"""What a recording holds: topics, counts, gaps, losses and clocks."""

import argparse
import contextlib
from collections.abc import Mapping
from datetime import datetime

from messages.topics import DEVICE_STATE
from nodes.cli.main import answer
from nodes.recording.accounts import ClockRecord, Completeness, clocks, completeness
from nodes.recording.facts import period_of, stamped_rate
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError


def _info_text(
    recording: Recording, verdict: Completeness, remote: Mapping[str, ClockRecord]
) -> str:
    lines = [str(recording.path)]
    facts = dict(recording.manifest)
    with contextlib.suppress(KeyError, ValueError, OverflowError):
        begin = recording.first_log + float(facts["wall_minus_monotonic_s"])
        facts["started"] = (
            datetime.fromtimestamp(begin).astimezone().isoformat(" ", "seconds")
        )
    for name in ("scenario", "run", "imported", "started", "host", "pace", "rate_hz"):
        if name in facts:
            lines.append(f"  {name:9} {facts[name]}")
    stamped = stamped_rate(recording)
    if "rate_hz" not in facts and stamped is not None:
        lines.append(f"  {'rate_hz':9} {stamped:g} by the stamps; the file names none")
    lines.append(
        f"  {'duration':9} {recording.duration:.6g} s (recorded in {recording.wall_duration:.6g} s)"
    )
    lines.append(f"  {'state':9} {verdict.text}")
    if recording.cut:
        lines.append(f"  {'':9} {recording.cut}")
    lines += [f"  {'':9} {text}" for text in _contradictions(recording)]
    width = max(map(len, recording.topics), default=5)
    lines.append(
        f"  {'topic':{width}} {'messages':>9} {'rate [Hz]':>10} {'gaps':>6} {'repeats':>8}"
    )
    for topic, figures in recording.topics.items():
        lines.append(
            f"  {topic:{width}} {figures.messages:9} {figures.rate:10.6g} {figures.gaps:6}"
            f" {figures.back:8}"
        )
    lines += [
        f"  {topic}: {one.messages} messages, not read: {one.text}"
        for topic, one in recording.foreign.items()
    ]
    if verdict.left_out:
        lines.append(
            f"  ticks left out by the driver, late by a whole period: {verdict.left_out} (gaps"
            " on every topic, no losses)"
        )
    for node, account in verdict.nodes.items():
        lines.append(f"  {node}: {account.text}")
    for node, clock in remote.items():
        lines.append(
            f"  {node}: clock {-clock.offset:+.6f} s from the launcher's, known to"
            f" ±{clock.error * 1e6:.0f} µs"
        )
    return "\n".join(lines)


def _contradictions(recording: Recording) -> list[str]:
    """Return what the manifest says against the stamps."""
    if "rate_hz" in recording.manifest and DEVICE_STATE in recording.topics:
        try:
            period_of(recording)
        except RecordError as error:
            return [str(error).removeprefix(f"{recording.path}: ")]
    return []


def show_info(arguments: argparse.Namespace) -> int:
    """Print facts, topics, counts and losses of a recording."""
    recording = Recording(arguments.file)
    verdict = completeness(recording)
    times = clocks(recording)
    remote = {node: clock for node, clock in times.items() if clock.error}
    figures = {
        "file": str(recording.path),
        "parts": [str(path) for path in recording.parts],
        "duration_s": recording.duration,
        "wall_duration_s": recording.wall_duration,
        "topics": {
            topic: {
                "messages": figures.messages,
                "gaps": figures.gaps,
                "repeats": figures.back,
                "first_seq": figures.first_seq,
                "last_seq": figures.last_seq,
                "rate_hz": figures.rate,
            }
            for topic, figures in recording.topics.items()
        },
        "foreign": {
            topic: {
                "messages": one.messages,
                "encoding": one.encoding,
                "schema": one.schema,
            }
            for topic, one in recording.foreign.items()
        },
        "nodes": {
            node: {
                "sent": account.sent,
                "recorded": account.recorded,
                "lost": account.lost,
            }
            for node, account in verdict.nodes.items()
        },
        "clocks": {
            node: {"offset_s": clock.offset, "error_s": clock.error}
            for node, clock in times.items()
        },
        "lost": verdict.lost,
        "overruns": verdict.left_out,
        "recovered": recording.recovered,
        "complete": recording.complete,
        "cut": recording.cut,
        "manifest": recording.manifest,
    }
    return answer(arguments.json, figures, _info_text(recording, verdict, remote))
