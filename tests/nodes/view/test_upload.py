"""A recording that is sent to an open page: read by its server, or refused in words."""

from __future__ import annotations

import asyncio
import contextlib
import json
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nodes.recording.writer import RecordWriter
from nodes.view import upload
from nodes.view.commands import CommandError
from nodes.view.replay import ReplayPages
from nodes.view.upload import LARGEST, Upload
from tests.support.live_page import live, texts
from tests.support.recorded import PERIOD, PUBLISHES, drop

TICKS = 600


def written(path: Path, run: str, ticks: int = TICKS) -> Path:
    manifest = {
        "scenario": "drop",
        "axes": "z",
        "rate_hz": str(1.0 / PERIOD),
        "run": run,
    }
    with RecordWriter(path, {**manifest, "publishes": PUBLISHES}) as writer:
        for topic, message in drop(ticks):
            writer.write(topic, message, message.stamp + 1e-4)
    return path


@pytest.fixture(scope="module")
def sent(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return written(
        tmp_path_factory.mktemp("sent") / "b.mcap", "second", 300
    ).read_bytes()


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    pages = ReplayPages(written(tmp_path_factory.mktemp("shown") / "a.mcap", "first"))
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    asyncio.run_coroutine_threadsafe(pages.server.start(), loop).result(20.0)
    try:
        yield pages.server.url
    finally:
        asyncio.run_coroutine_threadsafe(pages.server.stop(), loop).result(20.0)
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
        pages.close()


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Watch the folder of temporary files; whatever happens, nothing stays there."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    yield tmp_path
    assert list(tmp_path.iterdir()) == []


def ask(page: Any, op: str, **more: Any) -> dict[str, Any]:
    page.send(json.dumps({"id": op, "op": op, **more}))
    return texts(page, "answer", op=op)


def test_what_is_sent_replaces_what_was_shown(url: str, sent: bytes) -> None:
    with live(url) as page, live(url) as other:
        assert texts(page, "hello")["run"] == "first"
        begun = ask(page, "open", name="C:\\lab\\b.mcap", size=len(sent))
        assert begun["ok"], begun
        half = len(sent) // 2
        page.send(sent[:half])
        early = ask(page, "opened")
        assert (
            early["error"] == f"open: {half} of {len(sent)} bytes came; send it again"
        )
        page.send(sent[half:])
        page.send(json.dumps({"id": 2, "op": "opened"}))
        hello = texts(page, "hello")
        assert (hello["run"], hello["notice"]) == (
            "second",
            "b.mcap; reload to go back.",
        )
        assert hello["end_s"] == pytest.approx(299 * PERIOD)
        assert ask(page, "seek", t=0.2)["result"]["t"] == 0.2
        # Another page of the same server goes on with its own.
        assert ask(other, "seek", t=1.0)["result"]["t"] == 1.0


def test_a_recording_is_drawn_over_the_one_that_is_shown(url: str, sent: bytes) -> None:
    with live(url) as page:
        assert ask(page, "open", name="b.mcap", size=len(sent), over=True)["ok"]
        page.send(sent)
        page.send(json.dumps({"id": 2, "op": "opened"}))
        over = texts(page, "over")
        assert over["name"] == "b"
        assert len(over["times"]) == len(over["position"]["z"]) == 300
        assert over["position"]["z"][0] == 0.01
        assert ask(page, "seek", t=1.0)["result"]["t"] == 1.0


@pytest.mark.parametrize(
    ("name", "size", "why"),
    [
        ("page.html", 10, r"page\.html: a page opens recordings \(\.mcap\)"),
        (
            "a.mcap",
            LARGEST + 1,
            rf"a\.mcap: {LARGEST + 1} bytes, limit {LARGEST}; use: haptic",
        ),
        ("a.mcap", 0, "0 bytes"),
        ("a.mcap", 1.5, "1.5 bytes"),
        ("a.mcap", None, "None bytes"),
        ("", 10, "name is the file's name"),
        ("a" * 256, 10, "name is the file's name"),
        (7, 10, "name is the file's name"),
    ],
)
def test_a_file_that_cannot_be_accepted_is_refused_at_once(
    name: Any, size: Any, why: str
) -> None:
    with pytest.raises(CommandError, match=why):
        Upload().begin({"name": name, "size": size})


def test_the_largest_file_is_accepted_and_no_byte_more_than_announced() -> None:
    with contextlib.closing(Upload()) as one:
        one.begin({"name": "a.mcap", "size": LARGEST})
        one.begin({"name": "a.mcap", "size": 3})
        assert not one.over
        assert one.add(b"ab")
        assert not one.add(b"cd")
        assert one.add(b"c")
        assert one.open(lambda path: path.read_bytes()) == b"abc"
        # Opened once, it is gone.
        assert not one.add(b"")
        with pytest.raises(CommandError, match="3 of 3 bytes came; send it again"):
            one.open(lambda path: path)


def test_bytes_that_nobody_announced_end_the_page(url: str) -> None:
    with live(url) as page:
        page.send(b"\x89MCAP")
        with contextlib.suppress(Exception):
            while True:
                page.recv(timeout=20.0)
        assert page.close_code == 1003


def test_what_is_no_recording_is_refused_in_the_name_that_the_page_knows(
    url: str, sent: bytes
) -> None:
    with live(url) as page:
        for content in (b"\x89MCAP0\r\n", bytes(100), sent[:60]):
            assert ask(page, "open", name="mine.mcap", size=len(content))["ok"]
            page.send(content)
            refused = ask(page, "opened")
            assert not refused["ok"]
            assert "mine.mcap" in refused["error"]
            assert upload.__name__ not in refused["error"]
            assert "haptic-view-" not in refused["error"]
        # The page goes on with what it showed.
        assert ask(page, "seek", t=1.0)["result"]["t"] == 1.0
