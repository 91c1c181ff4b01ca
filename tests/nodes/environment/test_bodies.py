"""Scenes with moving bodies: forces on the tool, contacts, refusals, repeatability."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from messages.topics import DEVICE_STATE, PROXY, event
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.launcher import launch_file
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError
from nodes.recording.facts import parameters_of
from nodes.recording.reader import Recording
from nodes.stability.k_max import k_max
from nodes.stability.plant import Plant
from nodes.view.drawn_bodies import RecordedBodies, met_ticks, scene_changes
from tests.support import ROOT
from tests.support.launching import launch_json, running, typed, wait_for

pytest.importorskip(
    "mujoco", reason="things that move need MuJoCo: pip install 'haptic-nodes[mujoco]'"
)

PERIOD, GAIN = 0.002, 2.0
TOOL = """<body name="tool" pos="0 0 0.1" gravcomp="1">
<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="slide" axis="0 0 1"/><geom type="sphere" size="0.005" mass="0.05"/></body>"""


def scene(folder: Path, bodies: str, option: str = 'timestep="0.0005"') -> Path:
    path = folder / "scene.xml"
    path.write_text(
        f"<mujoco><option {option}/><worldbody>{bodies}</worldbody></mujoco>",
        encoding="ascii",
    )
    return path


def world(
    folder: Path, bodies: str = TOOL, option: str = 'timestep="0.0005"'
) -> MovingScene:
    return MovingScene(scene(folder, bodies, option), "tool", PERIOD, "environment")


@pytest.mark.parametrize("delay", [0.0, 0.25, 0.5, 1.0, 1.75])
def test_the_tool_feels_the_force_when_the_device_does(
    delay: float, tmp_path: Path
) -> None:
    """A force with a delay, reversed a tick later: the tool's momentum is its opposite."""
    free = world(tmp_path)
    free.begin((0.01, 0.02, 0.03))
    assert free.tool_position == pytest.approx((0.01, 0.02, 0.03), abs=1e-15)
    speed = []
    for tick in range(1, 5):
        free.hand_over(
            (3.0, 0.0, -1.0) if tick == 1 else (0.0, 0.0, 0.0), tick - 1, delay
        )
        free.advance(tick)
        speed.append(free.data.qvel[:3].copy())
    for tick, found in enumerate(speed, 1):
        acted = PERIOD * (np.clip(tick - delay, 0.0, 1.0))
        assert found == pytest.approx(
            -np.array([3.0, 0.0, -1.0]) * acted / 0.05, abs=1e-12
        )


@pytest.mark.parametrize(
    "contact", ["", 'solref="-20000 -200"', 'friction="0.2 0.005 0.0001"']
)
def test_the_stiffness_that_is_told_is_the_one_that_is_felt(
    contact: str, tmp_path: Path
) -> None:
    """Measured in its own scene; felt here by how much deeper 1.5 N press than 0.5 N."""
    felt = world(
        tmp_path, TOOL + f'<geom name="floor" type="plane" size="1 1 1" {contact}/>'
    )
    (told,) = felt.stiffness()
    felt.begin((0.0, 0.0, 0.0051))
    heights = []
    for part, load in enumerate((0.5, 1.5)):
        for tick in range(500 * part + 1, 500 * part + 501):
            felt.hand_over((0.0, 0.0, load), tick - 1, 0.0)
            felt.advance(tick)
        heights.append(felt.tool_position[2])
    assert told.geom == "floor"
    # In MuJoCo a contact grows stiffer with depth, and this one is pressed through other geoms: by
    # up to a percent.
    assert told.stiffness == pytest.approx(1.0 / (heights[0] - heights[1]), rel=0.02)


def test_after_a_long_fault_the_scene_does_not_make_up_for_all_of_it(
    tmp_path: Path,
) -> None:
    """A gliding tool continues for a tenth of a second, whatever time was missed."""
    ways = []
    for missed in (500, 50_000):
        felt = world(tmp_path)
        felt.begin((0.0, 0.0, 0.0))
        felt.data.qvel[0] = 0.1
        felt.advance(missed)
        ways.append(felt.tool_position[0])
        felt.advance(missed + 1)
        assert felt.tool_position[0] - ways[-1] == pytest.approx(0.1 * PERIOD, rel=1e-6)
    assert ways[0] == ways[1] == pytest.approx(0.1 * 0.1, rel=1e-6)


