"""Write the page of scenarios as a folder of plain files, for any static host.

The page is that of ``haptic launch --view``; in place of the server stands a worker that plays the
loop. No file is loaded from elsewhere, and paths are relative. Worker and scenarios are compressed:
much of their numbers is the same in all of them.
"""

from __future__ import annotations

import base64
import re
import shutil
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec

from messages.errors import UsageError
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.driver.force_words import NOTES, STATES
from nodes.driver.state import SAFETY
from nodes.environment.surfaces import parse_surface
from nodes.launcher import launch_file
from nodes.launcher.launch_spec import Launch
from nodes.launcher.wiring import chains_of
from nodes.laws.law_fields import all_law_fields
from nodes.laws.parse import parse_law
from nodes.parameters.store import ParameterError, convert
from nodes.view.bundle import bundle
from nodes.view.feed import BINS_PER_SECOND, Feed
from nodes.view.live import HISTORY
from nodes.view.ringing import Strokes
from nodes.view.shape import shape_of
from nodes.view.stability_map import plant_of, same_tick_worlds
from sim.device.driver import SimDriverParameters, along
from sim.javascript.values import Plain
from sim.play.hops import Hops, hops_of
from sim.static_page.emitted_rules import constant, player, script
from sim.static_page.image import image_of
from sim.static_page.law_parts import parts_of

_FIRST: Final = ("touch_wall",)  # scenarios if none are named
_SCRIPTS: Final = ("laws", "edges", "moving_worlds", "words", "delay", "session")
# ticks for which laws that push pseudo-randomly have their push
_TICKS: Final = 200_000
LONGEST_DELAY: Final = 20  # longest delay of the device that the page plays [ticks]
LARGEST: Final = 500_000  # largest folder [bytes]
# An array that several scenarios may have; a marker that is in no script stands for it.
_ARRAY: Final = re.compile(r"\[[-+\d.e, ]{80,}\]")
_MARK: Final = "\x01"


def write_site(directory: Path, scenarios: Sequence[str] = ()) -> dict[str, Any]:
    """Write the folder; return its path, scenarios, number of files and size [bytes].

    Parameters
    ----------
    directory : Path
        The folder; created, or overwritten if it contains a page of ours.
    scenarios : sequence of str
        Names or paths of launch files; ``touch_wall`` by default.

    Raises
    ------
    UsageError
        If the folder contains anything else, or would become larger than `LARGEST`.
    ParameterError
        If a launch file is invalid, or has what a browser cannot play.
    """
    launches = [launch_file.read(name, {}) for name in scenarios or _FIRST]
    texts = {launch.scenario: data_script(launch) for launch in launches}
    files = site_files(texts)
    size = sum(len(content) for content in files.values())
    if size > LARGEST:
        raise UsageError(f"{directory}: {_too_large(texts, size)}")
    if directory.exists():
        strange = [
            path.name for path in directory.iterdir() if path.name not in _tops(files)
        ]
        if strange:
            raise UsageError(
                f"{directory}: contains {strange[0]!r}, which is no file of a page; name an empty"
                " or new folder"
            )
        shutil.rmtree(directory)
    for name, content in files.items():
        path = directory / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return {
        "directory": str(directory),
        "scenarios": [launch.scenario for launch in launches],
        "files": len(files),
        "bytes": size,
    }


def _tops(files: Mapping[str, bytes]) -> set[str]:
    return {name.partition("/")[0] for name in files}


def _too_large(texts: Mapping[str, str], size: int) -> str:
    """Return why the folder is too large, the share of each scenario, and the remedy."""
    page = sum(len(content) for content in site_files({}).values())
    each = {name: len(packed({name: text})) for name, text in texts.items()}
    most = sorted(each, key=lambda name: -each[name])
    sizes = ", ".join(f"{name} {each[name] / 1000:.0f} kB" for name in most)
    return (
        f"{size / 1000:.0f} kB, limit {LARGEST / 1000:.0f} kB: the page itself"
        f" {page / 1000:.0f} kB, {sizes}; leave out {most[0]}, or give it a coarser"
        " mesh or a shorter push"
    )


def site_files(texts: Mapping[str, str]) -> dict[str, bytes]:
    """Return the content of each file by its relative path; `texts` by scenario."""
    import nodes.view

    web = Path(nodes.view.__file__).with_name("web")
    modules = {path.name: path.read_text(encoding="utf-8") for path in web.glob("*.js")}
    html = (web / "index.html").read_text(encoding="utf-8")
    old = '<script src="main.js" type="module"></script>'
    assert old in html  # noqa: S101  # the page's own file
    html = html.replace(
        old,
        '<script src="static.js" defer></script>\n<script src="main.js" defer></script>',
    )
    texts = {
        "index.html": html,
        "main.js": smaller(bundle(modules, "main")),
        "static.js": static_script(texts),
        "voice.js": modules["voice.js"],
        "voice_worklet.js": modules["voice_worklet.js"],
    }
    found = {name: text.encode() for name, text in texts.items()}
    for path in sorted(web.rglob("*")):
        name = path.relative_to(web).as_posix()
        wanted = path.suffix != ".js" or name.startswith("vendor/")
        if path.is_file() and wanted and name not in found:
            found[name] = path.read_bytes()
    return found


def static_script(texts: Mapping[str, str]) -> str:
    """Return the script that stands for the server: the worker's text and all scenarios."""
    return (
        constant("NAMES", Plain(list(texts)))
        + constant("PACKED", packed({**texts, "": worker()}))
        + script("static")
    )


