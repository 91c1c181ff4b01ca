"""Several chains in one launch: namespaces, includes, remapping, and values of ``run``."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import haptic
import msgspec
import pytest

from messages import topics
from messages.types import DeviceState
from nodes.launcher import launch_file, scenario_files
from nodes.launcher.launch_spec import Launch
from nodes.parameters.store import ParameterError
from nodes.recording.reader import Recording
from tests.support.launching import Running, launch_json, running, typed

HEAD = "summary: a launch of a test\n"


def read(folder: Path, text: str, **given: Any) -> Launch:
    file = folder / "mine.yaml"
    file.write_text(HEAD + text, encoding="utf-8")
    return launch_file.read(str(file), given)


def test_a_full_name_is_taken_apart_as_it_was_put_together() -> None:
    for namespace in ("", "left", "left/arm"):
        for topic in (*topics.FIXED, topics.status("driver"), topics.event("driver")):
            full = topics.within(namespace, topic)
            assert topics.split(full) == (namespace, topic)
            assert topics.message_type(full) is topics.message_type(topic) is not None


def unclocked(messages: list[Any]) -> list[Any]:
    """Return figures without response times."""
    return [
        msgspec.structs.replace(one, response=0.0)
        if isinstance(one, DeviceState)
        else one
        for one in messages
    ]


@pytest.mark.process
@pytest.mark.smoke
def test_two_chains_do_what_each_does_alone(tmp_path: Path) -> None:
    figures = launch_json(
        tmp_path, "two_hands", "pace:=lockstep", "duration:=0.4", "stiffness:=800"
    )
    alone = launch_json(
        tmp_path, "floor_drop", "pace:=lockstep", "duration:=0.4", "stiffness:=800"
    )
    left, right = (Recording(tmp_path / path) for path in figures["recordings"])
    assert (left.namespace, right.namespace) == ("left", "right")
    assert set(figures["chains"]) == {"left", "right"}
    assert figures["chains"]["left"]["final"] == alone["final"]
    before = Recording(tmp_path / alone["recording"])
    for topic in topics.LOOP:
        # Bit for bit: lockstep is deterministic, and a namespace is a name.
        assert unclocked(left.messages(topic)) == unclocked(before.messages(topic))
    assert len(right.messages(topics.DEVICE_STATE)) == len(
        before.messages(topics.DEVICE_STATE)
    )
    assert right.manifest["axes"] == "x"
    assert left.manifest["axes"] == "z"


@pytest.fixture(scope="module")
def two_hands(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(tmp_path_factory.mktemp("two"), "two_hands", "duration:=0") as launch:
        yield launch


@pytest.mark.process
def test_verbs_name_nodes_and_topics_with_their_namespace(two_hands: Running) -> None:
    found = json.loads(typed(two_hands, "topic", "list", "--json").stdout)["topics"]
    assert {
        "/left/device/state",
        "/right/coupling/force",
        "/left/driver/status",
    } <= set(found)
    assert typed(
        two_hands, "topic", "echo", "/right/device/state", "--once"
    ).stdout.startswith("seq: ")
    assert typed(two_hands, "param", "get", "left/coupling", "usual.stiffness").stdout
    refused = typed(two_hands, "law", "switch", "pd_alpha", code=2).stderr
    assert "left/coupling, right/coupling" in refused
    assert "--run /left" in refused


@pytest.mark.process
def test_a_verb_takes_one_chain_as_if_it_were_alone(two_hands: Running) -> None:
    run = ("--run", "two_hands/left")
    found = json.loads(typed(two_hands, "topic", "list", "--json", *run).stdout)[
        "topics"
    ]
    assert set(topics.LOOP) <= set(found)
    assert not any("left" in topic or "right" in topic for topic in found)
    assert typed(
        two_hands, "topic", "echo", "/device/state", "--once", *run
    ).stdout.startswith("seq: ")
    # Forced: late ticks of a busy machine count as delay, and what is unstable at that is refused.
    typed(two_hands, "law", "switch", "pd_alpha", "--force", "--run", "/left")
    told = [
        typed(two_hands, "law", "list", "--json", "--run", f"/{hand}").stdout
        for hand in ("left", "right")
    ]
    assert [json.loads(each)["active"] for each in told] == ["pd_alpha", "pd"]
    refused = typed(two_hands, "topic", "list", "--run", "/middle", code=2).stderr
    assert "no namespace 'middle'; available: left, right" in refused


@pytest.mark.process
def test_python_names_the_chains_before_it_records(
    two_hands: Running, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name, value in (two_hands.environment or {}).items():
        monkeypatch.setenv(name, value)
    run = haptic.connect()
    remedy = re.escape('choose one with haptic.connect("two_hands/right")')
    out = tmp_path / "both.mcap"
    for wanted in (lambda: run.record(0.1, out), run.table, lambda: run.mark("x")):
        with pytest.raises(haptic.HapticError, match=remedy):
            wanted()
    assert not out.exists()
    one = haptic.connect("two_hands/right").record(0.2, out)
    assert len(one["time"]) > 1


@pytest.mark.slow
def test_a_recording_of_several_chains_says_how_to_take_one_out(
    two_hands: Running, tmp_path: Path
) -> None:
    both, one = tmp_path / "both.mcap", tmp_path / "both.filter.mcap"
    typed(two_hands, "bag", "record", "--duration", "0.3", "--out", str(both))
    remedy = f"haptic bag filter {both} -e ^/left/"
    assert remedy in typed(two_hands, "bag", "plot", str(both), code=1).stderr
    assert remedy in typed(two_hands, "bag", "export", str(both)).stderr
    typed(two_hands, *remedy.split()[1:])
    assert typed(two_hands, "bag", "export", str(one)).stderr == ""
    assert (tmp_path / "both.filter_csv" / "ticks.csv").is_file()
    typed(two_hands, "bag", "plot", str(one))


@pytest.mark.slow
def test_a_node_can_take_another_chains_topic(tmp_path: Path) -> None:
    """A second environment and coupling follow the first device with equal forces."""
    file = tmp_path / "shadow.yaml"
    file.write_text(
        f"""{HEAD}run: {{pace: lockstep, duration: 0.2}}