@pytest.mark.parametrize(
    ("bodies", "told"),
    [
        ("", "environment.tool: no body 'tool' in .*its bodies are none"),
        (
            '<body name="tool"><freejoint/><geom size="0.01"/></body>',
            "must be a child of the world with three slide joints",
        ),
        (TOOL.replace('"0 1 0"', '"1 0 0"'), "three slide joints"),
        (TOOL.replace('axis="0 0 1"', 'axis="0 0 1" range="0 1"'), "without limits"),
        (TOOL.replace('mass="0.05"', 'mass="1e-9"'), "weighs 1e-09 kg"),
        # MuJoCo warns, and takes the mass of water.
        (
            TOOL.replace('mass="0.05"', 'mass="nan"'),
            "environment.scene: .*contains a 'NaN'",
        ),
        (
            TOOL.replace('mass="0.05"', 'mass="inf"'),
            "body 'tool' weighs inf kg, expected at most 1e.06 kg",
        ),
        (
            TOOL + '<body name="b"><geom size="0.1" mass="1e300"/></body>',
            "body 'b' weighs 1e.300 kg",
        ),
        (
            TOOL
            + '<body name="b"><geom size="0.1" mass="1e6"/><geom size="0.1" mass="1"/></body>',
            "body 'b' weighs 1e.06 kg",
        ),
        (
            TOOL + '<body><joint damping="1e300"/><geom size="0.1"/></body>',
            "a number of dof_damping is 1e.300",
        ),
        (
            TOOL.replace('size="0.005"', 'size="5"'),
            "a geom of body 'tool' reaches 5 m, .* MJCF is in metres",
        ),
        ('<geom type="sph"/>', "environment.scene: .*invalid keyword: 'sph'"),
        (
            '</worldbody><asset><texture name="t" type="2d" file="no.png"/></asset><worldbody>',
            "environment.scene: .*no.png",
        ),
    ],
)
def test_a_scene_without_a_tool_is_refused(
    bodies: str, told: str, tmp_path: Path
) -> None:
    with pytest.raises(ParameterError, match=told):
        world(tmp_path, bodies)


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ('timestep="0"', "option timestep is 0 s, expected a time above 0"),
        ('timestep="-0.001"', "option timestep is -0.001 s"),
        ('timestep="inf"', "option timestep is inf s"),
        ('gravity="0 0 -1e300"', "a number of gravity is -1e.300"),
        ('gravity="0 0 inf"', "a number of gravity is inf"),
    ],
)
def test_an_option_that_no_step_can_be_made_with_is_refused(
    option: str, told: str, tmp_path: Path
) -> None:
    """A step of 0 s ended in a traceback."""
    with pytest.raises(ParameterError, match=told):
        world(tmp_path, TOOL, option)


def test_the_heaviest_body_is_taken(tmp_path: Path) -> None:
    world(tmp_path, TOOL + '<body name="b"><geom size="0.1" mass="1e6"/></body>')


def test_what_is_missing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(
        ParameterError,
        match=r"environment.scene: .*none.xml cannot be read: No such file",
    ):
        MovingScene(tmp_path / "none.xml", "tool", PERIOD, "environment")
    os.mkfifo(tmp_path / "pipe.xml")
    for odd in (tmp_path / "pipe.xml", Path("/dev/zero")):
        with pytest.raises(
            ParameterError, match=r"^environment.scene: .* is not a regular file"
        ):
            MovingScene(odd, "tool", PERIOD, "environment")
    with open(tmp_path / "huge.xml", "wb") as file:
        file.truncate(10_000_000_000)
    with pytest.raises(
        ParameterError,
        match=r"^environment.scene: \S*huge.xml has 10000 MB, more than 64",
    ):
        MovingScene(tmp_path / "huge.xml", "tool", PERIOD, "environment")
    with pytest.raises(ParameterError, match="at most 1000; raise option timestep"):
        world(tmp_path, TOOL, 'timestep="1e-6"')
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ParameterError, match=r"pip install 'haptic-nodes\[mujoco\]'"):
        world(tmp_path)


@pytest.mark.process
@pytest.mark.parametrize(
    ("scenario", "moved"),
    [
        ("knob_turn", "knob"),
        pytest.param("puck_push", "puck", marks=pytest.mark.slow),
        pytest.param("stack_boxes", "upper", marks=pytest.mark.slow),
    ],
)
def test_a_launch_repeats_to_the_bit_from_its_recording(
    scenario: str, moved: str, tmp_path: Path
) -> None:
    """The recorded forces move the scene the same way again: there is no other input."""
    figures = launch_json(
        tmp_path, scenario, "pace:=lockstep", "duration:=1.6", "apply:=next_tick"
    )
    recording = Recording(tmp_path / figures["recording"])
    states, proxies = recording.messages(DEVICE_STATE), recording.messages(PROXY)
    parameters = launch_file.read(scenario, {}).nodes["environment"].parameters
    again = MovingScene(Path(parameters["scene"]), "tool", PERIOD, "environment")
    before = (
        np.array(again.data.body(moved).xpos),
        np.array(again.data.body(moved).xquat),
    )
    again.begin(states[0].position)
    for state, proxy in zip(states, proxies, strict=False):
        if state.seq:
            again.hand_over(state.force, state.seq - 1 - state.age, state.delay)
            again.advance(state.seq)
        assert again.tool_position == proxy.proxy
    # And it was moved: by more than a centimetre, or by more than a quarter of a radian.
    way = np.linalg.norm(again.data.body(moved).xpos - before[0])
    turn = 2.0 * np.arccos(
        min(1.0, abs(float(again.data.body(moved).xquat @ before[1])))
    )
    assert way > 0.01 or turn > 0.25
    certain = [
        one.reason
        for one in recording.messages(event("coupling"))
        if one.kind == "world"
    ]
    assert len(certain) == 2
    # Its mass certifies a known hand; any hand takes damping or more mass.
    known, any_hand = sorted(certain, key=lambda one: "not certified" in one)
    assert "not certified" not in known
    assert "certified with a tool of at least 0.05 kg" in known
    assert "it takes damping of the tool of at least" in any_hand
    assert "or a mass of the tool of at least" in any_hand
    told = next(
        one.reason
        for one in recording.messages(event("environment"))
        if one.kind == "bodies"
    )
    assert re.search(
        r"weighs 0.05 kg .* contacts, measured: \w+(, \w+)* 2.94e\+03 N/m", told
    )


