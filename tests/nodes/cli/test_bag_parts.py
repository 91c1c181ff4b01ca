"""Parts of recordings: cut, filter, play with offset and remapping; topics by pattern."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from messages.topics import DEVICE_STATE, FORCE, PROXY
from nodes.cli.main import main
from nodes.recording.reader import Recording
from sim.measure.haptic_commands import start_command
from tests.support.launching import Running, running, typed, wait_for
from tests.support.one_process import recorded


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drop")
    return recorded(folder, "floor_drop", "duration:=1")


def test_a_cut_holds_the_while_and_no_more(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "part.mcap"
    assert (
        main(
            ["bag", "cut", str(path), "--from", "0.2", "--to", "0.4", "--out", str(out)]
        )
        == 0
    )
    part, whole = Recording(out), Recording(path)
    # 500 Hz: the ticks 100 to 200, both ends included.
    for topic in (DEVICE_STATE, PROXY, FORCE):
        assert part.messages(topic) == whole.messages(topic)[100:201]
    assert part.manifest == whole.manifest
    assert part.complete
    assert main(["bag", "plot", str(out), "--out", str(tmp_path / "p.png")]) == 0


def test_a_filter_takes_whole_names_and_patterns(path: Path, tmp_path: Path) -> None:
    def topics(*words: str) -> set[str]:
        out = tmp_path / "few.mcap"
        assert (
            main(["bag", "filter", str(path), "--out", str(out), "--force", *words])
            == 0
        )
        return set(Recording(out).topics)

    loop = {DEVICE_STATE, PROXY, FORCE}
    assert topics("--topics", FORCE) == {FORCE}
    assert topics("-e", "^/(device/state|coupling/force|environment/proxy)$") == loop
    assert topics("-x", "/(status|event|receipt)$") == loop
    assert topics("--topics", FORCE, "-e", "state$") == {FORCE, DEVICE_STATE}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["cut", "--from", "2", "--to", "1"], "the end must come after the beginning"),
        (["cut", "--from", "50"], "no message of these topics from 50 s"),
        (["filter", "-e", "("], "not a regular expression"),
        (["filter", "-e", "nothing"], "no topic matches; there are"),
        (["filter", "--topics", "/device"], "no topic '/device'"),
        (["play", "--remap", "/a:=/b"], "no topic '/a'"),
        (["play", "--remap", "/device/state"], "expected OLD:=NEW"),
        (["play", "--start-offset", "1000"], "it lasts"),
    ],
)
def test_what_cannot_be_is_refused(
    path: Path, capsys: pytest.CaptureFixture[str], words: list[str], told: str
) -> None:
    assert main(["bag", words[0], str(path), *words[1:]]) != 0
    assert told in capsys.readouterr().err
    assert not path.with_suffix(".cut.mcap").exists()


def test_play_begins_later_and_under_other_names(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = Recording(path)
    # A lockstep run is played by its own time.
    half = whole.duration / 2.0
    times = [entry.message.stamp for entry in whole.entries([FORCE])]
    words = [
        "-r",
        "inf",
        "--start-offset",
        str(half),
        "--remap",
        f"{FORCE}:=/replayed/force",
        "--json",
    ]
    assert (
        main(["bag", "play", str(path), *words, "--endpoint", f"ipc://{tmp_path}/p"])
        == 0
    )
    published = json.loads(capsys.readouterr().out.splitlines()[-1])["published"]
    assert FORCE not in published
    assert published["/replayed/force"] == sum(
        time >= whole.first_stamp + half for time in times
    )


@pytest.fixture(scope="module")
def wall(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(
        tmp_path_factory.mktemp("wall"), "ros2_wall", "--without", "ros2", "--debug"
    ) as launch:
        yield launch


@pytest.mark.process
def test_patterns_choose_what_is_recorded(wall: Running, tmp_path: Path) -> None:
    out = tmp_path / "r.mcap"
    typed(
        wall,
        "bag",
        "record",
        "-e",
        "/(state|force)$",
        "-x",
        "force",
        "--out",
        str(out),
        "--duration",
        "0.3",
    )
    assert set(Recording(out).topics) == {DEVICE_STATE}


@pytest.mark.process
def test_a_force_from_outside_reaches_the_device(wall: Running) -> None:
    # From 2.3 s on the hand rests before the wall, and the law gives nothing.
    wait_for(lambda: wall.ticks() > 1300, "the hand to rest")
    words = (
        "topic",
        "pub",
        "/external/wrench",
        "{force: [0.25, 0, 0]}",
        "-r",
        "100",
        "-t",
        "300",
    )
    with start_command(
        *words, cwd=wall.folder, env=wall.environment, stdout=subprocess.DEVNULL
    ) as pushing:
        try:
            echo = ("topic", "echo", "/device/state", "--field", "force[0]")
            wait_for(
                lambda: typed(wall, *echo, "--once").stdout.strip() == "0.25",
                "the force",
            )
        finally:
            pushing.kill()
    wait_for(
        lambda: typed(wall, *echo, "--once").stdout.strip() == "0.0",
        "the force to be gone when it is not renewed",
    )


@pytest.mark.process
def test_what_cannot_be_published_is_refused(wall: Running) -> None:
    assert (
        "published 1"
        in typed(
            wall, "topic", "pub", "/external/target", "[0.005, 0, 0]", "--once"
        ).stdout
    )
    for topic, why in (
        ("/device/state", "publishes one per tick"),
        ("/nothing", "there are /external/wrench"),
    ):
        assert why in typed(wall, "topic", "pub", topic, "[0, 0, 0]", code=2).stderr
    assert (
        "force"
        in typed(
            wall, "topic", "pub", "/external/wrench", "{force: [0, 0]}", code=2
        ).stderr
    )


@pytest.mark.process
def test_debug_tells_the_launch_and_its_processes(wall: Running) -> None:
    told = wall.errors
    assert "stiffness: 1000.0" in told
    assert f"driver: pid {wall.pid('driver')}, processors" in told
    assert "receives /coupling/force from ipc://" in told
