"""Text of a tuning, with the same rows on the terminal and on the page."""

from collections.abc import Mapping
from typing import Any

from nodes.stability.every_delay import Certificate
from nodes.stability.rest import ComesToRest

TextRow = tuple[str, str]
_EVERY_DELAY = {
    Certificate.CERTIFIED: "yes",
    Certificate.UNSTABLE: "NO",
    Certificate.UNDECIDED: "not decided",
}
_AT_REST = {
    ComesToRest.PROVEN: "yes",
    ComesToRest.ESTIMATED: "by estimate",
    ComesToRest.NOT_PROVEN: "not proven",
}

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: Any, unit: str = "") -> str:
    """Format a number with three digits."""
    if value is None:
        return "unknown"
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if isinstance(value, str):
        return value
    digits = f"{float(f'{value:.3g}'):.15g}"
    if value and abs(value) < 1e-3:
        first, _, power = f"{value:.2e}".partition("e")
        digits = f"{first} × 10{str(int(power)).translate(_RAISED)}"
    return f"{digits.replace('-', '−')} {unit}".rstrip()


def _poses(record: Mapping[str, Any]) -> str:
    """Describe the share of other poses in a mass range."""
    lighter, heavier = record.get("poses_kg") or (0.0, 0.0)
    return (
        f", with {number(lighter)} less and {number(heavier)} more in other poses"
        if lighter or heavier
        else ""
    )


def _proven(record: Mapping[str, Any]) -> list[TextRow]:
    """Return the rows on the landing proof (THEORY.md §19); none in older records."""
    proof = record.get("landing_proof")
    if proof is None:
        return []
    told = (
        f"proven for {proof['cases']} devices and delays"
        if proof["proven"]
        else f"no proof: {proof['why']}"
    )
    return [(f"from any height ({proof['convention']})", told)]


def law_rows(record: Mapping[str, Any]) -> list[TextRow]:
    """Return the rows on the designed law."""
    asked = record["demand"]
    gain = record["gain_over_pd"]
    compared = (
        "not compared: one of them fails the drop test"
        if gain is None
        else f"{gain:.3g} times the best PD"
    )
    worst = [record["worst"]] if "worst" in record else []
    return [
        ("felt stiffness, H(1)", number(record["h1_n_per_m"], "N/m")),
        ("compared with PD for the same demand", compared),
        (
            "settles after every drop on a floor",
            "yes" if record["lands"] else "NO: it fails the drop test",
        ),
        *_proven(record),
        ("taps", ", ".join(f"{tap:.4g}" for tap in record["taps_n_per_m"]) + " N/m"),
        (
            "for masses",
            f"{number(asked['mass'][0])} to {number(asked['mass'][1])} kg{_poses(record)}",
        ),
        ("for delays", f"{number(asked['delay'][0])} to {number(asked['delay'][1])} ticks"),
        ("pole radius at most", number(asked["radius"])),
        *(("the worst case", f"{number(mass)} kg, {number(delay)} ticks") for mass, delay in worst),
        *(
            [("the model is refuted", record["model_refuted"])]
            if record.get("model_refuted")
            else []
        ),
    ]


def _grasped(record: Mapping[str, Any]) -> list[TextRow]:
    """Return the rows on the grasp of a stylus; none in older records."""
    if (judged := record.get("grasp")) is None:
        return []
    worst = judged["worst"]
    told = {Certificate.CERTIFIED: "stable, certified", Certificate.UNSTABLE: "NOT stable"}.get(
        worst["certified"], "stable at all points tried, not certified"
    )
    return [
        (
            "held like a stylus, 0.2 kg behind 380 to 770 N/m",
            f"{told}; pole radius {worst['radius']:.4f}",
        )
    ]


def _left_open(record: Mapping[str, Any]) -> list[TextRow]:
    """Return the rows on terms that the recording leaves open; none if the residual is noise."""
    if (radius := record.get("remainder_pole_radius")) is None:
        return []
    told = "NOT stable" if radius >= 1.0 else "stable"
    return [
        (
            "on what the recording leaves open",
            f"{told}; pole radius {radius:.4f} with {record['remainder_worst']}",
        )
    ]


def predicted_rows(record: Mapping[str, Any]) -> list[TextRow]:
    """Return the rows on the law's behaviour on the identified device."""
    knocked = record["edge_h1_n_per_m"]
    rest = record["limit_cycle_free"]
    later = record["stable_up_to_delay_ticks"]
    decided = record.get("every_delay_why") or _EVERY_DELAY[Certificate(record["every_delay"])]
    quiet = "unknown" if rest is None else _AT_REST[ComesToRest(rest)]
    return [
        (
            "edge, by knocks on the model",
            "none was found" if knocked is None else number(knocked, "N/m"),
        ),
        ("edge, by its poles", number(record["edge_linear_h1_n_per_m"], "N/m")),
        ("pole radius", f"{record['pole_radius']:.4f}"),
        ("drops that settle", f"{record['drops_settled']} of {record['drops']}"),
        (
            "stable up to a delay of",
            "100 ticks or more" if later is None else number(later, "ticks"),
        ),
        ("stable for every sequence of delays", decided),
        *_grasped(record),
        *_left_open(record),
        ("limit-cycle-free", quiet),
    ]


def verified_rows(record: Mapping[str, Any]) -> list[TextRow]:
    """Return the rows on the measurement."""
    edge, rested = record["edge_h1_n_per_m"], record["stiffest_at_rest_n_per_m"]
    ends, poles = record["edge_by_poles_between_n_per_m"], record["edge_by_poles_h1_n_per_m"]
    between = number(None) if ends is None else f"{number(ends[0])} to {number(ends[1], 'N/m')}"
    by_poles = between if poles is None else f"at least {number(poles, 'N/m')} ({between})"
    return [
        ("the law holds", number(record["holds"])),
        ("came to rest up to", "nothing" if rested is None else number(rested, "N/m")),
        (
            "edge, by knocks on the device",
            "none was found" if edge is None else number(edge, "N/m"),
        ),
        ("edge by poles, without the effect of friction", by_poles),
        ("compared with the prediction", record["edge_compared"]),
        ("knocks", f"{len(record['steps'])} stiffnesses; {record['ended']}"),
    ]


# Title, key and rows of each section.
SECTIONS = (
    ("The law", "designed", law_rows),
    ("Predicted for the device as identified", "predicted", predicted_rows),
    ("Measured on the device", "verified", verified_rows),
)


def text(record: Mapping[str, Any], files: Mapping[str, str]) -> str:
    """Return the report of a tuning for the terminal."""
    lines = [record["headline"]]
    if "identified" in record:
        from sim.identify.identified_text import from_figures
        from sim.identify.identified_text import text as device

        lines += [
            device(from_figures(record["identified"])),
            f"  the push ended: {record['identified']['stopped']}",
        ]
    for title, key, rows in SECTIONS:
        if key in record:
            lines += [title, *(f"  {name:50} {value}" for name, value in rows(record[key]))]
    if record.get("refused"):
        lines.append(f"stopped: {record['refused']}")
    if record.get("interrupted"):
        lines.append(f"interrupted during {record['interrupted']}; law and surface were restored")
    if record.get("not_put_back"):
        lines.append(f"NOT restored: {record['not_put_back']}")
    return "\n".join([*lines, *files.values()])
