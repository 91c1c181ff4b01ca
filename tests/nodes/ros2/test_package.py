"""What a ROS 2 user starts: RViz file, launch file, package, and bridges that are added."""

from __future__ import annotations

import os
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml

from nodes.cli.main import parser_for
from nodes.launcher import launch_file
from nodes.parameters.store import ParameterError, convert
from nodes.recording.ros2_messages import FRAME, LATCHED, ros2_topics
from nodes.ros2.added_bridges import with_ros2
from nodes.ros2.node import Ros2Parameters
from tests.support import ROOT
from tests.support.launching import running
from tests.support.ros_launch import processes

FOLDER = ROOT / "launch" / "ros2"
LAUNCH = FOLDER / "haptic.launch.py"
# Displays and the types that they show (plugins_description.xml of rviz_default_plugins).
SHOWS = {
    "Pose": "geometry_msgs/msg/PoseStamped",
    "Wrench": "geometry_msgs/msg/WrenchStamped",
    "Marker": "visualization_msgs/msg/Marker",
}


def test_rviz_shows_what_is_published() -> None:
    file = yaml.safe_load((FOLDER / "haptic.rviz").read_text(encoding="utf-8"))
    manager = file["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == FRAME
    published, shown = ros2_topics(), {}
    for display in manager["Displays"]:
        kind = display["Class"].removeprefix("rviz_default_plugins/")
        topic = display.get("Topic")
        if topic is None:
            assert kind in ("Grid", "TF")
            continue
        shown[topic["Value"]] = SHOWS[kind]
        latched = topic["Value"].removeprefix("/haptic/") in LATCHED
        # A subscription may ask for no more than the publisher offers.
        assert topic["Durability Policy"] == (
            "Transient Local" if latched else "Volatile"
        )
    assert shown.items() <= {(name, kind) for name, (kind, _) in published.items()}
    assert {"/haptic/wall", "/haptic/device/pose", "/haptic/device/force"} <= set(shown)


def test_the_package_is_this_one() -> None:
    package = ET.parse(FOLDER / "package.xml").getroot()  # noqa: S314  # our own file
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert package.findtext("version") == project["project"]["version"]
    assert package.findtext("license") == project["project"]["license"]
    name = package.findtext("name")
    placed = project["tool"]["hatch"]["build"]["targets"]["wheel"]["shared-data"]
    # Where ros2 launch looks for a package, its launch files and its RViz file.
    assert set(placed.values()) == {
        f"share/ament_index/resource_index/packages/{name}",
        f"share/{name}/package.xml",
        f"share/{name}/launch/haptic.launch.py",
        f"share/{name}/rviz/haptic.rviz",
    }
    assert all((ROOT / source).is_file() for source in placed)
    # Each package of the types that are published, and of what ends them.
    types = {kind.partition("/")[0] for kind, _ in ros2_topics(simulated=True).values()}
    needed = {one.text for one in package.findall("exec_depend")}
    assert needed == types | {"rclpy", "std_srvs", "launch"}


def test_ros2_launch_starts_a_scenario_with_its_arguments() -> None:
    (haptic,) = processes(LAUNCH)
    assert Path(haptic.cmd[0]).name == "haptic"
    assert haptic.cmd[1:] == ["launch", "ros2_wall", "--ros2", "read", "--no-plot"]
    assert haptic.on_exit is not None
    # A launch ends softly within 10 s; after 5 s ros2 launch would terminate it by default.
    assert float(haptic.sigterm_timeout) >= 10.0
    haptic, rviz = processes(
        LAUNCH,
        scenario="wall_press",
        arguments="stiffness:=1500 law:='{kind: pd}'",
        control="true",
        rviz="True",
    )
    parsed = parser_for("launch").parse_args(haptic.cmd[1:])
    assert (parsed.scenario, parsed.ros2) == ("wall_press", "control")
    assert parsed.assignments == ["stiffness:=1500", "law:={kind: pd}"]
    assert rviz.cmd == ["rviz2", "-d", str(FOLDER / "haptic.rviz")]
    with pytest.raises(ValueError, match="control:=yes: expected true or false"):
        processes(LAUNCH, control="yes")


def test_the_installed_launch_file_starts_the_command_beside_it(tmp_path: Path) -> None:
    place = tmp_path / "share" / "haptic_nodes"
    for name, folder in (("haptic.launch.py", "launch"), ("haptic.rviz", "rviz")):
        (place / folder).mkdir(parents=True)
        (place / folder / name).write_bytes((FOLDER / name).read_bytes())
    command = tmp_path / "bin" / "haptic"
    command.parent.mkdir()
    command.touch()
    haptic, rviz = processes(place / "launch" / "haptic.launch.py", rviz="true")
    assert haptic.cmd[0] == str(command)
    assert rviz.cmd[2] == str(place / "rviz" / "haptic.rviz")


def kinds(scenario: str, mode: Any) -> dict[str, dict[str, Any]]:
    launch = with_ros2(launch_file.read(scenario, {}), mode)
    return {
        name: spec.parameters
        for name, spec in launch.nodes.items()
        if spec.kind == "ros2"
    }


def test_each_chain_has_a_bridge_of_its_own() -> None:
    assert kinds("floor_swap", "read") == {"ros2": {}}
    both = {"left/ros2": {"control": True}, "right/ros2": {"control": True}}
    assert kinds("two_hands", "control") == both
    # A file's own bridge stays what it is.
    written = launch_file.read("ros2_wall", {}).nodes["ros2"].parameters
    assert kinds("ros2_wall", "read") == {"ros2": written}
    assert convert(both["left/ros2"], Ros2Parameters, "ros2").control
    with pytest.raises(ParameterError):
        convert({"control": "maybe"}, Ros2Parameters, "ros2")


@pytest.mark.process
def test_a_signal_ends_the_scenario_softly(tmp_path: Path) -> None:
    pytest.importorskip("cyclonedds")
    (haptic,) = processes(LAUNCH, scenario="free_space", arguments="duration:=0")
    domain = {
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 99),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    with running(tmp_path, *haptic.cmd[2:], environment=domain) as launch:
        # As Ctrl-C of ros2 launch does; on the way out it asserts that nothing is left.
        launch.interrupt()
        figures = launch.figures
    assert not figures["failures"]
