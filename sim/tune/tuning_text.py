"""A tuning told to people: the same rows on the terminal and on the page, in words and units, with three digits."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

Row = tuple[str, str]


def number(value: Any, unit: str = "") -> str:
    """Write a figure with three digits."""
    if value is None:
        return "cannot tell"
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if isinstance(value, str):
        return value
    shown = f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
    return f"{shown} {unit}".rstrip()


def _poses(told: Mapping[str, Any]) -> str:
    """Tell what of a range of masses is that of other poses."""
    lighter, heavier = told.get("poses_kg") or (0.0, 0.0)
    return f", with {number(lighter)} less and {number(heavier)} more in other poses" if lighter or heavier else ""


def law_rows(told: Mapping[str, Any]) -> list[Row]:
    """Tell the designed law."""
    asked = told["demand"]
    gain = told["gain_over_pd"]
    compared = "no ratio: only laws that both land are compared" if gain is None else f"{gain:.3g} times the best PD"
    return [
        ("stiffness that is felt, H(1)", number(told["h1_n_per_m"], "N/m")),
        ("beside PD of the same demand", compared),
        ("settles after every drop on a floor", "yes" if told["lands"] else "NO: it does not survive a landing"),
        ("taps", ", ".join(number(tap) for tap in told["taps_n_per_m"]) + " N/m"),
        ("for masses", f"{number(asked['mass'][0])} to {number(asked['mass'][1])} kg{_poses(told)}"),
        ("for delays", f"{number(asked['delay'][0])} to {number(asked['delay'][1])} ticks"),
        ("pole radius at most", number(asked["radius"])),
        *(
            [("the worst case", f"{number(told['worst'][0])} kg, {number(told['worst'][1])} ticks")]
            if "worst" in told
            else []
        ),
        *([("the model is refuted", told["model_refuted"])] if told.get("model_refuted") else []),
    ]


def predicted_rows(told: Mapping[str, Any]) -> list[Row]:
    """Tell what the law does on the identified device."""
    knocked = told["edge_h1_n_per_m"]
    rest = told["limit_cycle_free"]
    later = told["stable_up_to_delay_ticks"]
    every = told["every_delay_stable"]
    decided = told.get("every_delay_why") or ("not decided" if every is None else number(every))
    quiet = {True: "yes", "estimated": "by estimate", None: "cannot tell"}.get(rest, "NO")
    return [
        ("edge, by knocks on the model", "none was found" if knocked is None else number(knocked, "N/m")),
        ("edge, by its poles", number(told["edge_linear_h1_n_per_m"], "N/m")),
        ("pole radius", f"{told['pole_radius']:.4f}"),
        ("drops that settle", f"{told['drops_settled']} of {told['drops']}"),
        ("stable up to a delay of", "100 ticks and on" if later is None else number(later, "ticks")),
        ("stable for every sequence of delays", decided),
        ("comes to rest without a buzz", quiet),
    ]


def verified_rows(told: Mapping[str, Any]) -> list[Row]:
    """Tell what was measured."""
    edge, rested = told["edge_h1_n_per_m"], told["stiffest_at_rest_n_per_m"]
    ends, poles = told["edge_by_poles_between_n_per_m"], told["edge_by_poles_h1_n_per_m"]
    between = number(None) if ends is None else f"{number(ends[0])} to {number(ends[1], 'N/m')}"
    return [
        ("the law holds", number(told["holds"])),
        ("came to rest up to", "nothing" if rested is None else number(rested, "N/m")),
        ("edge, by knocks on the device", "none was found" if edge is None else number(edge, "N/m")),
        (
            "edge, by poles: less what friction lends a knock",
            between if poles is None else f"{number(poles, 'N/m')} ({between})",
        ),
        ("beside the prediction", told["edge_compared"]),
        ("knocks", f"{len(told['steps'])} stiffnesses; {told['ended']}"),
    ]


SECTIONS = (
    ("The law", "designed", law_rows),
    ("Predicted for the device as identified", "predicted", predicted_rows),
    ("Measured on the device", "verified", verified_rows),
)
"""Title, key and rows of each part."""


def text(told: Mapping[str, Any], files: Mapping[str, str]) -> str:
    """Tell the outcome on a terminal."""
    lines = [told["headline"]]
    if "identified" in told:
        from sim.identify.identified_text import from_figures
        from sim.identify.identified_text import text as device

        lines += [device(from_figures(told["identified"])), f"  the push ended: {told['identified']['stopped']}"]
    for title, key, rows in SECTIONS:
        if key in told:
            lines += [title, *(f"  {name:50} {value}" for name, value in rows(told[key]))]
    if told.get("refused"):
        lines.append(f"stopped: {told['refused']}")
    if told.get("interrupted"):
        lines.append(f"interrupted during {told['interrupted']}; the law and the surface that were there are back")
    if told.get("not_put_back"):
        lines.append(f"NOT put back: {told['not_put_back']}")
    return "\n".join([*lines, *files.values()])
