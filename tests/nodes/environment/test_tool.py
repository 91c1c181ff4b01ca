"""The tool of a moving scene: response to a push, added mass and damping, certificates."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nodes.coupling.judgement import Judgement
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.environment.bodies import contacts
from nodes.environment.bodies.implicit import passive_within
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.node import (
    MujocoEnvironment,
    MujocoParameters,
    load_world,
)
from nodes.environment.bodies.start import controls_of
from nodes.environment.bodies.tool import ToolParameters, response_text
from nodes.launcher import launch_file
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError, convert
from nodes.stability.k_max import with_spring
from nodes.stability.needed import needed_tool_damping, needed_tool_mass
from nodes.stability.plant import Plant, held_step
from nodes.stability.worlds import SteppedTool, world_k_max

pytest.importorskip(
    "mujoco", reason="things that move need MuJoCo: pip install 'haptic-nodes[mujoco]'"
)

T = 0.002
SLIDES = "".join(
    f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1")
)


def scene(
    folder: Path,
    bodies: str,
    option: str = 'timestep="0.0005" integrator="implicitfast"',
) -> Path:
    path = folder / "scene.xml"
    path.write_text(
        f"<mujoco><option {option}/><worldbody>{bodies}</worldbody></mujoco>",
        encoding="ascii",
    )
    return path


@pytest.mark.parametrize(
    ("option", "lag"),
    [
        ('timestep="0.002"', 0.5),
        ('timestep="0.001" integrator="implicitfast"', 0.75),
        ('timestep="0.0005" integrator="implicit"', 0.875),
        ('timestep="0.002" integrator="RK4"', 1.0),
    ],
)
@pytest.mark.parametrize("damping", [0.0, 0.7])
def test_the_answer_of_a_tool_is_measured(
    option: str, lag: float, damping: float, tmp_path: Path
) -> None:
    """Lag 1 − 1/(2n) ticks with n Euler steps, 1 with a fourth-order step."""
    floor = '<geom type="plane" size="1 1 1"/>'
    ball = '<geom size="0.005" mass="0.05"/>'
    bodies = f'{floor}<body name="tool" pos="0 0 0.004">{SLIDES}{ball}</body>'
    found = MovingScene(
        scene(tmp_path, bodies, option),
        ToolParameters(damping=damping),
        T,
        "environment",
    ).response()
    assert found.mass == pytest.approx(0.05, rel=1e-6)
    assert found.damping == pytest.approx(damping, rel=1e-6)
    # An implicit damper slows the first step by up to b T/m, which reads as so many ticks of lag.
    assert found.lag == pytest.approx(
        lag, abs=1e-6 if damping == 0.0 else damping * T / 0.05
    )
    assert ("no law is provably" in response_text(found)) == (damping == 0.0)


def test_the_axis_with_least_damping_counts_and_a_damper_between_bodies_does_not(
    tmp_path: Path,
) -> None:
    some = SLIDES.replace('"1 0 0"', '"1 0 0" damping="2"').replace(
        '"0 0 1"', '"0 0 1" damping="0.3"'
    )
    other = (
        '<body name="other" pos="1 0 0"><joint type="slide" axis="1 0 0"/><geom size="0.01"'
        ' mass="50"/><site name="b"/></body>'
    )
    tool = f'{some}<geom size="0.005" mass="0.05"/><site name="a"/>'
    bodies = f'<body name="tool">{tool}</body>{other}'
    path = scene(tmp_path, bodies)
    # along y
    assert MovingScene(path, "tool", T, "environment").response().damping == 0.0
    damped = ToolParameters(damping=0.4)
    assert MovingScene(
        path, damped, T, "environment"
    ).response().damping == pytest.approx(0.4, rel=1e-6)
    between = '<tendon><spatial damping="3"><site site="a"/><site site="b"/></spatial></tendon>'
    path.write_text(
        path.read_text().replace("</worldbody>", f"</worldbody>{between}"),
        encoding="ascii",
    )
    assert MovingScene(path, damped, T, "environment").response().damping <= 0.4 * (
        1.0 + 1e-6
    )
    assert MovingScene(path, "tool", T, "environment").response().damping == 0.0


def test_a_tool_is_added_to_a_scene_that_has_none(tmp_path: Path) -> None:
    path = scene(tmp_path, '<geom name="floor" type="plane" size="1 1 1"/>')
    added = {
        "scene": str(path),
        "tool": {
            "mass": 0.02,
            "radius": 0.004,
            "position": [0.0, 0.01, 0.1],
            "damping": 0.5,
        },
    }
    parameters = convert(added, MujocoParameters, "environment")
    assert isinstance(parameters.tool, ToolParameters)
    world = MovingScene(path, parameters.tool, T, "environment")
    assert world.mass == pytest.approx(0.02, rel=1e-12)
    assert world.tool_position == (0.0, 0.01, 0.1)
    assert world.damping == 0.5
    assert [pair.geom for pair in world.stiffness()] == ["floor"]
    assert MujocoEnvironment.plant(added, "environment", ("x", "y", "z")) == {
        "tool_mass": world.mass,
        "tool_damping": 0.5,
        "tool_step": 0.0005,
    }
    # Nothing pulls it down, and it rests on the floor where it is pressed.
    world.begin((0.0, 0.0, 0.05))
    for tick in range(1, 200):
        world.hand_over((0.0, 0.0, 0.0), tick - 1, 0.0)
        world.advance(tick)
    assert world.tool_position == pytest.approx((0.0, 0.0, 0.05), abs=1e-12)
    with pytest.raises(
        ParameterError,
        match=(
            r"environment.tool: no body 'tool' .* environment.tool: \{mass: 0.05, radius: 0.005\}"
        ),
    ):
        MovingScene(path, "tool", T, "environment")
    with pytest.raises(
        ParameterError,
        match=r"^environment.tool.mass: the scene has a body 'tool' already",
    ):
        MovingScene(
            scene(tmp_path, f'<body name="tool">{SLIDES}<geom size="0.01"/></body>'),
            ToolParameters(mass=1.0),
            T,
            "environment",
        )


def test_geoms_with_equal_contacts_are_pressed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """40 geoms of two kinds and one that never rests: three presses, a readable text."""
    pressed = []
    press = contacts._press

    def counted(*words: Any) -> Any:
        pressed.append(words)
        return press(*words)

    monkeypatch.setattr(contacts, "_press", counted)
    soft = "".join(f'<geom name="s{i}" pos="{i} 0 -1" size="0.1"/>' for i in range(30))
    hard = "".join(
        f'<geom name="h{i}" pos="{i} 0 -2" size="0.1" solref="-20000 -200"/>'
        for i in range(10)
    )
    ringing = (
        '<geom name="bell" pos="0 0 -3" size="0.1" priority="1" solref="-3000 0" solimp="0.99 0.99'
        ' 0.001"/>'
    )
    path = scene(tmp_path, soft + hard + ringing)
    found = MovingScene(path, ToolParameters(mass=0.05), T, "environment").stiffness()
    assert len(found) == 41
    assert len(pressed) == 3
    assert found[-1].stiffness is None
    text = contacts.contacts_text(found)
    assert "s0, s1, s2, s3, s4, s5 and 24 more 2.94e+03 N/m" in text
    assert "bell does not settle under 0.5 to 1.5 N" in text


def test_a_contact_that_grows_stiffer_is_called_curved(tmp_path: Path) -> None:
    """MuJoCo's default contact grows from 0.9 to 0.95 impedance over 1 mm."""
    path = scene(
        tmp_path,
        '<geom name="cushion" type="plane" size="1 1 1" priority="1" solimp="0.1 0.99 0.002"/>',
    )
    found = MovingScene(path, ToolParameters(mass=0.05), T, "environment").stiffness()
    assert found[0].stiffness is not None
    assert found[0].pressed is not None
    assert found[0].pressed > 1.2 * found[0].stiffness
    assert "under 4.5 N: it is nonlinear" in contacts.contacts_text(found)


