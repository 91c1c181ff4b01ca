"""Start a scenario of haptic-nodes on the ROS 2 graph, and end it with ``ros2 launch``.

ros2 launch haptic_nodes haptic.launch.py scenario:=wall_press arguments:='stiffness:=1500'
"""

import os
import shlex
import shutil

from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    OpaqueFunction,
    Shutdown,
)
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription

ARGUMENTS = {
    "scenario": (
        "ros2_wall",
        "scenario or path of a launch file: haptic launch --list",
    ),
    "arguments": ("", "its arguments, as 'stiffness:=1500 duration:=20'"),
    "control": ("false", "whether the graph may set parameters and switch the law"),
    "rviz": ("false", "whether RViz is started too"),
}
# The force ramps to zero and recordings are completed before the processes end [s].
SOFT_END = "20"


def beside(*places: str) -> str:
    """Return the first file that exists beside this one, or the last place."""
    here = os.path.dirname(os.path.realpath(__file__))
    paths = [os.path.normpath(os.path.join(here, place)) for place in places]
    return next(filter(os.path.isfile, paths), paths[-1])


def haptic() -> str:
    """Return the command of the environment that this file is installed in, else of PATH."""
    own = beside("../../../bin/haptic")
    return own if os.path.isfile(own) else shutil.which("haptic") or "haptic"


def start(context, *_, **__):
    """Return the processes to start."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    for name in ("control", "rviz"):
        if given[name].lower() not in ("true", "false"):
            raise ValueError(f"{name}:={given[name]}: expected true or false")
    mode = "control" if given["control"].lower() == "true" else "read"
    words = shlex.split(given["arguments"])
    processes = [
        ExecuteProcess(
            cmd=[
                haptic(),
                "launch",
                given["scenario"],
                *words,
                "--ros2",
                mode,
                "--no-plot",
            ],
            name="haptic",
            output="screen",
            sigterm_timeout=SOFT_END,
            on_exit=Shutdown(reason="the scenario has ended"),
        )
    ]
    if given["rviz"].lower() == "true":
        file = beside("../rviz/haptic.rviz", "haptic.rviz")
        processes.append(
            ExecuteProcess(cmd=["rviz2", "-d", file], name="rviz2", output="log")
        )
    return processes


def generate_launch_description():
    """Return what ``ros2 launch`` starts."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])