def packed(texts: Mapping[str, str]) -> str:
    """Return texts by name, compressed; an array that is in several of them, once."""
    arrays: dict[str, int] = {}

    def number(found: re.Match[str]) -> str:
        return f"{_MARK}{arrays.setdefault(found[0], len(arrays))}{_MARK}"

    short = {name: _ARRAY.sub(number, text) for name, text in texts.items()}
    found = msgspec.json.encode({"arrays": list(arrays), "texts": short})
    return base64.b64encode(zlib.compress(found, 9)).decode()


def worker() -> str:
    """Return the worker's script, without the constant DATA that precedes it."""
    return smaller(session_script() + script("worker"))


def session_script() -> str:
    """Return player, laws, edges, words and session: all but the messages to a page."""
    notes = {str(code): note._asdict() for code, note in NOTES.items()}
    tables = {
        "STATES_": {name: words.text for name, words in STATES.items()},
        "NOTES_": notes,
        "SAFETY_": list(SAFETY),
        "LONGEST_DELAY_": LONGEST_DELAY,
        "ROOM_": LONGEST_DELAY + 2,
        "STROKES_": vars(Strokes(0)),
    }
    constants = "".join(constant(name, one) for name, one in tables.items())
    return player() + constants + "".join(map(script, _SCRIPTS))


def smaller(text: str) -> str:
    """Return a script without indentation, empty lines and lines that are comments."""
    lines = (line.strip() for line in text.splitlines())
    return (
        "\n".join(line for line in lines if line and not line.startswith("// ")) + "\n"
    )


def data_script(launch: Launch) -> str:
    """Return the definition of DATA: all that the worker needs of one scenario."""
    return constant("DATA", data_of(launch))


def data_of(launch: Launch) -> dict[str, Any]:
    """Return all that the worker needs of one scenario."""
    image = image_of(launch, _TICKS)
    hops = hops_of(launch, chains_of(launch)[0])
    period, axes = launch.run.period, list(launch.run.axes)
    driver: SimDriverParameters = convert(
        launch.nodes[hops.driver].parameters, SimDriverParameters, hops.driver
    )
    coupling: CouplingParameters = convert(
        launch.nodes[hops.coupling].parameters, CouplingParameters, hops.coupling
    )
    described, parts = _laws(coupling, hops, period, len(axes))
    model = along(driver.device, axes)[0]
    plant = plant_of(None, launch.nodes[hops.driver].parameters)
    feed = Feed(axes, period, 1.0, BINS_PER_SECOND)
    hand = bool(image["pointer"]) and model.hand is not None
    next_tick = int(launch.run.apply == "next_tick")
    surface = parse_surface(
        launch.nodes[hops.environment].parameters["surface"], "surface"
    )
    shape = shape_of(launch.nodes[hops.environment].parameters) if len(axes) > 1 else {}
    return {
        "scenario": launch.scenario,
        "arguments": {},
        "nodes": {
            "driver": hops.driver,
            "environment": hops.environment,
            "coupling": hops.coupling,
        },
        "image": {**image, "next_tick": next_tick},
        "laws": Plain(described),
        "parts": parts,
        "named": Plain([name for name in coupling.laws if name in parts]),
        "active": coupling.law,
        "ramp": coupling.ramp,
        "delay": model.delay,
        "hand": Plain(hand),
        "silence": image["pointer"].get("silence", 0.0),
        "farthest": image["pointer"].get("farthest", 0.0),
        "device": {
            "period": period,
            "mass": model.moving_mass,
            "damping": model.moving_damping,
            "stiffness": model.grip,
        },
        "plant": Plain({} if plant is None else msgspec.to_builtins(plant)),
        "world": same_tick_worlds(coupling.plant or plant),
        "no_map": (
            "No map: the device's mass depends on its position."
            if model.mass_by_position
            else ""
        ),
        "hello": Plain(
            {
                "run": "static",
                "scenario": launch.scenario,
                "summary": launch.summary,
                "rate_hz": 1.0 / period,
                "pace": "realtime",
                "axes": axes,
                "kept_s": HISTORY,
                "peak_n": driver.safety.peak_force,
                "series": feed.names,
                "bin_s": feed.per_bin * period,
                "replay": False,
                "hand": hand,
                "beyond": bool(image["pointer"].get("beyond", False)),
                "again": True,
                "compares": True,
                "delays": len(axes) == 1,
                "records": False,
                "ends": False,
                "measures": False,
                "sings": hand and len(axes) == 1 and surface.kind == "plane",
                "shape": shape,
                "fields": _fields(described),
            }
        ),
    }


def _laws(
    coupling: CouplingParameters, hops: Hops, period: float, axes: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return descriptions and parts of all laws that the worker can render, by name."""
    book, described, parts = LawBook(hops.coupling, period), {}, {}
    for name in book.names(coupling):
        where = f"{hops.coupling}.laws.{name}"
        try:
            book.compile(coupling, name)
            found = book.description(coupling, name)
            parts[name] = parts_of(parse_law(found, where), period, _TICKS, axes, where)
            described[name] = found
        except ParameterError:
            if name == coupling.law:
                raise
    return described, parts


def _fields(described: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameter descriptions of the kinds of these laws; most are fixed here."""
    every = all_law_fields()
    kinds = dict.fromkeys(law["kind"] for law in described.values())
    return {
        kind: [
            field
            if field["name"] in ("stiffness", "damping")
            else {**field, "fixed": True}
            for field in every[kind]
        ]
        for kind in kinds
    }
