"""A tuning told on one page: the device with its intervals, the law, what was predicted, what was measured."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from typing import Any

from sim.identify.report import ROWS


def page(told: Mapping[str, Any]) -> str:
    """Write a tuning as HTML that needs no other file."""
    parts = ["<h1>From a device to its law</h1>"]
    if told.get("interrupted"):
        parts.append(
            f"<p><b>Interrupted during {html.escape(str(told['interrupted']))}</b>: what follows is what was known.</p>"
        )
    if "identified" in told:
        parts += ["<h2>Device</h2>", _device(told["identified"])]
    if "designed" in told:
        parts += ["<h2>Law</h2>", _table([(key, value) for key, value in told["designed"].items() if key != "law"])]
    if "predicted" in told:
        parts += ["<h2>Predicted</h2>", _table(list(told["predicted"].items()))]
    if "verified" in told:
        known = [(key, value) for key, value in told["verified"].items() if key != "steps"]
        parts += ["<h2>Measured on the real loop</h2>", _table(known)]
    picture = _picture(told)
    if picture:
        parts.append(f'<img alt="what is left of each knock" src="data:image/png;base64,{picture}">')
    style = (
        "body{font:15px/1.5 system-ui,sans-serif;max-width:56rem;margin:2rem auto;padding:0 1rem;color-scheme:light dark}"
        "table{border-collapse:collapse}td,th{padding:.15rem .8rem .15rem 0;text-align:left;border-bottom:1px solid #8884}"
        "img{max-width:100%}"
    )
    head = f'<meta charset="utf-8"><title>haptic tune</title><style>{style}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(parts)}</body></html>\n'


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, list):
        return ", ".join(_shown(one) for one in value)
    return "—" if value is None else html.escape(str(value))


def _table(rows: Sequence[tuple[str, Any]]) -> str:
    lines = "".join(f"<tr><td>{html.escape(name)}</td><td>{_shown(value)}</td></tr>" for name, value in rows)
    return f"<table>{lines}</table>"


def _device(told: Mapping[str, Any]) -> str:
    lines = ["<tr><th></th><th>value</th><th>95 % interval</th><th></th></tr>"]
    for key, _, name, unit in ROWS:
        one = told[key]
        if one["value"] is None:
            lines.append(f"<tr><td>{name}</td><td colspan=3>cannot tell: {html.escape(one['why'])}</td></tr>")
        else:
            interval = f"{_shown(one['low'])} to {_shown(one['high'])}"
            lines.append(f"<tr><td>{name}</td><td>{_shown(one['value'])}</td><td>{interval}</td><td>{unit}</td></tr>")
    steps = told["residual_steps"]
    return f"<table>{''.join(lines)}</table><p>Residual {_shown(steps)} encoder steps; rounding alone leaves 0.29.</p>"


def _picture(told: Mapping[str, Any]) -> str:
    """Draw what is left of each knock against the stiffness; empty before anything was knocked on."""
    if "predicted" not in told or "steps" not in told["predicted_steps"]:
        return ""
    from matplotlib.figure import Figure

    h1 = told["predicted"]["h1_n_per_m"]
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    axes = figure.subplots()
    runs = [("predicted", told["predicted_steps"]["steps"], "o-")]
    if "verified" in told:
        runs.append(("measured", told["verified"]["steps"], "s-"))
    for name, steps, style in runs:
        axes.plot(
            [h1 * step["factor"] for step in steps],
            [max(step["left"], 1e-3) for step in steps],
            style,
            ms=4,
            label=name,
        )
    axes.axhline(0.5, color="k", linestyle="--", lw=0.8)
    axes.axvline(
        told["predicted"]["edge_linear_h1_n_per_m"], color="k", lw=0.8, alpha=0.4, label="pole on the unit circle"
    )
    axes.set(yscale="log", xlabel="stiffness H(1) [N/m]", ylabel="left of a knock after the window")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110, format="png")
    return base64.b64encode(buffer.getvalue()).decode("ascii")
