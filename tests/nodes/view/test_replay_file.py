"""A recording's page in one file: its data are those of the recording, and it opens alone."""

from __future__ import annotations

import base64
import json
import re
import subprocess
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from messages.types import DeviceState, Force, Proxy
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError, RecordWriter
from nodes.view.feed import HEAD
from nodes.view.replay import ReplayPages
from nodes.view.replay_file import export_html
from tests.support.browser import needs_browser
from tests.support.in_node import node
from tests.support.launching import typed_in, wait_for
from tests.support.recorded import PERIOD, PUBLISHES, drop

if TYPE_CHECKING:
    from playwright.sync_api import Browser

TICKS = 2500


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "drop.mcap"
    manifest = {"scenario": "drop", "axes": "z", "rate_hz": str(1.0 / PERIOD)}
    with RecordWriter(path, {**manifest, "publishes": PUBLISHES}) as writer:
        for topic, message in drop(TICKS, switch=1200):
            writer.write(topic, message, message.stamp + 1e-4)
    return path


@pytest.fixture(scope="module")
def page(recording: Path) -> Path:
    done = typed_in(
        recording.parent, "bag", "export", str(recording), "--format", "html", "--json"
    )
    (file,) = json.loads(done.stdout.splitlines()[-1])["files"]
    return Path(file)


def test_it_is_one_file_that_loads_nothing(page: Path) -> None:
    text = page.read_text()
    assert page.name == "drop.html"
    assert re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=", text) == []
    # The page itself is 0.2 MB; 5 s of one axis take a tenth of that.
    assert len(text) < 400_000


