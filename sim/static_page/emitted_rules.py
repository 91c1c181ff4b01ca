"""The rules that a page's worker plays, emitted from the functions of the nodes."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any, Final

from nodes import arithmetic
from nodes.compiled import memory
from nodes.coupling.render import deflection_along, evaluate, make_render
from nodes.coupling.state import LEAVING, SLOTS
from nodes.driver.safety import rearm
from nodes.driver.state import STOPPED
from nodes.driver.tick import GOT, make_ticks
from nodes.environment.meet import meet
from nodes.environment.note_tick import note_tick
from nodes.environment.shapes import tables
from nodes.environment.state import DAMPING, JUMPED, SHAPES, STIFFNESS, tell_jump
from nodes.view.ringing import is_ringing, observe_stroke
from sim.device.model import coefficients
from sim.device.state import read_axis, write_axis
from sim.javascript.emitter import Emitter
from sim.javascript.values import value
from sim.play.compiled import pushed_force, windowed_force

_WEB: Final = Path(__file__).with_name("web")
_ROOTS: Final[tuple[Any, ...]] = (
    make_ticks,
    make_render,
    rearm,
    meet,
    note_tick,
    tell_jump,
    read_axis,
    write_axis,
    coefficients,
    deflection_along,
    evaluate,
    arithmetic.newest_gain,
    arithmetic.revise_sections,
    arithmetic.sections,
    arithmetic.settle,
    arithmetic.warm_up,
    pushed_force,
    windowed_force,
    observe_stroke,
    is_ringing,
)
_HOST: Final = {
    getattr(memory, name): name
    for name in (
        "reals_at",
        "wholes_at",
        "pairs_at",
        "shared_whole",
        "shared_real",
        "monotonic",
    )
}


_CONSTANTS: Final = {
    "SHAPES_": SHAPES,
    "JUMPED_": JUMPED,
    "STIFFNESS_": STIFFNESS,
    "DAMPING_": DAMPING,
    "PLACED_": tables.PLACED,
    "NEVER_": tables.NEVER,
    "INSIDE_": tables.INSIDE,
    "SHAPES_COUNT_": tables.SHAPES,
    "ROWS_": tables.ROWS,
    "ROW_": tables.ROW,
    "SHIFT_": tables.SHIFT,
    "SPEED_": tables.SPEED,
    "LEAVING_": LEAVING,
    "SLOTS_": SLOTS,
    "GOT_": GOT,
    "STOPPED_": STOPPED,
}


# Spaces that mean nothing in emitted code, which has no text with spaces; not around + and −.
_SPACES: Final = re.compile(r" ?([{}()\[\],;=<>*/?:&|]) ?")


@cache
def emitted() -> Emitter:
    """Return the emitted rules."""
    emitter = Emitter(_HOST)
    emitter.reserve(_ROOTS)
    for root in _ROOTS:
        emitter.function(root)
    return emitter


def player() -> str:
    """Return the JavaScript of a loop: memory, rules and the nodes around them."""
    constants = "".join(constant(name, one) for name, one in _CONSTANTS.items())
    rules = _SPACES.sub(r"\1", emitted().text)
    return script("memory") + constants + rules + script("player")


def script(name: str) -> str:
    """Return a script of this package."""
    return (_WEB / f"{name}.js").read_text(encoding="utf-8")


def constant(name: str, data: Any) -> str:
    """Return data as the definition of a JavaScript constant."""
    return f"const {name} = {value(data)};\n"