include:
  - launch: floor_drop
    without: [logger]
nodes:
  shadow/environment:
    kind: environment
    remap: {{/device/state: /device/state}}
    parameters: {{surface: {{kind: plane, axis: z, position: 0.0, normal: 1}}}}
  shadow/coupling:
    kind: coupling
    parameters: {{law: pd, laws: {{pd: {{kind: pd, stiffness: 1000.0, damping: 3.0}}}}}}
  logger: {{kind: logger}}
""",
        encoding="utf-8",
    )
    figures = launch_json(tmp_path, str(file))
    recording = Recording(tmp_path / figures["recording"])
    own, shadow = (
        recording.messages(topics.FORCE),
        recording.messages("/shadow/coupling/force"),
    )
    assert len(shadow) > 90
    assert [force.force for force in shadow] == [force.force for force in own][
        : len(shadow)
    ]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "include:\n  - launch: floor_drop\n  - launch: wall_press\n",
            "exists twice; give one a namespace",
        ),
        (
            (
                "include:\n  - {launch: floor_drop, namespace: a}\n  - {launch: floor_drop_fast,"
                " namespace: b}\n"
            ),
            "run.rate",
        ),
        ("include:\n  - {launch: floor_drop, namespace: LEFT}\n", "lower-case"),
        (
            "include:\n  - {launch: floor_drop, namespace: abcdefghijklmnopqrstuvwxyz}\n",
            "longer than 32 letters",
        ),
        (
            f"include:\n  - {{launch: floor_drop, namespace: {'a' * 33}}}\n",
            "at most 32",
        ),
        (
            "nodes:\n  run: {kind: sim_driver}\n",
            "'run' is reserved for the list of a run's nodes",
        ),
        (
            'nodes:\n  "driver\\n": {kind: sim_driver}\n',
            "a node's name has lower-case letters",
        ),
        ("include:\n  - {launch: floor_dorp}\n", "floor_drop"),
        ("include:\n  - {launch: floor_drop, arguments: {stifness: 1}}\n", "stiffness"),
        ("include:\n  - {launch: floor_drop, without: [loger]}\n", "logger"),
        ("include:\n  - {launch: mine.yaml}\n", "includes itself"),
        ("run: {rate: 500.0}\n", "no nodes"),
        (
            "include:\n  - {launch: floor_drop}\nnodes:\n  driver: {kind: sim_driver}\n",
            "an included launch file has a node of that name",
        ),
    ],
)
def test_what_cannot_be_included_is_refused(
    tmp_path: Path, text: str, told: str
) -> None:
    with pytest.raises(ParameterError, match=r"mine\.yaml") as refused:
        read(tmp_path, text)
    assert told in str(refused.value)


def test_files_that_include_one_another_for_ever_are_refused_at_once(
    tmp_path: Path,
) -> None:
    """Thirty files that include the next twice are a billion; cycles have no end."""
    for i in range(30):
        entry = f"launch: f{i + 1}.yaml"
        entries = f"  - {{{entry}}}\n  - {{{entry}, without: [driver]}}\n"
        (tmp_path / f"f{i}.yaml").write_text(f"{HEAD}include:\n{entries}")
    (tmp_path / "f30.yaml").write_text(
        f"{HEAD}nodes:\n  driver: {{kind: sim_driver}}\n"
    )
    with pytest.raises(ParameterError, match="more than 256 included launch files"):
        launch_file.read(str(tmp_path / "f0.yaml"), {})
    (tmp_path / "a.yaml").write_text(f"{HEAD}include:\n  - {{launch: b.yaml}}\n")
    (tmp_path / "b.yaml").write_text(f"{HEAD}include:\n  - {{launch: a.yaml}}\n")
    with pytest.raises(ParameterError, match="includes itself"):
        launch_file.read(str(tmp_path / "a.yaml"), {})
    assert scenario_files.read_arguments(tmp_path / "a.yaml")[1] == {}


@pytest.mark.parametrize("written", ["x$(var a)$(var a)", "$(dirname)" * 1000])
def test_text_that_grows_when_it_is_filled_in_is_bounded(
    tmp_path: Path, written: str
) -> None:
    """A kilobyte of arguments in a text could become gigabytes."""
    text = (
        f"arguments: {{a: {{default: {'z' * 2500}}}}}\nnodes:\n  driver: {{kind: sim_driver, watch:"
        f" '{written}'}}\n"
    )
    with pytest.raises(
        ParameterError,
        match=r"driver\.watch: \d+ characters once its arguments are filled in, limit 4096",
    ):
        read(tmp_path, text)


def test_arguments_reach_the_included_file(tmp_path: Path) -> None:
    launch = read(
        tmp_path,
        "arguments: {hard: {default: 900.0}}\ninclude:\n  - {launch: floor_drop, namespace: left,"
        " arguments: {stiffness: $(var hard), rate: 250}}\n",
        hard=1234,
    )
    assert launch.nodes["left/coupling"].parameters["usual"]["stiffness"] == 1234.0
    assert launch.run.rate == 250.0


def test_run_is_set_without_an_argument_for_it() -> None:
    launch = launch_file.read(
        "floor_drop", {"run.axes": ["z"], "run.fifo": 0, "run.rate": 700}
    )
    assert (launch.run.fifo, launch.run.rate) == (0, 700.0)
    with pytest.raises(ParameterError, match=r"run.*fifoo"):
        launch_file.read("floor_drop", {"run.fifoo": 0})
    with pytest.raises(ParameterError, match=r"run\.rate.*1"):
        launch_file.read("floor_drop", {"run.rate": 0.0})
