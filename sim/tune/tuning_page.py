"""A tuning told on one page: the verdict first, then device, law, what was predicted, what was measured."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from typing import Any

from sim.identify.identified_text import ROWS
from sim.tune.tuning_pictures import pictures
from sim.tune.tuning_text import SECTIONS, Row, number

STYLE = (
    ":root{color-scheme:light dark}body{font:15px/1.5 system-ui,sans-serif;max-width:56rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse}td,th{padding:.15rem .8rem .15rem 0;text-align:left;border-bottom:1px solid #8884;"
    "vertical-align:top}img{max-width:100%}.verdict{font-size:1.2rem;border-left:.4rem solid #c33;padding-left:.8rem}"
    ".holds{border-color:#393}.by{opacity:.75}img{border-radius:.4rem;margin:.6rem 0}"
    # In the dark a picture's paper is dark, too, and its colours stay what they are.
    "@media(prefers-color-scheme:dark){img{filter:invert(.9) hue-rotate(180deg)}}"
)

READ_IN = {"m": ("µm", 1e6), "s": ("ms", 1e3)}
"""Units in which a device's small lengths and times are read, and how many of them one SI unit has."""


def page(record: Mapping[str, Any]) -> str:
    """Write a tuning as HTML that needs no other file."""
    holds = " holds" if record.get("verified", {}).get("holds") else ""
    parts = [f'<h1>From a device to its law</h1><p class="verdict{holds}"><b>{_plain(record["headline"])}</b></p>']
    by = [("device", record.get("device")), ("date", record.get("date")), ("command", record.get("command"))]
    parts.append(f'<p class="by">{"<br>".join(f"{name}: {_plain(value)}" for name, value in by if value)}</p>')
    if record.get("interrupted"):
        parts.append(
            f"<p><b>Interrupted during {_plain(record['interrupted'])}</b>: what follows is what was known.</p>"
        )
    if record.get("not_put_back"):
        parts.append(f"<p><b>Not put back</b>: {_plain(record['not_put_back'])}</p>")
    if "identified" in record:
        parts += ["<h2>The device</h2>", _device(record["identified"])]
    for title, key, rows in SECTIONS:
        if key in record:
            parts += [f"<h2>{title}</h2>", _table(rows(record[key]))]
    parts += [f'<img alt="{name}" src="data:image/png;base64,{picture}">' for name, picture in pictures(record)]
    seen = '<meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">'
    head = f"{seen}<title>haptic tune</title><style>{STYLE}</style>"
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(parts)}</body></html>\n'


def _plain(value: object) -> str:
    return html.escape(str(value))


def _table(rows: Sequence[Row]) -> str:
    lines = "".join(f"<tr><td>{_plain(name)}</td><td>{_plain(value)}</td></tr>" for name, value in rows)
    return f"<table>{lines}</table>"


def _interval(low: float, high: float) -> str:
    if math.isclose(low, high, rel_tol=1e-12):
        return "exact"
    # What is known to three digits and better is record by how far it may be off.
    ends = number(low), number(high)
    return f"± {number((high - low) / 2.0)}" if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


def _device(record: Mapping[str, Any]) -> str:
    lines = ["<tr><th></th><th>value</th><th>95 % interval</th><th></th></tr>"]
    for key, _, name, unit in ROWS:
        one = record[key]
        if one["value"] is None:
            lines.append(f"<tr><td>{name}</td><td colspan=3>cannot tell: {_plain(one['why'])}</td></tr>")
        else:
            shown, factor = READ_IN.get(unit, (unit, 1.0))
            value, low, high = (factor * one[end] for end in ("value", "low", "high"))
            lines.append(
                f"<tr><td>{name}</td><td>{number(value)}</td><td>{_interval(low, high)}</td><td>{shown}</td></tr>"
            )
    refuted = (
        f"<p><b>The recording refutes this model: {_plain(record['why'])}</b></p>" if record.get("refuted") else ""
    )
    steps = record["residual_steps"]
    ended = f"The push ended: {_plain(record['stopped'])}. "
    residual = f"Residual {number(steps)} encoder steps; rounding alone leaves 0.29."
    return f"{refuted}<table>{''.join(lines)}</table><p>{ended}{residual}</p>"
