"""Forces from outside the loop (a ROS 2 graph, a program): taken on top of the law's, before ramp, guard and limits.

Nobody may push a device unasked: the launch file allows it, with the largest force and the age at
which one that is not renewed counts as gone. Who gives a force is a control thread; the tick reads
it where it stands. There are two places, and the one that counts is named by a single number, so a
tick never sees half of a force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any

import msgspec

from messages.types import ZERO, Vector
from nodes.driver.state import DriverState
from nodes.parameters.store import ParameterError, convert


class ExternalParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which forces from outside a driver takes.

    peak: Largest norm of such a force [N]; a larger one is lowered to it.
    age: After so long without a new one it counts as gone [s].
    """

    peak: Annotated[float, msgspec.Meta(gt=0.0)] = 1.0
    age: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 0.1


def give(
    s: DriverState, allowed: ExternalParameters | None, where: str, force: Sequence[float]
) -> dict[str, Any]:
    """Let a force act from the next tick on, until it is renewed or too old (control thread)."""
    if allowed is None:
        raise ParameterError(
            f"{where}.external: no force from outside is taken; allow it in the launch file with "
            "external: {peak: 1.0, age: 0.1}"
        )
    x, y, z = convert(force, Vector, f"{where}.external.force")
    computed = list(s.axis[: s.axes])
    for i, part in enumerate((x, y, z)):
        if part != 0.0 and i not in computed:
            named = ", ".join("xyz"[n] for n in computed)
            raise ParameterError(
                f"{where}.external.force: {part:g} N along {'xyz'[i]}, but run.axes is [{named}]:"
                " nothing would be felt there; leave it 0, or name all axes"
            )
    norm = math.hypot(x, y, z)
    share = min(1.0, allowed.peak / norm) if norm > 0.0 else 1.0
    other = 1 - s.external_at
    for i, part in enumerate((x, y, z)):
        s.external[3 * other + i] = part * share
    s.external_until[other] = s.seq + math.ceil(allowed.age / s.period) if norm > 0.0 else 0
    s.external_at = other
    given = (x * share, y * share, z * share) if norm > 0.0 else ZERO
    return {"force_n": given, "lowered": share < 1.0, "age_s": allowed.age}
