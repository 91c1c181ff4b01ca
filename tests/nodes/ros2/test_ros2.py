"""The node kind ``ros2`` against rclpy itself: what a ROS 2 graph receives and may do."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest

import nodes.ros2.ros_library as ros_library
from messages.types import DeviceState, Event, Receipt
from nodes.base.setup import Setup
from nodes.driver.external import ExternalParameters
from nodes.launcher import launch_file
from nodes.parameters.store import ParameterError
from nodes.recording.export_ros2 import export_ros2
from nodes.recording.reader import Recording
from nodes.ros2.node import Ros2
from tests.support.launching import running
from tests.support.rclpy_probe import PULL, PUSH
from tests.support.setups import setup_of

pytestmark = pytest.mark.realtime

PYTHON = os.environ.get("RCLPY_PYTHON") or (
    sys.executable if find_spec("rclpy") else ""
)
"""A Python with rclpy: this one, or that of the variable."""

PROBE = Path(__file__).parents[2] / "support" / "rclpy_probe.py"
SECONDS = 0.8
RATE = 100.0  # of the scenario [Hz]


class Heard(NamedTuple):
    """Results of a launch beside a ROS 2 node."""

    told: dict[str, Any]
    recording: Recording
    offset: float

    def states(self, since: str, until: str) -> list[DeviceState]:
        """Return the recorded states of a time span."""
        begin, end = self.told[since] - self.offset, self.told[until] - self.offset
        return [
            state
            for state in self.recording.messages("/device/state")
            if begin <= state.stamp <= end
        ]


BACKENDS = [
    pytest.param(
        "cyclonedds",
        marks=[
            pytest.mark.process,
            pytest.mark.skipif(
                not PYTHON,
                reason="no rclpy: pip install -e '.[rclpy]', or set RCLPY_PYTHON",
            ),
        ],
    ),
    pytest.param(
        "rclpy",
        marks=[
            pytest.mark.process,
            pytest.mark.skipif(
                find_spec("rclpy") is None,
                reason="this Python has no rclpy: pip install -e '.[rclpy]'",
            ),
        ],
    ),
]


@pytest.fixture(scope="module", params=BACKENDS)
def heard(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Heard:
    backend = request.param
    folder = tmp_path_factory.mktemp(backend)
    # A domain of its own: nobody else's graph hears it, or is heard.
    domain = {
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 99),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    # One of them within a namespace, as where several chains share a graph.
    namespace = "/left" if backend == "rclpy" else ""
    include = {
        "launch": "ros2_wall",
        "namespace": namespace[1:],
        "arguments": {"backend": backend},
    }
    file = folder / "wall.yaml"
    file.write_text(
        json.dumps({"summary": "a wall on a graph", "include": [include]}),
        encoding="utf-8",
    )
    with running(folder, str(file), environment=domain) as launch:
        done = subprocess.run(
            [
                PYTHON,
                str(PROBE),
                str(SECONDS),
                "parameters" if backend == "rclpy" else "plain",
                namespace,
            ],
            capture_output=True,
            text=True,
            timeout=90.0,
            env={**os.environ, **domain},
            check=False,
        )
        assert done.returncode == 0, done.stderr
        launch.interrupt()
        figures = launch.figures
    assert not figures["failures"]
    recording = Recording(folder / figures["recording"])
    told = json.loads(done.stdout)
    told["backend"] = backend
    told["namespace"] = namespace
    told["poses_are"] = told["types"][f"{namespace}/haptic/device/pose"]
    # Each chain is pulled and pushed by what is named as its own, and by nothing else.
    inputs = {name for name in told["types"] if name.endswith(("/wrench", "/target"))}
    assert inputs == {f"{namespace}/haptic/wrench", f"{namespace}/haptic/target"}
    return Heard(told, recording, float(recording.manifest["wall_minus_monotonic_s"]))


def poses_in_bag(heard: Heard, folder: Path) -> dict[int, tuple[float, ...]]:
    """Return stamp [ns] and position of each pose in a run's bag, and check its topics."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    namespace = heard.told["namespace"]
    export_ros2(heard.recording, folder)
    store = get_typestore(Stores.ROS2_HUMBLE)
    found: dict[int, tuple[float, ...]] = {}
    with Reader(folder) as reader:
        kinds = {one.topic: [one.msgtype] for one in reader.connections}
        poses = [
            one
            for one in reader.connections
            if one.topic == f"{namespace}/haptic/device/pose"
        ]
        for line, _, raw in reader.messages(connections=poses):
            pose: Any = store.deserialize_cdr(raw, line.msgtype)
            point = pose.pose.position
            stamp = pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec
            found[stamp] = (point.x, point.y, point.z)
    live = {topic: kinds.get(topic) for topic in heard.told["types"]}
    own = {topic for topic in live if live[topic] or topic in kinds}
    assert all(heard.told["types"][topic] == kinds[topic] for topic in own)
    # A type whose package this Python lacks is on no graph of rclpy.
    missing = kinds.keys() - own - {f"{namespace}/haptic/parameters"}
    assert missing <= ({"/tf"} if heard.told["backend"] == "rclpy" else set())
    return found


