"""The page in a real browser with a scripted server: ends, failures, other laws."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

from messages.types import DeviceState, Force, Proxy
from nodes.laws.law_fields import all_law_fields
from nodes.view.feed import Feed
from nodes.view.live import Facts, LiveRun
from nodes.view.server import PageServer
from tests.support.browser import OpenPage, needs_browser, shown
from tests.support.idle_page import IdlePage
from tests.support.launching import wait_for

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = needs_browser

T = 0.002
PD = {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}
STIFF = {"kind": "pd", "stiffness": 2000.0, "damping": 9.0}
MAP = {
    "law": "pd",
    "device_delay": 0.0,
    "delay_ticks": 0.3,
    "plant": {"mass": 0.1, "heaviest": None},
    "mass_kg": 0.1,
    "stable": True,
    "k_n_per_m": 1000.0,
    "b_n_s_per_m": 3.0,
    "k_max_n_per_m": 4000.0,
    "delay_margin_ticks": 2.0,
    "near": 8.0,
    "edge": [[b, 0.0, 4000.0] for b in (0.0, 4.0, 8.0)],
    "over_delay": [[delay, 0.0, 4000.0 - 500.0 * delay] for delay in (0.0, 2.0, 4.0)],
}


class Script:
    """Emulates a run: sends each page the initial state, then what a test sends."""

    def __init__(self) -> None:
        facts = Facts(
            "run", "made_up", "", T, "realtime", "on_arrival", ["x"], "driver", "", 10.0
        )
        self.feed = Feed(["x"], T)
        more = {
            "series": self.feed.names,
            "bin_s": T,
            "replay": False,
            "hand": True,
            "beyond": False,
            "again": False,
        }
        more |= {
            "compares": False,
            "delays": False,
            "shape": {},
            "fields": all_law_fields(),
        }
        self.status = LiveRun(facts).status(0.0)
        self.base = [
            {"type": "hello", **facts.hello(), **more},
            self.laws("pd"),
            {"type": "map", **MAP},
        ]
        self.pages: list[ScriptedPage] = []

    def laws(self, active: str) -> dict[str, Any]:
        """Send the active law."""
        return {
            "type": "laws",
            "node": "coupling",
            "active": active,
            "laws": {"pd": PD, "stiff": STIFF},
            "device_delay": None,
        }

    def tick(self, seq: int) -> bytes:
        """Advance a tick, and send new data to the page."""
        first = self.feed.head
        self.feed.take(
            "/device/state", DeviceState(seq=seq, stamp=0.0, position=(0.01, 0.0, 0.0))
        )
        self.feed.take("/environment/proxy", Proxy(**{**PROXY, "seq": seq}))
        self.feed.take(
            "/coupling/force",
            Force(seq=seq, stamp=0.0, force=(0.0, 0.0, 0.0), law="pd"),
        )
        self.feed.file(all_of_them=True)
        return self.feed.frame(first, self.feed.head)

    def open(self) -> ScriptedPage:
        """Open another page."""
        page = ScriptedPage(
            [
                json.dumps(each)
                for each in (*self.base, {"type": "status", **self.status})
            ]
        )
        page.outbox += [self.tick(self.feed.head) for _ in range(20)]
        self.pages.append(page)
        return page

    def say(self, kind: str, **content: Any) -> None:
        """Send to the newest page."""
        self.pages[-1].outbox.append(json.dumps({"type": kind, **content}))


PROXY: dict[str, Any] = {
    "stamp": 0.0,
    "position": (0.01, 0.0, 0.0),
    "proxy": (0.01, 0.0, 0.0),
    "normal": (-1.0, 0.0, 0.0),
    "distance": 0.01,
    "contact": False,
}


class ScriptedPage(IdlePage):
    """One open page."""

    def __init__(self, outbox: list[str | bytes] | list[str]) -> None:
        self.outbox: list[str | bytes] = [*outbox]

    def news(self) -> list[str | bytes]:
        """Return everything not sent yet."""
        found, self.outbox = self.outbox, []
        return found


@contextlib.contextmanager
def served(script: Script, port: int = 0) -> Iterator[PageServer]:
    loop, server = asyncio.new_event_loop(), PageServer(script.open, "token")
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    asyncio.run_coroutine_threadsafe(server.start(port), loop).result(20.0)
    try:
        yield server
    finally:
        asyncio.run_coroutine_threadsafe(server.stop(), loop).result(20.0)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


@pytest.fixture
def script() -> Script:
    return Script()


@pytest.fixture
def page(browser: Browser, script: Script) -> Iterator[Page]:
    with served(script) as server, OpenPage(browser, server.url) as found:
        wait_for(lambda: found.evaluate("haptic.dial.edge") == 4000.0, "the edge")
        yield found


@pytest.mark.process
@pytest.mark.smoke
def test_an_ended_page_goes_on_when_its_view_comes_again(
    browser: Browser, script: Script
) -> None:
    # Edges of all laws may come before the laws: only the newest of each document is sent.
    edges = {"device_delay": None, "edges": {"pd": 4000.0}, "rest": {"pd": None}}
    script.base.insert(1, {"type": "edges", **edges})
    with served(script) as first, OpenPage(browser, first.url) as page:
        script.say("status", **{**script.status, "ended": "the view was stopped"})
        wait_for(
            lambda: page.evaluate("document.getElementById('dial').inert"), "the end"
        )
        assert first._server is not None
        loop = first._server.get_loop()
        asyncio.run_coroutine_threadsafe(first.stop(), loop).result(20.0)
        with served(script, first.port):
            wait_for(lambda: len(script.pages) == 2, "the page comes back")
            wait_for(
                lambda: not page.evaluate("document.getElementById('dial').inert"),
                "the dial",
            )
            assert page.locator("#stop").is_visible()
            assert not page.locator("#notice").is_visible()
            assert page.evaluate("haptic.map.movable")


@pytest.mark.process
@pytest.mark.smoke
def test_nothing_that_changes_the_loop_acts_before_its_laws_are_known(
    browser: Browser, script: Script
) -> None:
    """Make it sing, pressed too early, said what JavaScript calls a null."""
    hello, laws, chart = script.base
    script.base[:] = [{**hello, "sings": True}]
    early = ["tour-begin", "dial", "sing", "delay-row", "undo"]
    live = "ids => ids.filter((id) => !document.getElementById(id).closest('[inert]'))"
    with served(script) as server, OpenPage(browser, server.url) as page:
        assert page.locator("#sing").is_visible()
        assert page.evaluate(live, early) == []
        script.pages[-1].outbox += [json.dumps(laws), json.dumps(chart)]
        wait_for(lambda: page.evaluate("haptic.dial.edge") == 4000.0, "the edge")
        assert page.evaluate(live, early) == early


@pytest.mark.process
@pytest.mark.smoke
def test_a_recording_that_fails_is_told_on_its_button(
    page: Page, script: Script
) -> None:
    script.say("record", recording=True, path="recordings/a.mcap", error="")
    wait_for(lambda: shown(page, "#record") == "Recording", "it records")
    script.say(
        "record",
        recording=False,
        path="recordings/a.mcap",
        error="recording failed: No space left on device",
    )
    wait_for(lambda: shown(page, "#record") == "Not recorded", "the failure")
    assert page.locator("#record").get_attribute("aria-pressed") == "false"
    assert "No space left" in shown(page, "#refusal")
    assert "recorded recordings/a.mcap" not in page.locator("#log").inner_text()


@pytest.mark.process
@pytest.mark.smoke
def test_the_map_is_of_the_law_that_renders(page: Page, script: Script) -> None:
    script.pages[-1].outbox.append(json.dumps(script.laws("stiff")))
    wait_for(
        lambda: page.evaluate("haptic.laws.state.active") == "stiff", "the other law"
    )
    assert page.evaluate("[haptic.dial.edge, haptic.map.map]") == [None, None]
    assert "Stable" not in shown(page, "#margin")
    # Controls are those of the new law, B among them.
    assert (
        page.evaluate(
            "document.querySelector('#sliders input[aria-label=\"damping, exact value\"]').value"
        )
        == "9"
    )
    # One that was under way for the law of before.
    script.say("map", **{**MAP, "k_max_n_per_m": 3000.0})
    script.say("map", law="stiff", why="No map: none.")
    wait_for(lambda: shown(page, "#margin") == "No map: none.", "a map that fails")
    assert page.evaluate("haptic.dial.edge") is None
    assert not page.locator("#map").is_visible()
    script.say("map", **{**MAP, "law": "stiff", "k_max_n_per_m": 5000.0})
    wait_for(lambda: page.evaluate("haptic.dial.edge") == 5000.0, "its own map")
    # Back at the first law there is what was drawn for it last, or nothing: never the other's.
    script.pages[-1].outbox.append(json.dumps(script.laws("pd")))
    wait_for(
        lambda: page.evaluate("haptic.dial.edge") is None, "no edge of another law"
    )


@pytest.mark.process
@pytest.mark.smoke
def test_the_tour_goes_by_what_rings_and_not_by_a_name(
    page: Page, script: Script
) -> None:
    """A law of that name pushed back, and the tour had heard it ring."""
    words = "0.5 N: springs pushes back."
    rings = "haptic.tour.page.rings()"
    script.say("status", **{**script.status, "words": words, "rings": None})
    wait_for(lambda: "springs" in shown(page, "#words"), "the sentence")
    assert page.evaluate(rings) is False
    ring = {"frequency": 22.0, "force": 3.1}
    script.say("status", **{**script.status, "rings": ring})
    wait_for(lambda: page.evaluate(rings), "it rings")


@pytest.mark.process
@pytest.mark.smoke
def test_a_screen_reader_has_names_for_all_and_hears_a_sentence_once(
    page: Page, script: Script
) -> None:
    canvases = page.evaluate(
        "[...document.querySelectorAll('canvas:not([aria-hidden])')].map((e) =>"
        " [e.id, e.getAttribute('role'), e.ariaLabel])"
    )
    assert len(canvases) > 8
    assert [each for each in canvases if not all(each[1:])] == []
    buttons = (
        "[...document.querySelectorAll('button')].filter((e) => e.offsetParent && !(e.ariaLabel ||"
        " e.textContent.trim()))"
    )
    assert page.evaluate(f"{buttons}.length") == 0
    live = (
        "[...document.querySelectorAll('output')].filter((e) => e.getAttribute('aria-live') !=="
        " 'off').length"
    )
    assert page.evaluate(live) == 0
    page.evaluate(
        """() => { window.said = [];
      const told = document.querySelector("[role=status]");
      new MutationObserver(() => said.push(told.textContent)).observe(told, { childList: true });
        }"""
    )
    for newton in ("1.00", "1.25", "2.50"):
        script.say(
            "status",
            **{
                **script.status,
                "level": "ok",
                "words": f"{newton} N: pd pushes back, 1.00 mm deep.",
            },
        )
    script.say(
        "status",
        **{
            **script.status,
            "words": "No force: nothing is touched; the surface is 8.0 mm away.",
        },
    )
    wait_for(lambda: "nothing is touched" in shown(page, "#words"), "the words")
    assert [
        words.partition(":")[0].replace("\u00a0", " ")
        for words in page.evaluate("said")
    ] == ["1.00 N", "No force"]


RING = """async (axes) => {
  const files = ["./store.js", "./slow_motion.js", "./sound.js"];
  const [{ Store }, { SlowMotion },
    { Sound }] = await Promise.all(files.map((file) => import(file)));
  const names = ["position", "proxy", "law_force", "force",
    "target"].flatMap((name) => axes.map((axis) => `${name}.${axis}`));
  const store = new Store(names, 0.002, 1);
  const add = (from, values) => store.add({ count: 400, times: Float64Array.from({ length: 400 },
    (_, k) => (from + k) * 0.002),
    ...Object.fromEntries(["low", "high"].map((end) => [end,
      (i) => new Float32Array(400).fill(values[names[i]] ?? 0)])) });
  return { store, add, slow: new SlowMotion(), Sound, SlowMotion }; }"""
"""In the page: a ring buffer of a second, filled for 0.8 s, and its player."""


@pytest.mark.process
@pytest.mark.smoke
def test_slow_motion_is_of_the_stop_however_long_ago_that_is(page: Page) -> None:
    script = f"""async () => {{ const {{ store, add, slow, SlowMotion }} = await ({RING})(["x"]);
      add(0, {{ "force.x": -7 }});
      slow.start(store, 0, {{ t: 0.7, span_s: 0.1 }}, {{ at: 0, side: -1 }});
      const sight = slow.window().sight;
      add(400, {{ "force.x": -1 }}); add(800, {{ "force.x": -1 }});
      slow.again();
      const now = slow.now(0.6), late = new SlowMotion();
      late.start(store, 0, {{ t: 0.7, span_s: 0.1 }}, null);
      const drawn = slow.window().store.columns([store.index("force.x")], ...sight, 10)[1];
      return [sight, now.t, now.force[0], Math.min(...drawn), late.window(), late.on]; }}"""
    sight, t, force, least, late, is_on = page.evaluate(script)
    assert sight == pytest.approx([0.4, 0.74])
    assert t == pytest.approx(0.6)
    assert (force, least) == (-7.0, -7.0)
    assert (late, is_on) == (None, False), (
        "a page that came too late shows nothing, and nothing else"
    )


@pytest.mark.process
@pytest.mark.smoke
def test_slow_motion_and_sound_know_all_axes(page: Page) -> None:
    script = f"""async () => {{ const {{ store, add, slow, Sound }} = await ({RING})(["x", "y",
      "z"]);
      const sound = new Sound(document.createElement("button"));
      sound.start(store, ["x", "y", "z"]);
      Object.assign(sound, {{ on: true, node: {{ port: {{ postMessage() {{}} }} }} }});
      add(0, {{ "position.z": -0.03, "proxy.z": -0.02, "force.y": 3, "force.z": -4 }});
      sound.hear();
      slow.start(store, 0, {{ t: 0.7, span_s: 0.1 }}, null);
      slow.window();
      const {{ contact, distance, normal }} = slow.now(0.6);
      return [contact, distance, normal, sound.last.forces[9]]; }}"""
    contact, distance, normal, heard = page.evaluate(script)
    assert contact == 1
    assert distance == pytest.approx(-0.01, rel=1e-6)  # of float32
    assert normal == pytest.approx([0.0, 0.0, 1.0])
    assert heard == 5.0