def random_scene(folder: Path, rng: np.random.Generator) -> Path:
    """Return a tool with one to three sprung bodies, some undamped, beside or upon each other."""
    rest, depth = "", 0
    for _ in range(rng.integers(1, 4)):
        mass, stiffness = (
            10.0 ** rng.uniform(-3.3, 0.0),
            10.0 ** rng.uniform(1.0, 4.0) * (rng.random() < 0.8),
        )
        damping = 10.0 ** rng.uniform(-2.0, 1.0) * (rng.random() < 0.5)
        spring = f'stiffness="{stiffness}" damping="{damping}"'
        rest += f'<body><joint type="slide" axis="1 0 0" {spring}/>'
        rest += f'<geom size="0.001" mass="{mass}" contype="0" conaffinity="0"/>'
        depth += 1
        if rng.random() < 0.5:
            rest, depth = f"{rest}</body>", depth - 1
    rest += depth * "</body>"
    mass = 10.0 ** rng.uniform(-3.0, -1.0)
    ball = f'<geom size="0.005" mass="{mass}" contype="0" conaffinity="0"/>'
    option = 'timestep="0.0005" integrator="implicitfast" gravity="0 0 0"'
    return scene(folder, f'<body name="tool">{SLIDES}{ball}{rest}</body>', option)