def test_rclpy_hears_what_was_recorded(heard: Heard, tmp_path: Path) -> None:
    recorded = poses_in_bag(heard, tmp_path / "bag")
    poses = heard.told["poses"]
    # Each pose that was heard stands in the bag, with the very stamp.
    assert [tuple(pose[2:]) for pose in poses] == [
        recorded[pose[0] * 10**9 + pose[1]] for pose in poses
    ]
    positions = {state.position for state in heard.recording.messages("/device/state")}
    assert all(tuple(joints[1]) in positions for joints in heard.told["joints"])
    assert heard.told["joints"][0][0] == ["x", "y", "z"]
    assert heard.told["frame"] == "haptic"
    begin = f"{heard.told['namespace'][1:]}/haptic".lstrip("/")
    assert heard.told["force_frame"] == f"{begin}_device"
    # What no package of this Python can read is on the graph all the same, if it is ours to send.
    if heard.told["backend"] == "cyclonedds":
        assert heard.told["types"]["/tf"] == ["tf2_msgs/msg/TFMessage"]
        assert heard.told["types"]["/diagnostics"] == [
            "diagnostic_msgs/msg/DiagnosticArray"
        ]
    assert "pd" in heard.told["laws"]
    assert all(heard.told["counts"].values())


def test_it_is_told_at_the_decimated_rate(heard: Heard) -> None:
    rate = len(heard.told["poses"]) / heard.told["span"]
    # Of 500 Hz every fifth or less: a busy machine sends less, never more.
    assert rate <= RATE * 1.05
    assert heard.told["poses_are"] == ["geometry_msgs/msg/PoseStamped"]


def test_a_wrench_is_taken_on_top_of_the_law_and_ends_with_its_age(
    heard: Heard,
) -> None:
    forces = {
        force.seq: force.force for force in heard.recording.messages("/coupling/force")
    }

    def beyond_the_law(states: list[DeviceState]) -> set[float]:
        active = [s for s in states if s.safety == "active" and s.force_seq in forces]
        return {round(s.force[0] - forces[s.force_seq][0], 9) for s in active}

    assert PUSH in beyond_the_law(heard.states("pushed_from", "pushed_to"))
    # Whatever was stamped 5 s ago is refused, and what is not renewed is gone.
    assert beyond_the_law(heard.states("old_from", "pushed_from")) == {0.0}
    age = (
        launch_file.read("ros2_wall", {}).nodes["driver"].parameters["external"]["age"]
    )
    after = [
        s
        for s in heard.states("pushed_to", "pulled_to")
        if s.stamp > heard.told["pushed_to"] - heard.offset + 2 * age
    ]
    assert beyond_the_law(after) == {0.0}
    # A request for each of them took ten times the round's time: as many poses come while somebody
    # pushes as while he pulls.
    spans = (("pushed_from", "pushed_to"), ("pushed_to", "pulled_to"))
    pushed, pulled = (
        sum(
            heard.told[since] <= pose[0] + 1e-9 * pose[1] <= heard.told[until]
            for pose in heard.told["poses"]
        )
        for since, until in spans
    )
    # On a machine that publishes hardly any there is nothing to compare.
    assert pushed > 0.4 * pulled or pulled < 0.1 * RATE * SECONDS
    refusals = [
        e.reason
        for e in heard.recording.messages("/ros2/event")
        if isinstance(e, Event) and e.kind == "stale"
    ]
    assert "limit 0.1 s" in refusals[0]


def test_a_target_pulls_the_hand_at_its_limited_speed(heard: Heard) -> None:
    targets = [s.target[0] for s in heard.states("pushed_to", "pulled_to")]
    speed, period = 0.5, 0.002
    assert max(abs(b - a) for a, b in pairwise(targets)) <= speed * period * (1 + 1e-9)
    assert PULL in targets


def test_rclpy_sets_parameters_and_hears_refusals(heard: Heard) -> None:
    if "good" not in heard.told:
        pytest.skip("cyclonedds serves no parameters")
    assert f"{heard.told['namespace']}/ros2" in heard.told["nodes"]
    assert heard.told["good"] == [True, ""]
    receipts = [
        json.loads(receipt.after)
        for receipt in heard.recording.messages("/coupling/receipt")
        if isinstance(receipt, Receipt)
    ]
    told = [(one["law"], one.get("stiffness"), one.get("damping")) for one in receipts]
    # Both at one tick; the refused ones at none.
    assert told[0] == ("pd", 700.0, 3.0)
    assert [law for law, *_ in told] == ["pd", "pd_alpha", "multi_term"]
    for refused in ("bad", "none_of_two"):
        done, why = heard.told[refused]
        assert not done
        assert "coupling.laws.pd.stiffness: expected a number above 0, got -1.0" in why
    assert heard.told["law"] == [True, ""]
    done, text = heard.told["switched"]
    assert done
    assert text.startswith("multi_term from tick ")
    assert heard.told["shown"] == ["multi_term", 700.0, 3.0]
    assert heard.told["about"] == "K [N/m]; above 0; number"


def node(**parameters: Any) -> Setup:
    return msgspec.structs.replace(
        setup_of(), name="ros2", kind="ros2", parameters=parameters
    )


def test_without_a_library_both_extras_are_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ros_library, "find_spec", lambda _: None)
    with pytest.raises(
        ParameterError, match=r"haptic-nodes\[ros2\].*haptic-nodes\[rclpy\]"
    ):
        Ros2.check(node())
    with pytest.raises(ParameterError, match=r"ros2\.backend: rclpy.*setup\.bash"):
        Ros2.check(node(backend="rclpy"))


def test_a_deterministic_run_takes_nothing_from_outside() -> None:
    with pytest.raises(ParameterError, match=r"ros2\.wrench: lockstep"):
        Ros2.check(msgspec.structs.replace(node(wrench="/w"), pace="lockstep"))


def test_the_scenario_states_how_long_a_wrench_lasts() -> None:
    external = launch_file.read("ros2_wall", {}).nodes["driver"].parameters["external"]
    assert msgspec.convert(external, ExternalParameters) == ExternalParameters(
        peak=2.0, age=0.1
    )
