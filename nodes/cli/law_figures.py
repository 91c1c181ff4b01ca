"""Figures of laws as text: what a law renders, alone or before and after a switch."""

from __future__ import annotations

from typing import Any

ROWS = (
    ("h1_n_per_m", "H(1), stiffness felt at rest", "N/m"),
    ("h_nyquist_n_per_m", "H(−1), gain of encoder noise", "N/m"),
    (
        "f_min_n_s_per_m",
        "least f(ω), H(1) as spring (the lower, the more damping)",
        "N s/m",
    ),
    ("f_nyquist_n_s_per_m", "f(ω_N), H(1) as spring", "N s/m"),
    ("damping_needed_n_s_per_m", "device damping needed to be passive", "N s/m"),
    ("delay_ticks", "delay of the loop", "ticks"),
    ("pole_radius", "pole radius (stable below 1)", ""),
)

LEAK = 0.05  # relative difference between H(1) and K above which a warning is shown


def short_value(value: Any) -> str:
    """Return a parameter of a law in a few words."""
    if isinstance(value, list) and len(value) > 4:
        return f"[{len(value)} values]"
    if isinstance(value, list) and value and isinstance(value[0], dict):
        terms = (
            ", ".join(f"{key} {inner}" for key, inner in term.items()) for term in value
        )
        return f"[{'; '.join(terms)}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def figure_table(columns: dict[str, dict[str, Any]]) -> list[str]:
    """Return a table of the figures of one or two laws."""
    wide = max(len(label) for _, label, _ in ROWS)
    lines = []
    if len(columns) > 1:
        lines.append(f"  {'':{wide}}  " + "  ".join(f"{name:>14}" for name in columns))
    for key, label, unit in ROWS:
        values = [figures.get(key) for figures in columns.values()]
        if any(value is not None for value in values):
            shown = "  ".join(
                f"{'—' if value is None else format(value, '.6g'):>14}"
                for value in values
            )
            lines.append(f"  {label:{wide}}  {shown} {unit}".rstrip())
    return lines


def leak_warning(figures: dict[str, Any]) -> list[str]:
    """Return a warning if H(1) differs from K because the taps of a short memory leak."""
    nominal = figures.get("stiffness")
    felt = figures["h1_n_per_m"]
    if (
        not isinstance(nominal, int | float)
        or felt is None
        or figures["h_nyquist_n_per_m"] is None
    ):
        return []
    if abs(felt - nominal) <= LEAK * max(abs(nominal), abs(felt)):
        return []
    return [
        f"  warning: H(1) is {felt:.6g} N/m and K {nominal:.6g} N/m, because a short memory leaks:"
        " use more taps, or sections"
    ]
