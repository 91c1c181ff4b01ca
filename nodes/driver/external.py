"""Forces from outside the loop (ROS 2, a program), added to the law's before the limits.

The launch file must allow them, with the largest force and the age at which a force that is not
renewed expires. A control thread writes the force, the tick reads it in place. There are two
places, and a single number selects the valid one, so that a tick never reads half a force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any

import msgspec

from messages.types import ZERO, Vector
from nodes.driver.state import DriverState
from nodes.parameters.store import ParameterError, convert


class ExternalParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Forces from outside that a driver accepts.

    peak: Largest norm of such a force [N]; a larger one is lowered to it.
    age: Time without a new force after which the last one expires [s].
    """

    peak: Annotated[float, msgspec.Meta(gt=0.0)] = 1.0
    age: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 0.1


def give(
    s: DriverState,
    allowed: ExternalParameters | None,
    where: str,
    force: Sequence[float],
) -> dict[str, Any]:
    """Apply a force from the next tick on, until it is renewed or expires (control thread)."""
    if allowed is None:
        raise ParameterError(
            "no force from outside is taken; allow it in the launch file with "
            "external: {peak: 1.0, age: 0.1}",
            path=f"{where}.external",
        )
    x, y, z = convert(force, Vector, f"{where}.external.force")
    computed = list(s.axis[: s.axes])
    for i, part in enumerate((x, y, z)):
        if part != 0.0 and i not in computed:
            named = ", ".join("xyz"[n] for n in computed)
            raise ParameterError(
                f"{part:g} N along {'xyz'[i]}, but run.axes is [{named}]:"
                " nothing would be felt there; leave it 0, or name all axes",
                path=f"{where}.external.force",
            )
    norm = math.hypot(x, y, z)
    share = min(1.0, allowed.peak / norm) if norm > 0.0 else 1.0
    other = 1 - s.external_at
    for i, part in enumerate((x, y, z)):
        s.external[3 * other + i] = part * share
    s.external_until[other] = (
        s.seq + math.ceil(allowed.age / s.period) if norm > 0.0 else 0
    )
    s.external_at = other
    given = (x * share, y * share, z * share) if norm > 0.0 else ZERO
    return {"force_n": given, "lowered": share < 1.0, "age_s": allowed.age}
