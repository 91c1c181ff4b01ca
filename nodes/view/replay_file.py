"""The page of a recording as one HTML file with its data, to mail and open anywhere."""

from __future__ import annotations

import base64
import struct
import zlib
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError, save
from nodes.view.bundle import bundle
from nodes.view.feed import HEAD
from nodes.view.replay import ReplayPages
from nodes.view.stability_map import drawn_map

_WEB: Final = Path(__file__).with_name("web")
_ALONE: Final = Path(__file__).with_name("alone")
# most bins in a file, 4 MB on one axis; in a longer recording each covers more ticks
_MOST_BINS: Final = 60_000.0


def export_html(
    recording: Recording, out: str | Path, *, overwrite: bool = False
) -> list[Path]:
    """Write a recording's page with its data inside; it opens without a server.

    Parameters
    ----------
    recording : Recording
        The recording.
    out : path
        The file.
    overwrite : bool
        Whether an existing file is replaced.

    Returns
    -------
    list of Path
        The file.

    Raises
    ------
    RecordError
        Without ticks, or if the file exists or cannot be written.
    """
    out = Path(out)
    pages = ReplayPages(recording.path, most_bins=_MOST_BINS)
    try:
        save(out, page_of(pages).encode(), overwrite)
    finally:
        pages.close()
    return [out]


def page_of(pages: ReplayPages) -> str:
    """Return the HTML of a recording's page: styles, scripts and data in one text."""
    html = (_WEB / "index.html").read_text(encoding="utf-8")
    modules = {
        path.name: path.read_text(encoding="utf-8") for path in _WEB.glob("*.js")
    }
    data = base64.b64encode(zlib.compress(recorded(pages), 9)).decode()
    scripts = (
        _text("vendor/uPlot.iife.min.js"),
        (_ALONE / "recorded.js").read_text(encoding="utf-8"),
        bundle(modules, "main"),
    )
    inside = f'<script type="text/plain" id="recorded">{data}</script>\n' + "".join(
        f"<script>\n{_inside(script)}</script>\n" for script in scripts
    )
    styles = "".join(
        f"<style>\n{_text(name)}</style>\n"
        for name in ("vendor/uPlot.min.css", "style.css")
    )
    for tag in (
        '<link rel="icon" href="icon.svg">\n',
        '<link rel="stylesheet" href="vendor/uPlot.min.css">\n',
        '<script src="vendor/uPlot.iife.min.js" defer></script>\n',
        '<script src="main.js" type="module"></script>\n',
    ):
        html = _without(html, tag)
    html = html.replace('<link rel="stylesheet" href="style.css">\n', styles)
    # After the body, because scripts inside a file cannot be deferred.
    return html.replace("</body>", f"{inside}</body>")


def recorded(pages: ReplayPages) -> bytes:
    """Return the data of a page: a JSON header, then arrays aligned to 8 bytes."""
    feed = pages.live.feed
    first = feed.oldest()
    end = feed.head
    frame = feed.frame(first, end)
    bins = end - first
    series = len(feed.names)
    times = np.frombuffer(frame, dtype="<f8", count=bins, offset=HEAD.size)
    values = np.frombuffer(frame, dtype="<f4", offset=HEAD.size + 8 * bins)
    low, high = values[: series * bins], values[series * bins :]
    is_same = np.array_equal(low, high, equal_nan=True)
    nows = np.array([now for now, _ in pages.scenes.items], dtype="<f8").reshape(-1, 22)
    poses = [poses for _, poses in pages.scenes.items]
    has_bodies = bool(poses) and poses[0] is not None
    shape = poses[0].shape if has_bodies else (0, 0)
    head = msgspec.json.encode(
        {
            "hello": msgspec.Raw(pages.hello.encode()),
            "over": msgspec.Raw(pages.over.encode()) if pages.over else None,
            "log": {"times": pages.log.times, "items": pages.log.items},
            "statuses": {"times": pages.statuses.times, "items": pages.statuses.items},
            "laws": {"times": pages.laws.times, "items": _laws(pages)},
            "scenes": len(nows),
            "bins": bins,
            "same": is_same,
            "bodies": shape[0],
            "pose": shape[1],
        }
    )
    arrays: list[NDArray[Any]] = [
        np.array(pages.scenes.times, dtype="<f8"),
        nows,
        times,
        low,
    ]
    arrays += [] if is_same else [high]
    arrays += [np.array(poses, dtype="<f4")] if has_bodies else []
    found = bytearray(struct.pack("<I", len(head)) + head)
    for array in arrays:
        found += bytes(-len(found) % 8) + np.ascontiguousarray(array).tobytes()
    return bytes(found)


def _laws(pages: ReplayPages) -> list[dict[str, Any]]:
    """Return the laws of each time with their map, drawn once per law and delay."""
    maps: dict[str, dict[str, Any]] = {}
    found = []
    for laws in pages.laws.items:
        described = laws["laws"].get(laws["active"])
        later = laws.get("device_delay")
        if described is None:
            found.append({"document": laws, "map": None})
            continue
        key = repr((laws["active"], described, later))
        if key not in maps:
            maps[key] = drawn_map(*pages.map_inputs(described, later))
        drawn = {"law": laws["active"], "device_delay": later, **maps[key]}
        found.append({"document": laws, "map": drawn})
    return found


def _text(name: str) -> str:
    return (_WEB / name).read_text(encoding="utf-8")


def _inside(script: str) -> str:
    """Return a script that can stand in a page; RecordError if it would end its own element."""
    if "</script" in script.lower():
        raise RecordError("a script of the page contains the end of a script element")
    return script


def _without(html: str, tag: str) -> str:
    if tag not in html:
        raise RecordError(f"the page has no {tag.strip()}")
    return html.replace(tag, "")
