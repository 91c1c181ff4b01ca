"""A lit ball in parallel projection, by formula: the colour of each pixel."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

from nodes import view

_WEB = Path(view.__file__).parent / "web"
CENTRE, RADIUS = [0.045, 0.012, -0.02], 0.03

COLOURS = {
    name: tuple(bytes.fromhex(code))
    for name, code in re.findall(
        r"--([a-z-]+): #([0-9a-f]{6})\b",
        (_WEB / "style.css").read_text(encoding="utf-8").partition(":root[")[0],
    )
}
"""The light theme's."""

LIGHT = (0.35, -0.5, 0.79)
"""Where the light comes from."""


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    return math.fsum(x * y for x, y in zip(a, b, strict=True))


class Camera:
    """A parallel projection by formula: yaw about z, then pitch, the scene's box centred."""

    def __init__(self, yaw: float, pitch: float, width: float, height: float) -> None:
        sines, cosines = (
            (math.sin(yaw), math.sin(pitch)),
            (math.cos(yaw), math.cos(pitch)),
        )
        self.right = (cosines[0], sines[0], 0.0)
        self.up = (-sines[0] * sines[1], cosines[0] * sines[1], cosines[1])
        self.away = (-sines[0] * cosines[1], cosines[0] * cosines[1], -sines[1])
        low, high = (
            [f(0.0, c + s * RADIUS) for c in CENTRE]
            for f, s in ((min, -1.0), (max, 1.0))
        )
        self.middle = [0.5 * (a + b) for a, b in zip(low, high, strict=True)]
        self.pixels = 0.42 * min(width, height) / (0.5 * math.dist(low, high))

    def seen(self, point: Sequence[float]) -> tuple[float, float]:
        """Return pixels from the middle of the canvas, right and down."""
        apart = [a - b for a, b in zip(point, self.middle, strict=True)]
        return self.pixels * dot(apart, self.right), -self.pixels * dot(apart, self.up)

    def met(
        self, u: float, v: float, side: float = -1.0
    ) -> tuple[float, float, float] | None:
        """Return the ball's normal where the ray through a pixel meets its front (back: side 1)."""
        at = self.seen(CENTRE)
        aside, above = (
            (u - at[0]) / (self.pixels * RADIUS),
            -(v - at[1]) / (self.pixels * RADIUS),
        )
        rest = 1.0 - aside**2 - above**2
        if rest < 0.0:
            return None
        x, y, z = (
            aside * r + above * w + side * math.sqrt(rest) * a
            for r, w, a in zip(self.right, self.up, self.away, strict=True)
        )
        return x, y, z


def brightness(normal: Sequence[float]) -> float:
    """Return the light of a surface: half ambient, a little more from above, and one lamp."""
    lamp = dot(normal, LIGHT) / math.hypot(*LIGHT)
    return 0.5 * (0.8 + 0.2 * normal[2]) + 0.5 * max(0.0, lamp)


def shade(normal: Sequence[float], name: str = "solid") -> list[float]:
    """Return the colour of a face."""
    return [brightness(normal) * each for each in COLOURS[name]]
