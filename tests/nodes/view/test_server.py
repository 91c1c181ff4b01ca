"""Access to the page, its requests, and a recording behind the same page."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pty
import re
import signal
import socket
import stat
import struct
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus

from messages.transport.endpoints import MAX_MESSAGE
from nodes.view.live import SILENT_NODE
from nodes.view.replay import ReplayPages
from sim.drill.drill import scene as drill_scene
from tests.support import ROOT
from tests.support.browser import url_of, viewing
from tests.support.launching import (
    HAPTIC,
    Running,
    exit_code,
    haptic,
    launch_json,
    running,
    typed_in,
    wait_for,
)
from tests.support.live_page import live, texts


@pytest.fixture(scope="module")
def launch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(
        tmp_path_factory.mktemp("view"), "touch_wall", "--view", "--without", "logger"
    ) as found:
        yield found


def get(url: str, **headers: str) -> tuple[int, str]:
    request = urllib.request.Request(url, headers=headers)  # noqa: S310  # ours
    try:
        with urllib.request.urlopen(request, timeout=20.0) as answer:  # noqa: S310  # ours
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


# Tests with a launch of their own, or none, come first: the one that is shared would only go on
# beside them.


@pytest.mark.process
def test_stop_waits_for_no_node_that_does_not_answer(tmp_path: Path) -> None:
    """Nor does the end of the view."""
    with running(tmp_path, "touch_wall", "--view", "--without", "logger") as launch:
        os.kill(launch.pid("coupling"), signal.SIGSTOP)
        with live(url_of(launch)) as page:
            page.send(
                json.dumps({"id": 1, "op": "law", "field": "stiffness", "value": 900.0})
            )
            page.send(json.dumps({"id": 2, "op": "stop"}))
            answer = texts(page, "answer")
            assert (answer["id"], answer["ok"]) == (2, True)
        assert launch.finish()["exit_reason"] == "stop requested"
        assert "does not end" not in launch.errors


@pytest.mark.process
def test_other_addresses_are_refused_with_the_ssh_line(tmp_path: Path) -> None:
    told = haptic(
        tmp_path,
        "view",
        "--address",
        "0.0.0.0",  # noqa: S104
        "--port",
        "8080",
        code=2,
    ).stderr
    assert "ssh -L 8080:127.0.0.1:8080" in told


@pytest.mark.slow
def test_a_view_hears_a_node_again_after_a_message_above_the_limit(
    tmp_path: Path,
) -> None:
    """The page hears this node only by its statuses, over the broken connection."""
    content = drill_scene()
    content["nodes"]["link"] = {"kind": "link"}
    (tmp_path / "linked.yaml").write_text(json.dumps(content), encoding="utf-8")
    told = tmp_path / "told"

    def heard(status: dict[str, Any]) -> bool:
        return bool(status["nodes"]["link"]["silent_s"] == 0.0)

    with (
        running(tmp_path, "./linked.yaml", "--without", "logger") as launch,
        told.open("w") as file,
        viewing(tmp_path, environment=launch.environment, stderr=file) as url,
        live(url) as page,
    ):
        wait_for(lambda: "link" in texts(page, "status")["nodes"], "the node")
        launch.call("link", "param.set", values={"oversize": MAX_MESSAGE + 1})
        wait_for(
            lambda: texts(page, "status") and "exceeded" in told.read_text(),
            "the link is connected anew",
        )
        after = texts(page, "status")["t"] + SILENT_NODE + 1.0
        wait_for(
            lambda: (status := texts(page, "status"))["t"] > after and heard(status),
            "the node again",
        )


@pytest.mark.slow
def test_a_recording_is_replayed_with_a_time_slider(tmp_path: Path) -> None:
    figures = launch_json(tmp_path, "floor_swap", "pace:=lockstep")
    with viewing(tmp_path, "--replay", figures["recording"]) as url, live(url) as page:
        hello = texts(page, "hello")
        assert (hello["replay"], hello["hand"]) == (True, False)
        assert (hello["begin_s"], hello["end_s"]) == (0.0, pytest.approx(6.0))
        assert texts(page, "laws")["active"] == "pd"
        assert texts(page, "map")["stable"]

        def ask(**request: Any) -> dict[str, Any]:
            page.send(json.dumps({"id": 1, **request}))
            return texts(page, "answer")

        # At 3 s PDα renders, at 5 s multi-term, and back again.
        for t, law in ((3.0, "pd_alpha"), (5.0, "multi_term"), (1.0, "pd")):
            assert ask(op="seek", t=t)["ok"]
            assert texts(page, "laws")["active"] == law
        assert ask(op="pause")["ok"]
        assert ask(op="speed", factor=4.0)["ok"]
        refused = "a recording can only play, pause, seek"
        assert refused in ask(op="law", field="stiffness", value=1.0)["error"]
        assert refused in ask(op="stop")["error"]
        ask(op="seek", t=6.0)
        frame = wait_for(
            lambda: (
                found if isinstance(found := page.recv(timeout=20.0), bytes) else None
            ),
            "a frame",
        )
        time, _, _, z = struct.unpack_from("<4d", frame, 16)
        # At rest under the softer law: the recording's own last position.
        assert time == pytest.approx(6.0)
        assert z == pytest.approx(figures["final"]["position_m"], abs=1e-6)


@pytest.mark.process
def test_a_replay_knows_its_driver_whatever_its_name(tmp_path: Path) -> None:
    text = (ROOT / "launch" / "floor_drop.yaml").read_text(encoding="utf-8")
    (tmp_path / "named.yaml").write_text(
        text.replace("  driver:", "  left_arm:"), encoding="utf-8"
    )
    figures = launch_json(tmp_path, "named.yaml", "pace:=lockstep", "duration:=0.1")
    pages = ReplayPages(tmp_path / figures["recording"])
    assert pages.live.ended == "done"


@pytest.mark.process
def test_reading_a_recording_is_told_and_can_be_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    figures = launch_json(tmp_path, "floor_drop", "pace:=lockstep", "duration:=1")
    path = tmp_path / figures["recording"]
    shares: list[float] = []
    ReplayPages(path, progress=shares.append)
    # Five times a second of the run, and only forward.
    assert len(shares) == 5
    assert shares == sorted(set(shares))
    assert shares[0] == 0.0
    assert shares[-1] < 1.0

    class Impatient(io.StringIO):
        """Standard error whose reader presses Ctrl-C at the first line."""

        def write(self, text: str) -> int:
            if text.startswith("reading"):
                os.kill(os.getpid(), signal.SIGINT)
            return super().write(text)

    monkeypatch.setattr("nodes.cli.view.PROGRESS_PERIOD", 0.0)
    monkeypatch.setattr("sys.stderr", error := Impatient())
    assert exit_code("view", "--replay", str(path)) == 130
    assert error.getvalue() == f"reading {path}: 0 %\n"
    # No page was offered.
    assert capsys.readouterr().out == ""


def test_what_cannot_be_replayed_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("not a recording", encoding="utf-8")
    assert (
        "text.mcap"
        in typed_in(tmp_path, "view", "--replay", "text.mcap", code=2).stderr
    )
    assert (
        "none.mcap"
        in typed_in(tmp_path, "view", "--replay", "none.mcap", code=2).stderr
    )


@pytest.mark.process
def test_only_who_has_the_token_gets_anything(launch: Running) -> None:
    url = url_of(launch)
    root = url.split("/", 3)[0] + "//" + url.split("/")[2]
    assert get(url)[0] == 200
    assert get(url + "main.js")[0] == 200
    token = url.split("/")[3]
    almost = token[:-1] + ("y" if token.endswith("x") else "x")
    for path in ("/", "/main.js", "/live", "/x/", f"/{almost}/", "/favicon.ico"):
        status, text = get(root + path)
        assert (status, "token" in text) == (403, True), path
    # Nothing outside the page's own folder has a name.
    for path in ("../server.py", "..%2fserver.py", "vendor/../../server.py", "none.js"):
        assert get(url + path)[0] == 404
    with pytest.raises(InvalidStatus, match="403"), live(root + "/wrong/"):
        pass


@pytest.mark.process
def test_a_foreign_page_and_a_foreign_name_are_turned_away(launch: Running) -> None:
    url = url_of(launch)
    for origin in ("https://elsewhere.example", "http://localhost:1", "null"):
        with pytest.raises(InvalidStatus, match="403"), live(url, origin=origin):
            pass
        assert get(url, Origin=origin)[0] == 403
    # DNS rebinding: a name of somebody else's that leads to this machine.
    assert get(url, Host="elsewhere.example")[0] == 403
    # No name at all: it once was an error of the server.
    assert get(url, Host="[")[0] == 403
    place, token = url.split("/")[2:4]
    for line, headers in (
        (f"/{token}/", ""),
        (f"/{token}/", f"Host: {place}\r\nHost: {place}\r\n"),
        (
            f"/{token}/",
            f"Host: {place}\r\nOrigin: http://{place}\r\nOrigin: http://{place}\r\n",
        ),
        ("//[", f"Host: {place}\r\n"),
        ("http://[/", f"Host: {place}\r\n"),
    ):
        with socket.create_connection(
            ("127.0.0.1", int(place.partition(":")[2]))
        ) as bare:
            bare.sendall(f"GET {line} HTTP/1.1\r\n{headers}\r\n".encode())
            assert bare.recv(1000).startswith(b"HTTP/1.1 403 "), (line, headers)
    with live(url, origin="/".join(url.split("/")[:3])) as page:
        assert texts(page, "hello")["scenario"] == "touch_wall"


@pytest.mark.process
def test_a_page_asks_what_it_may_and_nothing_else(launch: Running) -> None:
    with live(url_of(launch)) as page:

        def ask(**request: Any) -> dict[str, Any]:
            page.send(json.dumps({"id": 7, **request}))
            return texts(page, "answer", id=7)

        assert "unknown request" in ask(op="configure")["error"]
        assert (
            "unknown request"
            in ask(op="param.set", node="coupling", values={})["error"]
        )
        assert (
            "no node is named" in ask(op="set", node="../x", values={"a": 1})["error"]
        )
        assert "law" in ask(op="law", field="stiffness", value=1.0, force=True)["error"]
        assert "three numbers" in ask(op="hand", target=[1, 2])["error"]
        for judge, value in (
            ("stability", "off"),
            ("fallback", ""),
            ("budget", 1.0),
            ("plant.mass", 9.0),
            ("plant", {}),
        ):
            refused = ask(op="set", node="coupling", values={"ramp": 41, judge: value})
            assert "limits the page's own changes" in refused["error"], judge
        done = ask(op="set", node="coupling", values={"ramp": 40})
        assert done["ok"]
        assert launch.call("coupling", "param.get", name="ramp") == 40
        assert ask(op="undo")["ok"]
        assert launch.call("coupling", "param.get", name="ramp") == 0
        assert ask(op="undo")["error"] == "nothing to undo"
        page.send("not JSON")
        with pytest.raises(Exception, match="1003"):
            texts(page, "never")


@pytest.mark.process
def test_a_slider_of_a_law_that_renders_no_more_changes_no_other(
    launch: Running,
) -> None:
    before = launch.call("coupling", "param.get", name="laws.pd.damping")
    with live(url_of(launch)) as page:
        page.send(
            json.dumps(
                {
                    "id": 3,
                    "op": "law",
                    "field": "damping",
                    "value": 1.1 * before,
                    "law": "multi_term",
                }
            )
        )
        assert (
            "pd is now active, not multi_term" in texts(page, "answer", id=3)["error"]
        )
        assert launch.call("coupling", "param.get", name="laws.pd.damping") == before
        page.send(
            json.dumps(
                {"id": 4, "op": "law", "field": "damping", "value": before, "law": "pd"}
            )
        )
        assert texts(page, "answer", id=4)["ok"]


@pytest.mark.slow
def test_a_recording_that_ends_by_itself_is_told(launch: Running) -> None:
    """If the folder cannot be created or the recorder is killed, the page shows it."""
    blocker = launch.folder / "recordings"
    with live(url_of(launch)) as page:

        def begin() -> None:
            page.send(json.dumps({"id": 5, "op": "record", "on": True}))
            assert texts(page, "answer", id=5)["result"]["recording"]

        blocker.write_text("no folder", encoding="utf-8")
        begin()
        assert "recordings" in texts(page, "record", recording=False)["error"]
        blocker.unlink()
        begin()
        view = launch.call("view", "status")["pid"]

        def recorder() -> int:
            for task in Path(f"/proc/{view}/task").iterdir():
                for child in map(int, (task / "children").read_text().split()):
                    if b"record" in Path(f"/proc/{child}/cmdline").read_bytes():
                        return child
            return 0

        os.kill(wait_for(recorder, "what records"), signal.SIGKILL)
        assert "exit code -9" in texts(page, "record", recording=False)["error"]
        begin()
        path = launch.folder / texts(page, "record", recording=True, error="")["path"]
        wait_for(lambda: path.exists() and path.stat().st_size > 1000, "the file grows")
        page.send(json.dumps({"id": 6, "op": "record", "on": False}))
        assert texts(page, "answer", id=6)["result"]["error"] == ""


@pytest.mark.slow
def test_a_client_that_reads_nothing_is_dropped_and_costs_no_memory(
    launch: Running,
) -> None:
    def memory() -> float:
        return float(launch.call("view", "status")["memory"])

    # What drawing maps needs is imported with the first one.
    with live(url_of(launch)) as page:
        texts(page, "map")
    before = memory()
    with contextlib.ExitStack() as idle:
        for _ in range(4):
            # What they did not read stands before the answer to a close, which is not worth waiting
            # for.
            idle.enter_context(live(url_of(launch), max_queue=1, close_timeout=0.1))
        launch.wait_ticks(1500)
        # Four rings of a minute would be 15 MB; a frame under way each is far below 4.
        assert memory() - before < 4e6


@pytest.mark.process
def test_no_command_line_holds_the_token(launch: Running, tmp_path: Path) -> None:
    """Command lines are public; the browser gets a private file instead."""
    browser, seen = tmp_path / "browser", tmp_path / "seen"
    browser.write_text(f'#!/bin/sh\necho "$@" > {seen}.draft\nmv {seen}.draft {seen}\n')
    browser.chmod(0o755)
    leader, follower = pty.openpty()
    process = subprocess.Popen(
        [*HAPTIC, "view"],
        env={
            **launch.environment,
            "DISPLAY": ":0",
            "BROWSER": f"{browser} %s",
            "TMPDIR": str(tmp_path),
        },
        stdin=follower,
        stdout=follower,
        stderr=subprocess.STDOUT,
    )
    os.close(follower)
    try:
        wait_for(seen.exists, "the browser to be called")
        told = os.read(leader, 4096).decode()
        url = re.search(r"http://\S+/", told)
        assert url is not None, told
        token = url[0].split("/")[3]
        opened = seen.read_text().strip()
        assert opened.startswith("file:///")
        assert token not in opened
        file = Path(opened.removeprefix("file://"))
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        assert f'content="0; url={url[0]}"' in file.read_text()
        process.send_signal(signal.SIGINT)
        process.wait(20.0)
        assert not file.exists()
    finally:
        process.kill()
        process.wait()
        os.close(leader)


@pytest.mark.process
def test_the_delay_is_the_device_s_own_and_the_law_is_judged_with_it(
    launch: Running,
) -> None:
    with live(url_of(launch)) as page:

        def ask(**request: Any) -> dict[str, Any]:
            page.send(json.dumps({"id": 9, **request}))
            return texts(page, "answer", id=9)

        assert texts(page, "hello")["delays"]
        sooner = texts(page, "map")
        # Three quarters of the way: the coupling measures another delay at each moment.
        ticks = round(0.75 * sooner["delay_margin_ticks"], 2)
        assert ask(op="delay", ticks=ticks)["ok"]
        assert launch.call("driver", "param.get", name="device.delay") == ticks
        assert launch.call("coupling", "param.get", name="plant.device_delay") == ticks
        found = wait_for(
            lambda: (
                (now := texts(page, "map"))
                and now["plant"]["device_delay"] == ticks
                and now
            ),
            "the map",
        )
        assert found["k_max_n_per_m"] < sooner["k_max_n_per_m"]
        # The edge over the delay comes down, and where it meets the present stiffness is the
        # margin.
        rows = [
            (delay, high) for delay, _, high in found["over_delay"] if high is not None
        ]
        meets = found["delay_ticks"] + found["delay_margin_ticks"]
        assert all(high > found["k_n_per_m"] for delay, high in rows if delay < meets)
        assert any(high < found["k_n_per_m"] for delay, high in rows if delay > meets)
        # Past the edge only where that is asked for; refused, nothing has changed.
        refused = ask(op="delay", ticks=8.0)
        assert not refused["ok"]
        assert "pole radius" in refused["error"]
        assert launch.call("driver", "param.get", name="device.delay") == ticks
        assert ask(op="undo")["ok"]
        assert launch.call("driver", "param.get", name="device.delay") == 0.0
        assert launch.call("coupling", "param.get", name="plant.device_delay") == 0.0
        assert not ask(op="delay", ticks=-1.0)["ok"]
        assert launch.call("coupling", "param.get", name="plant.device_delay") == 0.0


@pytest.mark.process
def test_a_view_beside_a_launch_sees_the_same(launch: Running) -> None:
    with (
        viewing(launch.folder, environment=launch.environment) as url,
        live(url) as page,
    ):
        assert texts(page, "hello")["hand"]
        assert (
            texts(page, "laws")["active"]
            == launch.call("coupling", "law.list")["active"]
        )
        assert texts(page, "status", level="rest")["rate_hz"] >= 0.0