def growth(
    path: Path, damping: float, law: CompiledLaw, plant: Plant, ticks: int = 1200
) -> float:
    """Return the growth per tick of a pushed device's deflection on a scene's tool."""
    world, delay = (
        MovingScene(path, ToolParameters(damping=damping), T, "environment"),
        int(plant.delay),
    )
    world.begin((0.0, 0.0, 0.0))
    _, (a11, a12, a21, a22), (g1, g2), _ = held_step(plant)
    x, v, history, sent = 0.0, 0.01, [0.0] * len(law.taps), [0.0] * (delay + 1)
    seen = []
    for tick in range(ticks):
        if tick:
            world.hand_over((sent[0], 0.0, 0.0), tick - 1, float(delay))
            world.advance(tick)
        history = [world.tool_position[0] - x, *history[:-1]]
        sent = [
            sum(tap * value for tap, value in zip(law.taps, history, strict=True)),
            *sent[:-1],
        ]
        x, v = (
            a11 * x + a12 * v + g1 * sent[delay],
            a21 * x + a22 * v + g2 * sent[delay],
        )
        seen.append(abs(history[0]))
        if seen[-1] > 1e3 or world.diverged():
            return math.inf
    quarters = np.array(seen).reshape(4, -1).max(axis=1)
    if quarters[3] < 1e-7 * quarters[0]:
        return 0.0  # at rest: MuJoCo's solver stops at 1e-8, and what remains is its rounding
    return float((quarters[3] / quarters[1]) ** (2.0 / ticks))