@pytest.mark.parametrize(
    ("mass", "tool", "damping"), [(0.15, 0.05, 3.0), (0.1, 0.5, 1.0), (0.3, 0.02, 0.0)]
)
def test_the_figures_know_the_tool(mass: float, tool: float, damping: float) -> None:
    """K_max of a spring and damper between both, against eigenvalues of two bodies."""
    free = np.zeros((5, 5))
    free[0, 1] = free[2, 3] = 1.0
    free[1, 1] = -damping / mass
    free[1, 4], free[3, 4] = 1.0 / mass, -1.0 / tool
    tick = expm(PERIOD * free)

    def radius(stiffness: float) -> float:
        # The force is held during a tick: of the deflection now and of the one before.
        pull = np.array(
            [
                -(stiffness + GAIN / PERIOD),
                0.0,
                stiffness + GAIN / PERIOD,
                0.0,
                -GAIN / PERIOD,
            ]
        )
        whole = tick[:, :4] @ np.eye(4, 5) + np.outer(tick[:, 4], pull)
        whole[4] = (-1.0, 0.0, 1.0, 0.0, 0.0)
        return float(np.abs(np.linalg.eigvals(whole)).max())

    low, high = 1.0, 1e5
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        # Both may drift together: without damping a double pole at 1, which rounding splits by
        # 1e-8.
        low, high = (middle, high) if radius(middle) < 1.0 + 1e-6 else (low, middle)
    law = CompiledLaw((GAIN / PERIOD, -GAIN / PERIOD))
    alone, seen = (
        k_max(law, plant).h1_max_n_per_m
        for plant in (
            Plant(PERIOD, mass, damping),
            Plant(PERIOD, mass, damping).with_tool(tool),
        )
    )
    assert alone is not None
    assert seen is not None
    # What is allowed for the double pole at 1 moves the edge that is looked for here by up to 1e-4.
    assert seen == pytest.approx(low, rel=1e-4)
    assert seen < alone


@pytest.mark.process
@pytest.mark.slow
def test_a_running_scene_is_reset_and_its_actuators_controlled(tmp_path: Path) -> None:
    """Somebody else's arm with a motor and a keyframe, by their commands."""
    (tmp_path / "arm.xml").write_text(
        """<mujoco><worldbody><body name="arm" pos="0 0.2 0">
        <joint name="hinge" axis="0 1 0" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.01"/></body></worldbody>
        <actuator><position name="elbow" joint="hinge" kp="1"/></actuator>
        <keyframe><key name="up" qpos="-0.5" ctrl="-0.5"/></keyframe></mujoco>""",
        encoding="ascii",
    )
    text = (ROOT / "launch" / "knob_turn.yaml").read_text("utf-8")
    (tmp_path / "own.yaml").write_text(
        text.replace(
            "scene: $(dirname)/bodies/knob.xml",
            "{scene: $(dirname)/arm.xml, tool: {mass: 0.05}, keyframe: up, controls: {age: 1.0}}",
        ).replace("parameters:\n      {scene", "parameters: {scene"),
        encoding="utf-8",
    )
    with running(tmp_path, "./own.yaml", "duration:=0") as launch:
        wait_for(lambda: launch.ticks() > 20, "ticks")
        again = typed(launch, "node", "reset")
        assert "the scene starts again, from tick" in again.stdout
        one = ("topic", "pub", "/external/controls", "--once")
        assert "published 1" in typed(launch, *one, "{elbow: 0.4}").stdout
        assert "published 1" in typed(launch, *one, "[0.4]").stdout
        assert (
            "no actuator 'elbo'" in typed(launch, *one, "{elbo: 0.4}", code=None).stderr
        )
        launch.interrupt()
    (path,) = tmp_path.glob("recordings/own*.mcap")
    recording = Recording(path)
    told = [one.reason for one in recording.messages(event("environment"))]
    assert any(
        "the scene was reset on request; the tool restarts at the device" in one
        for one in told
    )
    # A replay of the recording moves the bodies as they went, to the bit.
    changes = scene_changes(recording, "environment")
    assert [one.actuator for one in changes] == [-1, 0, 0]
    (parameters,) = [one for one in parameters_of(recording).values() if "scene" in one]
    drawn = RecordedBodies(
        parameters, PERIOD, "environment", met_ticks(recording), changes
    )
    answers = {one.seq: one.proxy for one in recording.messages(PROXY)}
    for state in recording.messages(DEVICE_STATE):
        drawn.follow(state)
        if state.seq in answers:
            assert drawn.world.tool_position == answers[state.seq]
