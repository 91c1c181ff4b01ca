"""A | B and sound in a real browser: B equals a separate run, the sound the recording."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from messages.topics import DEVICE_STATE
from nodes.launcher import scenario_files
from nodes.laws.parse import parse_law
from nodes.recording.reader import Recording
from sim.play.shadow import play_beside
from tests.support.browser import OpenPage, needs_browser, url_of
from tests.support.launching import Running, launch_json, running, wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [needs_browser, pytest.mark.slow]


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(tmp_path_factory.mktemp("beside"), "touch_wall", "--view") as found:
        yield found


@pytest.fixture(scope="module")
def page(browser: Browser, launch: Running) -> Iterator[Page]:
    with OpenPage(browser, url_of(launch) + "#k=1500&law=pd&b=multi_term") as found:
        yield found


def test_b_has_the_bits_of_a_separate_run(launch: Running, tmp_path: Path) -> None:
    """In steps or at once: bit-equal to four processes with that hand and law."""
    setups = launch.run.nodes
    targets = [0.0] * 20 + [0.024] * 300 + [0.0] * 80
    law: dict[str, Any] = {"kind": "pd", "stiffness": 2500.0, "damping": 3.0}
    assert parse_law(law).compile(0.002).taps
    whole = play_beside(setups, law, targets, (0.0, 0.0), 0.23)
    part = play_beside(setups, law, targets[:250], (0.0, 0.0), 0.23)
    for all_of_it, some in zip(whole, part, strict=True):
        assert np.array_equal(all_of_it[:250], some)
    assert whole[1].min() < -0.3
    content = yaml.safe_load(
        scenario_files.find("touch_wall").read_text(encoding="utf-8")
    )
    driver, coupling = (
        content["nodes"][name]["parameters"] for name in ("driver", "coupling")
    )
    driver["safety"]["ramp"] = 0.0
    driver["device"]["delay"] = 0.23
    driver["device"]["hand"]["path"] = [
        [k * 0.002, target] for k, target in enumerate(targets)
    ]
    coupling.update(law="alone", laws={"alone": law}, stability="off")
    (tmp_path / "alone.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    words = (
        str(tmp_path / "alone.yaml"),
        "pace:=lockstep",
        "duration:=0.8",
        "--tick",
        "plain",
    )
    figures = launch_json(tmp_path, *words)
    states = Recording(tmp_path / figures["recording"]).messages(DEVICE_STATE)
    assert [state.position[0] for state in states[:400]] == whole[0].tolist()
    assert [state.force[0] for state in states[1:401]] == whole[1].tolist()


def test_a_link_carries_law_stiffness_and_comparison(
    page: Page, launch: Running
) -> None:
    wait_for(
        lambda: (
            launch.call("coupling", "param.get", name="laws.pd.stiffness") == 1500.0
        ),
        "the stiffness of the link",
    )
    wait_for(
        lambda: page.evaluate("haptic.beside.law") == "multi_term",
        "the comparison of the link",
    )
    page.evaluate(
        "navigator.clipboard.writeText = (text) => { window.copied = text; return"
        " Promise.resolve(); }"
    )
    page.locator("#share").click()
    assert page.evaluate("location.hash") == ("#law=pd&k=1500&delay=0&b=multi_term")
    # What follows the # goes to no server, the token included stays on this machine.
    assert page.evaluate("copied.startsWith(location.origin)")


def test_b_is_drawn_and_felt_beside_a(page: Page) -> None:
    wait_for(lambda: page.evaluate("haptic.beside.times.length") > 500, "B is played")
    # The hand taps by itself: both touch the wall.
    wait_for(
        lambda: page.evaluate("Math.min(...haptic.beside.force)") < -0.2,
        "B pushes back",
    )
    newest = float(page.evaluate("haptic.beside.times.at(-1)"))
    wait_for(
        lambda: float(page.evaluate("haptic.beside.times.at(-1)")) > newest + 0.5,
        "it is played on",
    )
    times = np.array(page.evaluate("haptic.beside.times"))
    assert np.all(np.diff(times) > 0.0)


def test_the_sound_is_the_force(page: Page, launch: Running) -> None:
    """Each sample to the sound card is its tick's force, linear in between."""
    assert page.evaluate("haptic.sound.on") is False, "off until somebody clicks"
    page.evaluate("window.heard = { times: [], forces: [] }")
    # On a phone; here there is nothing that could shake.
    page.evaluate("navigator.vibrate = (ms) => { window.shaken = ms; return true; }")
    page.locator("#sound").click()
    wait_for(
        lambda: page.evaluate("haptic.sound.node !== null && haptic.sound.fed > 100"),
        "it is fed",
    )
    page.evaluate("""() => { const { port } = haptic.sound.node, post = port.postMessage.bind(port);
      port.postMessage = (data) => {
        heard.times.push(...data.times); heard.forces.push(...data.forces); post(data); }; }""")
    wait_for(
        lambda: page.evaluate(
            "Math.min(0, ...heard.forces) < -0.2 && heard.forces.length > 1500"
        ),
        "a touch is heard",
    )
    assert 8.0 < page.evaluate("window.shaken") <= 40.0, "and felt"
    heard = page.evaluate("heard")
    page.locator("#sound").click()
    assert page.evaluate("haptic.sound.context.state") in ("suspended", "running")
    between = page.evaluate(
        """async () => { const { Voice } = await import("./voice.js"), voice = new Voice(48000);
      voice.feed([0, 0.002, 0.004, 0.006], [0, -1, -3, 1]);
      return [0.002, 0.003, 0.0055].map((at) => { voice.at = at; voice.next = 0;
        return voice.force(); }); }"""
    )
    assert between == pytest.approx([-1.0, -2.0, 0.0], abs=1e-6)
    path = next((launch.folder / "recordings").glob("*.mcap"))
    forces: dict[int, float] = {}
    # What is flushed by now: the run goes on.
    newest = round(heard["times"][-1] / 0.002)

    def recorded() -> bool:
        forces.update(
            {
                state.seq: state.force[0]
                for state in Recording(path).messages(DEVICE_STATE)
            }
        )
        return bool(max(forces) >= newest)

    wait_for(recorded, "the recording holds it")
    ticks = [round(t / 0.002) for t in heard["times"]]
    assert heard["forces"] == [np.float32(forces[tick]) for tick in ticks]
