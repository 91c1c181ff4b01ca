"""Proxy error against call time: closed forms, meshes by level of detail, a dynamic tool."""

from collections.abc import Callable

from nodes.parameters.store import ParameterError
from sim.lab.charts.points import Group, Point
from sim.lab.proxies import RADIUS, STEPS, ProxyError, body_error, compare_proxies

_FINEST, _QUICK_FINEST, _TICKS, _QUICK_TICKS = 6, 3, 4000, 800
_STIFFNESS, _DEPTH, _SPEED, _PERIOD = 500.0, 4e-3, 0.2, 1e-3


def proxy_steps(quick: bool = False) -> int:
    """Return the number of steps of `proxy_groups`."""
    return 1 + len(_ways(quick))


def _ways(quick: bool) -> list[tuple[float, bool]]:
    """Return scene steps [s], each with MuJoCo's default and the stiffest contacts."""
    return [
        (step, stiff)
        for step in (STEPS[1:2] if quick else STEPS)
        for stiff in (False, True)
    ]


def proxy_groups(step: Callable[[str], None], quick: bool = False) -> list[Group]:
    """Move a tool along surfaces whose proxy is a closed form; return the groups."""
    found = compare_proxies(
        _QUICK_FINEST if quick else _FINEST, _QUICK_TICKS if quick else _TICKS
    )
    step("proxies on closed forms and meshes")
    points = [_point(row) for row in found]
    note = ""
    for size, stiff in _ways(quick):
        try:
            row = body_error(
                size,
                _QUICK_TICKS if quick else _TICKS,
                _STIFFNESS,
                _DEPTH,
                _SPEED,
                _PERIOD,
                stiff,
            )
        except ParameterError as error:
            note = f" Bodies are left out: {error}."
            break
        points.append(_point(row, is_body=True))
        step(row.name)
    return [
        Group(
            "proxy_error",
            "Proxy in three dimensions: its error against the time of a call",
            "time of a call, median, compiled [µs]",
            "largest error of the proxy [µm]",
            tuple(points),
            f"Led {1e3 * _DEPTH:g} mm below the surface at {_SPEED:g} m/s and {1.0 / _PERIOD:g} Hz;"
            f" a sphere of {1e3 * RADIUS:g} mm, in closed form, of triangles, and as a body that is"
            " held and touched by a tool of 50 g. A closed form is off by the skin that keeps the"
            " proxy outside; a mesh by its chords; a tool by the depth of its contact and by its"
            f" mass. `haptic lab proxies` has the forces, and the drag on closed ways.{note}",
            families=True,
        )
    ]


def _point(row: ProxyError, is_body: bool = False) -> Point:
    detail = {
        key: getattr(row, key)
        for key in ("triangles", "rms_n", "noise_n", "drag", "call_p99_us", "rounds")
    }
    name = f"mesh {row.triangles}" if row.triangles else row.name
    family = "body" if is_body else "mesh" if row.triangles else "closed form"
    return Point(name, row.call_us, row.proxy_um, family, detail)
