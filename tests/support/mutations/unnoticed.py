"""Places that are not mutated because no behaviour depends on them, each with its reason.

What a text says, an annotation or a figure's looks has no oracle but itself, and counting it would
measure nothing. A change of one place that gives an equal program is a row of `EQUIVALENT`.
"""

from __future__ import annotations

import ast
from typing import Final, NamedTuple

NO_CODE: Final = frozenset({"annotation", "returns", "decorator_list", "ctx"})
"""Parts of a node that no call executes with another result."""

TEXTS: Final = frozenset({"__repr__", "__str__"})
"""Functions that only describe a value to a reader."""

LOOKS: Final = frozenset(
    (
        *(
            "alpha",
            "bbox_to_anchor",
            "borderaxespad",
            "dpi",
            "figsize",
            "fontsize",
            "labelpad",
            "linewidth",
            "lw",
            "ms",
            "pad",
        ),
        *("handlelength", "markersize", "rasterized", "zorder", "LINES", "PAGE_WIDTH"),
    )
)
"""Arguments, keys and constants that say how a line or letter of a figure looks."""

_STYLE: Final = (
    "axes.",
    "font.",
    "grid.",
    "legend.",
    "lines.",
    "pdf.",
    "xtick.",
    "ytick.",
)
"""Beginnings of matplotlib's settings of the same."""


class Equivalent(NamedTuple):
    """A change that gives an equal program: its file, its line without indent, and why."""

    file: str
    line: str
    old: str
    new: str
    why: str


EQUIVALENT: Final[tuple[Equivalent, ...]] = (
    Equivalent(
        "sim/identify/identified_motion.py",
        "if state[1] * direction > 0.0:",
        "state[1] * direction > 0.0",
        "(not (state[1] * direction > 0.0))",
        "a secant through the last two points meets the zero from either end: equal to 1e-16",
    ),
    Equivalent(
        "nodes/recording/table.py",
        "if len(block) == _WINDOW:",
        "len(block) == _WINDOW",
        "(not (len(block) == _WINDOW))",
        "the same rows in blocks of another length, which readers join",
    ),
    Equivalent(
        "sim/identify/judge_fit.py",
        "DRAWS = 40  # simulated residuals of a valid model",
        "40",
        "41",
        "one more draw of a distribution whose share of 1/40 decides nothing",
    ),
    Equivalent(
        "nodes/driver/paired/paired_device.py",
        "self._read_at = -1",
        "1",
        "2",
        "any negative number stands for a pair that was never read",
    ),
    Equivalent(
        "nodes/driver/motion.py",
        'places = array("d", [0.0]) * (3 * s.places_count)',
        "3",
        "4",
        "room for a quarter more samples than are ever kept",
    ),
    Equivalent(
        "nodes/driver/forcedimension/driver.py",
        "version = ctypes.create_string_buffer(64)",
        "64",
        "65",
        "a byte more than the library is told that it may write",
    ),
    Equivalent(
        "nodes/coupling/law_on_axis.py",
        "if len(taps) <= UNROLLED_TAPS:",
        "<=",
        "<",
        "both branches have the same bits; where one becomes faster is measured, not tested",
    ),
    Equivalent(
        "nodes/laws/derivatives/parallel.py",
        "if abs(pole) < _SMALL and times > 0:",
        ">",
        ">=",
        "a pole below 0.01 as taps or as a section: the same answer to 1e-18 of its residue",
    ),
    *(
        Equivalent(
            "nodes/recording/foreign_text.py",
            line,
            "400",
            "401",
            "bytes from 1 on by twos end at 399 either way; 200 or 201 even ones tell the same",
        )
        for line in (
            'elif data[1:400:2].strip(b"\\0") == b"" != data[0:400:2].strip(b"\\0"):',
            'elif data[0:400:2].strip(b"\\0") == b"" != data[1:400:2].strip(b"\\0"):',
        )
    ),
    *(
        Equivalent(
            "nodes/coupling/render.py",
            line,
            "0",
            "1",
            "a fade of one tick has the new law only: what others see or render has weight 0",
        )
        for line in (
            "laws = 1 + s.leaving if s.fade_ramp > 0 else 1",
            "if s.fade_ramp > 0:",
            "fading = s.fade_ramp > 0",
        )
    ),
    Equivalent(
        "nodes/recording/facts.py",
        "if low[place] < high[place] or low[place + 3] < high[place + 3]",
        "+",
        "-",
        "in a list of six, three places before one of the first three is three places after it",
    ),
    Equivalent(
        "nodes/recording/topic_figures.py",
        "step = (sequence - self.last_seq + 0x80000000) % 0x100000000 - 0x80000000",
        "+",
        "-",
        "half of a modulus added or subtracted is the same by it",
    ),
    Equivalent(
        "nodes/stability/roots.py",
        "rounding = 2.0**-52 * np.log2(points) * float(np.sum(np.abs(c)))",
        "52",
        "53",
        "a bound of rounding of which transforms need a twelfth (tests/nodes/stability/"
        "test_stability.py): half is enough",
    ),
    Equivalent(
        "nodes/stability/spring_world.py",
        "if k > floor * (1.0 + 1e-9) + 1e-9",
        ">",
        ">=",
        "a margin for rounding: a K on it to the last bit is neither side's",
    ),
    Equivalent(
        "nodes/stability/k_max.py",
        '"damping", plant.damping * np.linspace(1.0, 0.0, 41)[1:]',
        "41",
        "42",
        "its step of 1/40 is halved 40 times: the same limit to 2e-14 of the damping",
    ),
    Equivalent(
        "nodes/stability/effective_damping.py",
        "theta = np.linspace(0.0, np.pi, max(256, 8 * len(law.taps)) + 1)",
        "8",
        "9",
        "a finer grid of the same function, whose dips are zoomed in on: the same minimum",
    ),
    Equivalent(
        "sim/identify/identify.py",
        'return np.asarray(np.convolve(signal, kernel[::-1], "valid")[::5] * period)',
        "*",
        "/",
        "a scale that all equations have, the force's among them: the same solution and choice",
    ),
    Equivalent(
        "sim/identify/conclude.py",
        "size = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-60))",
        "1.0",
        "2.0",
        "a scale of the unknowns that is multiplied in again: a power of two changes no bit",
    ),
    Equivalent(
        "sim/identify/forces.py",
        "until, told, sure = float(covered), (-1, -1), False",
        "1",
        "2",
        "any negative number stands for a force that answers no tick",
    ),
    *(
        Equivalent(
            "nodes/driver/state.py",
            f"{name}: float = 0.0,",
            "0.0",
            "1.0",
            "a number of a note that its text does not name",
        )
        for name in "abcde"
    ),
)


