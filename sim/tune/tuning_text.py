"""Text of a tuning, with the same rows on the terminal and on the page."""

from collections.abc import Mapping
from typing import Any

from sim.stability.every_delay import Certificate
from sim.stability.rest import ComesToRest
from sim.tune.record import DesignedStep, PredictedStep, TuneRecord, VerifiedStep

TextRow = tuple[str, str]
_EVERY_DELAY = {
    Certificate.CERTIFIED: "yes",
    Certificate.UNSTABLE: "NO",
    Certificate.UNDECIDED: "not decided",
    Certificate.TOO_WIDE: "not decided: they are over a tick apart",
}
_GRASPED = {
    Certificate.CERTIFIED: "stable, certified",
    Certificate.UNSTABLE: "NOT stable",
    Certificate.UNDECIDED: "stable at all points tried, not certified",
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


def _poses(poses: tuple[float, float]) -> str:
    """Describe the share of other poses in a mass range."""
    lighter, heavier = poses
    return (
        f", with {number(lighter)} less and {number(heavier)} more in other poses"
        if lighter or heavier
        else ""
    )


def law_rows(law: DesignedStep) -> list[TextRow]:
    """Return the rows on the designed law."""
    asked = law.demand
    gain = law.gain_over_pd
    proof = law.landing_proof
    (mass, delay) = law.worst
    compared = (
        "not compared: one of them fails the drop test"
        if gain is None
        else f"{gain:.3g} times the best PD"
    )
    proven = (
        f"proven for {proof.cases} devices and delays"
        if proof.proven
        else f"no proof: {proof.why}"
    )
    rows = [
        ("felt stiffness, H(1)", number(law.h1_n_per_m, "N/m")),
        ("compared with PD for the same demand", compared),
        (
            "settles after every drop on a floor",
            "yes" if law.lands else "NO: it fails the drop test",
        ),
        (f"from any height ({proof.convention})", proven),
        ("taps", ", ".join(f"{tap:.4g}" for tap in law.taps_n_per_m) + " N/m"),
        (
            "for masses",
            f"{number(asked.mass[0])} to {number(asked.mass[1])} kg{_poses(law.poses_kg)}",
        ),
        ("for delays", f"{number(asked.delay[0])} to {number(asked.delay[1])} ticks"),
        ("pole radius at most", number(asked.radius)),
        ("the worst case", f"{number(mass)} kg, {number(delay)} ticks"),
    ]
    return rows + (
        [("the model is refuted", law.model_refuted)] if law.model_refuted else []
    )


def predicted_rows(found: PredictedStep) -> list[TextRow]:
    """Return the rows on the law's behaviour on the identified device."""
    knocked, later = found.edge_h1_n_per_m, found.stable_up_to_delay_ticks
    held = found.grasp.worst
    left = found.remainder_pole_radius
    rest = found.limit_cycle_free
    rows = [
        (
            "edge, by knocks on the model",
            "none was found" if knocked is None else number(knocked, "N/m"),
        ),
        ("edge, by its poles", number(found.edge_linear_h1_n_per_m, "N/m")),
        ("pole radius", f"{found.pole_radius:.4f}"),
        ("drops that settle", f"{found.drops_settled} of {found.drops}"),
        (
            "stable up to a delay of",
            "100 ticks or more" if later is None else number(later, "ticks"),
        ),
        ("stable for every sequence of delays", _EVERY_DELAY[found.every_delay]),
        (
            "held like a stylus, 0.2 kg behind 380 to 770 N/m",
            f"{_GRASPED[held.certified]}; pole radius {held.radius:.4f}",
        ),
    ]
    if left is not None:
        told = "NOT stable" if left >= 1.0 else "stable"
        words = f"{told}; pole radius {left:.4f} with {found.remainder_worst}"
        rows.append(("on what the recording leaves open", words))
    return [*rows, ("limit-cycle-free", "unknown" if rest is None else _AT_REST[rest])]


def verified_rows(found: VerifiedStep) -> list[TextRow]:
    """Return the rows on the measurement."""
    edge, rested = found.edge_h1_n_per_m, found.stiffest_at_rest_n_per_m
    ends, poles = found.edge_by_poles_between_n_per_m, found.edge_by_poles_h1_n_per_m
    between = (
        number(None)
        if ends is None
        else f"{number(ends[0])} to {number(ends[1], 'N/m')}"
    )
    by_poles = (
        between if poles is None else f"at least {number(poles, 'N/m')} ({between})"
    )
    return [
        ("the law holds", number(found.holds)),
        ("came to rest up to", "nothing" if rested is None else number(rested, "N/m")),
        (
            "edge, by knocks on the device",
            "none was found" if edge is None else number(edge, "N/m"),
        ),
        ("edge by poles, without the effect of friction", by_poles),
        ("compared with the prediction", found.edge_compared),
        ("knocks", f"{len(found.steps)} stiffnesses; {found.ended}"),
    ]


def sections(record: TuneRecord) -> list[tuple[str, list[TextRow]]]:
    """Return title and rows of each section that there is."""
    found = []
    if record.designed is not None:
        found.append(("The law", law_rows(record.designed)))
    if record.predicted is not None:
        title = "Predicted for the device as identified"
        found.append((title, predicted_rows(record.predicted)))
    if record.verified is not None:
        found.append(("Measured on the device", verified_rows(record.verified)))
    return found


def text(record: TuneRecord, files: Mapping[str, str]) -> str:
    """Return the report of a tuning for the terminal."""
    from sim.identify.identified_text import text as device

    lines = [record.headline]
    if (known := record.identified) is not None:
        lines += [device(known.found), f"  the push ended: {known.stopped}"]
    for title, rows in sections(record):
        lines += [title, *(f"  {name:50} {value}" for name, value in rows)]
    if record.refused:
        lines.append(f"stopped: {record.refused}")
    if record.interrupted:
        lines.append(
            f"interrupted during {record.interrupted}; law and surface were restored"
        )
    if record.not_put_back:
        lines.append(f"NOT restored: {record.not_put_back}")
    return "\n".join([*lines, *files.values()])