def test_it_holds_every_tick_of_the_recording(page: Path, recording: Path) -> None:
    found = re.search(r'id="recorded">([^<]+)<', page.read_text())
    assert found is not None
    data = zlib.decompress(base64.b64decode(found[1]))
    size = int.from_bytes(data[:4], "little")
    head = json.loads(data[4 : 4 + size])
    bins, series = head["bins"], head["hello"]["series"]
    at = -(-(4 + size) // 8) * 8 + 8 * head["scenes"] * 23
    times = np.frombuffer(data, "<f8", bins, at)
    values = np.frombuffer(data, "<f4", bins * len(series), at + 8 * bins).reshape(
        -1, bins
    )
    states = [
        each for _, each in drop(TICKS, switch=1200) if isinstance(each, DeviceState)
    ]
    assert bins == TICKS
    assert times.tolist() == [k * PERIOD for k in range(TICKS)]
    heights = np.array([state.position[2] for state in states], dtype="<f4")
    assert (values[series.index("position.z")] == heights).all()
    assert len(head["log"]["items"]) == 1  # the receipt of the switch


def test_every_scene_is_of_one_tick(recording: Path) -> None:
    """Position, proxy, forces and time; also the first and the last."""
    pages = ReplayPages(recording)
    pages.close()
    told: dict[type, dict[int, Any]] = {DeviceState: {}, Proxy: {}, Force: {}}
    for _, message in drop(TICKS, switch=1200):
        if type(message) in told:
            told[type(message)][message.seq] = message
    scenes = [now for now, _ in pages.scenes.items]
    assert [now[0] for now in scenes] == [k * PERIOD for k in range(TICKS)]
    for k, now in enumerate(scenes):
        assert now[1:4] == told[DeviceState][k].position
        assert now[4:7] == told[Proxy][k].proxy
        assert now[10:13] == told[Force][k].force
        assert now[13:16] == told[DeviceState][k].force


_OPEN = """
const fs = require("fs"), text = fs.readFileSync(process.argv[2], "utf8");
const textContent = /id="recorded">([^<]+)</.exec(text)[1];
globalThis.document = { getElementById: () => ({ textContent }) };
const ours = (part) => part.includes("A recording inside the page");
(0, eval)(text.split("<script>").find(ours).split("</script>")[0]);
const texts = [], frames = [], wholes = [], socket = new WebSocket("live");
socket.onmessage = ({ data }) => {
  if (typeof data === "string") texts.push(JSON.parse(data));
  else (new DataView(data).getUint32(0, true) === 2 ? wholes : frames).push(data);
};
socket.onopen = () => {
  const ask = (request) => socket.send(JSON.stringify({ ...request, id: 1 }));
  ask({ op: "pause" });
  ask({ op: "seek", t: 3.2 });
  setTimeout(() => {
    ask({ op: "law", field: "stiffness", value: 3 });
    const frame = frames.at(-1), now = new Float64Array(frame, 16, 22);
    fs.writeFileSync(process.argv[3], JSON.stringify({
      types: [...new Set(texts.map(({ type }) => type))], at: now[0], z: now[3],
      whole: Buffer.from(wholes[0]).toString("base64"),
      answers: texts.filter(({ type }) => type === "answer"),
      bins: frames.reduce((sum, each) => sum + new DataView(each).getUint32(4, true), 0),
    }));
    process.exit(0);
  }, 100);
};
"""


@pytest.mark.process
@pytest.mark.smoke
def test_its_script_gives_the_page_the_scene_of_any_time(
    page: Path, recording: Path, tmp_path: Path
) -> None:
    script, out = tmp_path / "open.js", tmp_path / "found.json"
    script.write_text(_OPEN)
    done = subprocess.run(
        [node(), str(script), str(page), str(out)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(out.read_text())
    states = [
        each for _, each in drop(TICKS, switch=1200) if isinstance(each, DeviceState)
    ]
    assert {"hello", "reset", "log", "status", "answer"} <= set(found["types"])
    assert found["at"] == 3.2
    assert found["z"] == states[1600].position[2]
    assert found["bins"] == TICKS
    # All of it at once, as the server sends it.
    pages = ReplayPages(recording)
    pages.close()
    assert base64.b64decode(found["whole"])[HEAD.size :] == pages.whole[HEAD.size :]
    *fine, refused = found["answers"]
    assert [answer["ok"] for answer in fine] == [True, True]
    assert refused["error"].startswith("law is refused: a recording can only play")


def test_a_file_that_exists_is_not_replaced_unasked(
    recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "mine.html"
    out.write_text("mine")
    with pytest.raises(RecordError):
        export_html(Recording(recording), out)
    assert out.read_text() == "mine"
    assert export_html(Recording(recording), out, overwrite=True) == [out]


@pytest.mark.slow
@pytest.mark.process
@needs_browser
def test_it_opens_in_a_browser_without_us_at_the_time_of_its_link(
    browser: Browser, page: Path
) -> None:
    wrong: list[str] = []
    opened = browser.new_page()
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.goto(f"file://{page}#t=2.5")
    opened.wait_for_function("haptic.scene.now?.t === 2.5")
    assert opened.locator("#play").text_content() == "Play"
    assert not opened.locator("#dial").is_visible()
    # Nothing empty stands above the scene, and nothing asks for what a recording cannot do.
    above = "document.querySelector('.felt').getBoundingClientRect().top"
    assert (
        opened.evaluate(f"{above} - document.querySelector('.first').offsetTop") < 1.0
    )
    opened.locator("#lab > summary").click()
    assert not opened.locator("#ramp").is_visible()
    opened.locator("#lab > summary").click()
    seek: Any = opened.locator("#seek")
    seek.evaluate(
        "s => { s.value = 1.5; s.dispatchEvent(new Event('input'));"
        " s.dispatchEvent(new Event('change')); }"
    )
    opened.wait_for_function("haptic.scene.now.t === 1.5")
    opened.locator("#share").click()
    assert opened.url.endswith("#t=1.500")
    opened.locator("#play").click()
    wait_for(lambda: opened.evaluate("haptic.scene.now.t") > 1.6, "it plays")
    assert wrong == []