MARGIN: Final = 1e-6
"""Largest number that a comparison adds or multiplies for rounding."""


def is_margin(node: ast.Compare) -> bool:
    """Return whether a comparison has a margin for rounding.

    A value that lies on such a bound to the last bit is on neither side of it.
    """
    return any(
        isinstance(one, ast.Constant)
        and type(one.value) is float
        and 0.0 < one.value <= MARGIN
        for one in ast.walk(node)
    )


def is_left_out(node: ast.AST) -> bool:
    """Return whether no test can notice a change in this part of a program."""
    match node:
        case ast.Raise() | ast.JoinedStr():  # the text of an error, or any other
            return True
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.FunctionDef(name=name):
            return name in TEXTS
        case ast.keyword(arg=str(name)):
            return name in LOOKS
        case ast.Assign(targets=[ast.Name(id=name)]):
            return name in LOOKS
        case ast.AnnAssign(target=ast.Name(id=name)):
            return name in LOOKS
    return False


def children(node: ast.AST) -> list[ast.AST]:
    """Return the parts of a node in which a change may be noticed."""
    if isinstance(node, ast.Dict):
        pairs = zip(node.keys, node.values, strict=True)
        return [value for key, value in pairs if not _is_look(key)]
    found: list[ast.AST] = []
    for name in node._fields:
        if name not in NO_CODE:
            value = getattr(node, name, None)
            parts = value if isinstance(value, list) else [value]
            found += [part for part in parts if isinstance(part, ast.AST)]
    # A default, or a law's example, is a choice that a launch file overrides; no rule follows
    # from it.
    is_choice = isinstance(node, ast.ClassDef) and (
        node.name.endswith("Parameters")
        or any(isinstance(base, ast.Name) and base.id == "Law" for base in node.bases)
    )
    return [
        part
        for part in found
        if not is_left_out(part) and not (is_choice and isinstance(part, ast.AnnAssign))
    ]


def _is_look(key: ast.expr | None) -> bool:
    name = key.value if isinstance(key, ast.Constant) else None
    return isinstance(name, str) and (name in LOOKS or name.startswith(_STYLE))


def is_equivalent(file: str, line: str, old: str, new: str) -> bool:
    """Return whether a change is known to give an equal program."""
    return any(row[:4] == (file, line.strip(), old, new) for row in EQUIVALENT)