def unstable(folder: Path, count: int, parts: tuple[float, ...]) -> list[int]:
    """Count random scenes unstable at shares of the certified stiffness; delays 0 and 1."""
    rng, found = np.random.default_rng(2), [0] * len(parts)
    for i in range(count):
        plant, gain, damping = (
            Plant(T, 0.1, 1.0, float(i % 2)),
            (0.0, 0.3)[(i // 2) % 2],
            (0.5, 1.5, 5.0)[i % 3],
        )
        derivative = CompiledLaw((gain / T, -gain / T))
        edge = world_k_max(derivative, plant, SteppedTool(damping)).k_max_n_per_m
        assert edge is not None
        path = random_scene(folder, rng)
        for n, part in enumerate(parts):
            found[n] += (
                growth(path, damping, with_spring(derivative, part * edge), plant)
                > 1.0 + 1e-6
            )
    return found


def test_what_hangs_on_a_damped_tool_does_not_swing_below_its_figure(
    tmp_path: Path,
) -> None:
    """Five random worlds: none unstable at 0.99 of the certified stiffness, some at 3 times."""
    below, above = unstable(tmp_path, 5, (0.99, 3.0))
    assert below == 0
    assert above >= 1


@pytest.mark.slow
def test_a_hundred_rests_on_a_damped_tool(tmp_path: Path) -> None:
    below, above, far = unstable(tmp_path, 100, (0.99, 1.5, 3.0))
    assert below == 0
    assert above >= 5
    assert far >= 40


def test_a_coupling_to_a_tool_tells_what_is_certain_and_what_would_make_it_so() -> None:
    """`puck_push`: nothing without damping; certified with the requested damping only."""
    launch = launch_file.read("puck_push", {})
    given = launch.nodes["coupling"].parameters
    parameters: CouplingParameters = convert(given, CouplingParameters, "coupling")
    assert parameters.plant is not None
    assert parameters.plant.tool_mass == 0.05
    assert parameters.plant.tool_step == 0.0005
    judgement = Judgement("coupling", T, LawBook("coupling", T))
    # Its weight is enough, in four steps a tick; without it nothing is certain.
    for text in judgement.of_moving_world(parameters, 0.0):
        assert text.startswith(
            "coupling.laws.pd: certified with a tool of at least 0.05 kg, 4 st"
        )
    del given["plant"]["tool_step"]
    parameters = convert(given, CouplingParameters, "coupling")
    known, any_hand = judgement.of_moving_world(parameters, 0.0)
    assert known.startswith(
        "coupling.laws.pd: not certified with a stepped tool without damping to the ground"
    )
    assert "in any passive hand" in any_hand
    needed = needed_tool_damping(
        CompiledLaw((300.0 + 2.0 / T, -2.0 / T)), Plant(T, 0.15, 3.0, 0.0, 150.0)
    )
    assert needed is not None
    assert f"damping of the tool of at least {needed:.3g} N s/m" in known
    for part, certified in ((1.001, True), (0.999, False)):
        plant = {**given["plant"], "tool_damping": part * needed}
        damped = convert({**given, "plant": plant}, CouplingParameters, "coupling")
        told = judgement.of_moving_world(damped, 0.0)[0]
        assert told.startswith(
            f"coupling.laws.pd: {'certified' if certified else 'not certified'} with"
        )
    for any_hand_too, steps in ((False, 4), (True, 2)):
        device = Plant(T, 0.15, 3.0, 0.0, 150.0)
        law = CompiledLaw((300.0 + 2.0 / T, -2.0 / T))
        mass = needed_tool_mass(law, device, any_hand_too, steps)
        one = needed_tool_mass(law, device, any_hand_too)
        assert mass is not None
        for factor in (1.001, 0.999):
            plant = {
                **given["plant"],
                "tool_mass": factor * mass,
                "tool_step": T / steps,
            }
            light = convert({**given, "plant": plant}, CouplingParameters, "coupling")
            told = judgement.of_moving_world(light, 0.0)[any_hand_too]
            assert ("pd: certified with a tool of" in told) is (factor > 1.0)
            if factor < 1.0:
                assert (
                    f"or a mass of the tool of at least {mass:.3g} kg ({steps} steps of Euler a"
                    f" tick; {one:.3g} kg at one step a tick)"
                ) in told
    wall = convert({**given, "plant": {"mass": 0.15}}, CouplingParameters, "coupling")
    assert judgement.of_moving_world(wall, 0.0) == []


def test_a_constraint_is_passive_within_its_step_or_it_is_not() -> None:
    """By the real part of its impedance over all frequencies, from MuJoCo's equation."""
    rng, theta = np.random.default_rng(1), np.linspace(1e-4, np.pi, 4001)
    w = np.exp(-1j * theta)
    seen = set()
    for _ in range(300):
        step, most = float(10.0 ** rng.uniform(-4, -2)), float(rng.uniform(0.5, 0.99))
        stiff, loss = (
            (10.0 ** rng.uniform(-1, 1)) / step**2,
            (10.0 ** rng.uniform(-2, 0.5)) / step,
        )
        ref = np.array([[-stiff * most**2, -loss * most]])
        # force = (−b v − k r − (v⁺ − v)/h)/R on v⁺, r = h Σ v.
        real = ((1.0 - w) / step + loss * w + stiff * step * w / (1.0 - w)).real
        if abs(real.min()) > 1e-3 * loss:
            passive = bool(
                passive_within(ref, np.array([[0.1, most, 0.0, 0.0, 0.0]]), step)[0]
            )
            assert passive is bool(real.min() > 0.0)
            seen.add(passive)
    assert seen == {True, False}
    # A time constant and a damping ratio are the same in other words; too short a one is raised.
    usual, imp = (
        np.array([[0.02, 1.0], [1e-9, 1.0], [0.02, 1e-3]]),
        np.full((3, 5), 0.95),
    )
    assert passive_within(usual, imp, 0.002).tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("option", "more", "step"),
    [
        ('timestep="0.001"', "", 0.001),
        ('timestep="0.001" integrator="implicit"', "", 0.001),
        ('timestep="0.001" integrator="RK4"', "", None),
        ('timestep="0.001"', '<joint type="hinge" stiffness="1"/>', None),
        ('timestep="0.001"', '<joint type="hinge" damping="1"/>', 0.001),
        ('timestep="0.001"', "<freejoint/>", 0.001),
    ],
)
def test_a_scene_tells_whether_all_behind_its_tool_is_solved_within_a_step(
    option: str, more: str, step: float | None, tmp_path: Path
) -> None:
    tool = f'<body name="tool">{SLIDES}<geom size="0.005" mass="0.05"/></body>'
    bodies = f'{tool}<body pos="1 0 0">{more}<geom size="0.1"/></body>'
    path = scene(tmp_path, bodies, option)
    parameters = convert({"scene": str(path)}, MujocoParameters, "environment")
    world = MovingScene(path, "tool", T, "environment")
    assert world.euler_step == step
    assert ("no law is provably stable" in response_text(world.response(), step)) is (
        step is None
    )
    facts = MujocoEnvironment.plant(
        {"scene": str(path)}, "environment", ("x", "y", "z")
    )
    assert facts.get("tool_step") == step
    assert parameters.tool == "tool"
    # An undamped contact gives out energy in steps.
    path.write_text(
        path.read_text().replace('size="0.1"', 'size="0.1" solref="-3000 0"')
    )
    assert MovingScene(path, "tool", T, "environment").euler_step is None


def tied_scene(folder: Path, rng: np.random.Generator, mass: float, steps: int) -> Path:
    """Write a tool tied to one or two bodies and to the ground by MuJoCo's equalities."""
    names = ["t", *(f"b{i}" for i in range(rng.integers(1, 3)))]
    slides = SLIDES.replace('axis="1 0 0"', 'axis="1 0 0" name="t"')
    quiet = 'contype="0" conaffinity="0"'
    bodies = (
        f'<body name="tool">{slides}<geom size="0.005" mass="{mass}" {quiet}/></body>'
    )
    for name in names[1:]:
        joint = f'<joint type="slide" axis="1 0 0" name="{name}"/>'
        weight = 10.0 ** rng.uniform(-4, 0)
        bodies += f'<body>{joint}<geom size="0.001" mass="{weight}" {quiet}/></body>'
    ties = ""
    for i, name in enumerate(names):
        if rng.random() < 0.7:
            other = f'joint2="{names[i + 1]}"' if i + 1 < len(names) else ""
            ratio, time = rng.uniform(0.3, 2.0), 10.0 ** rng.uniform(-2.5, -0.5)
            most = rng.uniform(0.5, 0.98)
            ties += (
                f'<joint joint1="{name}" {other} solref="{time} {ratio}"'
                f' solimp="{most} {most} 0.001"/>'
            )
    option = f'timestep="{T / steps}" integrator="implicitfast" gravity="0 0 0"'
    path = scene(folder, bodies, option)
    path.write_text(
        path.read_text().replace("</mujoco>", f"<equality>{ties}</equality></mujoco>")
    )
    return path


def swinging(folder: Path, count: int, factors: tuple[float, ...]) -> list[int]:
    """Count the tied scenes that swing behind a tool of these factors of the needed mass."""
    rng, found = np.random.default_rng(3), [0] * len(factors)
    for i in range(count):
        plant, steps = Plant(T, 0.1, 1.0, float(i % 2)), (1, 4)[(i // 2) % 2]
        law = CompiledLaw((200.0 + 0.3 / T, -0.3 / T))
        mass = needed_tool_mass(law, plant, False, steps, plant.delay)
        assert mass is not None
        for n, factor in enumerate(factors):
            path = tied_scene(folder, rng, factor * mass, steps)
            while MovingScene(path, "tool", T, "environment").euler_step is None:
                path = tied_scene(folder, rng, factor * mass, steps)
            # long enough for what dies slowly, as a light body far away from the tool does
            found[n] += growth(path, 0.0, law, plant, 4800) > 1.0 + 1e-6
    return found


def test_what_is_tied_to_a_heavy_tool_does_not_swing(tmp_path: Path) -> None:
    below, light = swinging(tmp_path, 6, (1.02, 0.2))
    assert below == 0
    assert light >= 1


@pytest.mark.slow
def test_two_hundred_rests_tied_to_a_heavy_tool(tmp_path: Path) -> None:
    below, light = swinging(tmp_path, 200, (1.02, 0.2))
    assert below == 0
    assert light >= 100


ARM = """<body name="ball" pos="0 0 1"><freejoint/><geom size="0.01"/></body>
<body name="arm" pos="0 0.2 0"><joint name="hinge" axis="0 1 0" damping="0.01"/>
<geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.01"/></body>"""
KEYS = """<actuator><motor name="motor" joint="hinge" ctrlrange="-1 1"/></actuator><keyframe>
<key name="home" qpos="0 0.5 0.3 1 0 0 0 0.3" ctrl="0.2"/></keyframe>"""


def arm(folder: Path, keyframe: str | int | None, held: bool = False) -> MovingScene:
    path = scene(folder, ARM)
    path.write_text(
        path.read_text().replace("</mujoco>", f"{KEYS}</mujoco>"), encoding="ascii"
    )
    tool = ToolParameters(mass=0.05)
    return MovingScene(path, tool, T, "environment", held, keyframe=keyframe)


def test_a_scene_begins_at_its_keyframe_and_is_reset_to_it(tmp_path: Path) -> None:
    for name, height, angle, control in (
        ("home", 0.3, 0.3, 0.2),
        (0, 0.3, 0.3, 0.2),
        (None, 1, 0, 0),
    ):
        found = arm(tmp_path, name)
        qpos = found.data.qpos
        assert (qpos[2], qpos[7], found.data.ctrl[0]) == (height, angle, control)
        for tick in range(5):
            found.follow(
                tick, (0.1, 0.0, 0.0), (0.0, 0.0, 0.0), tick - 1, 1.0, tick == 0
            )
        assert found.data.qpos[2] != height
        found.reset_due = True
        why = found.follow(5, (0.1, 0.0, 0.2), (0.0, 0.0, 0.0), 4, 1.0, False)
        assert "reset on request" in why
        assert (found.data.qpos[2], found.data.qpos[7]) == (height, angle)
        # The tool is at the device, at rest.
        assert found.tool_position == pytest.approx((0.1, 0.0, 0.2), abs=1e-15)
        assert not found.data.qvel.any()
    # Held bodies stand where the keyframe has them.
    still = arm(tmp_path, "home", held=True)
    assert still.model.nq == 3
    assert still.data.body("ball").xpos == pytest.approx([0.0, 0.5, 0.3], abs=1e-15)
    tip = [0.1 * np.cos(0.3), 0.2, -0.1 * np.sin(0.3)]
    assert still.data.body("arm").xipos == pytest.approx(tip, abs=1e-12)
    # Without one where the file has them; its keyframes are of more joints than are left.
    still = arm(tmp_path, None, held=True)
    assert still.data.body("ball").xpos.tolist() == [0.0, 0.0, 1.0]
    with pytest.raises(
        ParameterError, match=r"environment.keyframe: no keyframe 'hime'; .*home"
    ):
        arm(tmp_path, "hime")


def test_controls_move_an_actuator_and_expire(tmp_path: Path) -> None:
    found = arm(tmp_path, "home")
    still = (0.0, 0.0, 0.0)
    found.follow(0, still, still, -1, 1.0, True)
    found.control(controls_of(found.model, {"motor": -0.5}, "environment"), until=3)
    read = []
    for tick in range(1, 7):
        found.follow(tick, still, still, tick - 1, 1.0, False)
        read.append(float(found.data.ctrl[0]))
    assert read == [-0.5] * 3 + [0.2] * 3
    for given, why in (
        ({"moto": 1.0}, "no actuator 'moto'"),
        ([1.0, 2.0], "expected a mapping"),
        ({"motor": math.nan}, "environment.controls.motor: nan"),
        ({"motor": True}, "is no number"),
    ):
        with pytest.raises(ParameterError, match=why):
            controls_of(found.model, given, "environment")


def test_every_divergence_is_found(tmp_path: Path) -> None:
    """MuJoCo clears its counts of warnings whenever it resets a scene."""
    found = arm(tmp_path, "home")
    still = (0.0, 0.0, 0.0)
    for tick in range(6):
        if tick in (2, 4):
            found.data.qvel[6] = 1e11
        why = found.follow(tick, still, still, tick - 1, 1.0, tick == 0)
        assert ("diverged" in why) == (tick in (2, 4))
        if tick in (2, 4):
            assert found.data.qpos[7] == 0.3  # at the keyframe again


@pytest.mark.parametrize(
    "text",
    [
        "<default><joint limited='true' damping='7' stiffness='50' armature='0.3'/></default>",
        "<default><joint frictionloss='2' actuatorfrclimited='true'"
        " actuatorfrcrange='-1 1' springdamper='0.1 1'/></default>",
        "<default><geom mass='0'/></default>",
        "<default><geom density='0'/></default>",
        "<compiler inertiafromgeom='false'/>",
        # MuJoCo 4 calls this one deprecated.
        pytest.param(
            "<compiler settotalmass='14'/>",
            marks=pytest.mark.filterwarnings("ignore:compiler attribute"),
        ),
    ],
)
def test_an_added_tool_is_free_of_the_defaults_of_the_scene(
    tmp_path: Path, text: str
) -> None:
    """As scenes of other people have them: before, refused, or with another mass and damping."""
    path = tmp_path / "scene.xml"
    inertial = "<inertial mass='3' pos='0 0 0' diaginertia='1 1 1'/>"
    path.write_text(
        f"<mujoco>{text}<option timestep='0.001' integrator='implicitfast'/><worldbody>"
        f"<body name='arm' pos='5 0 0'>{inertial}<joint type='slide' range='0 1'/>"
        "<geom size='0.1' mass='3'/></body></worldbody></mujoco>",
        encoding="ascii",
    )
    tool = ToolParameters(mass=0.05, radius=0.006, damping=3.0)
    model = load_world(MujocoParameters(scene=str(path), tool=tool), T, "world").model
    body = model.body("tool")
    assert body.mass[0] == pytest.approx(0.05, rel=1e-12)
    # 2/5 m r² of a ball; the arm has the mass that its scene gives it.
    assert body.inertia == pytest.approx([0.4 * 0.05 * 0.006**2] * 3, rel=1e-12)
    asked = 14.0 if "settotalmass" in text else 3.0
    assert model.body("arm").mass[0] == pytest.approx(asked, rel=1e-12)
    joints = slice(int(body.jntadr[0]), int(body.jntadr[0]) + 3)
    dofs = slice(int(body.dofadr[0]), int(body.dofadr[0]) + 3)
    assert not model.jnt_limited[joints].any()
    assert not np.any(model.jnt_stiffness[joints])
    assert not model.dof_armature[dofs].any()
    assert not model.dof_frictionloss[dofs].any()
    assert np.ravel(model.dof_damping[dofs])[0] == 3.0
