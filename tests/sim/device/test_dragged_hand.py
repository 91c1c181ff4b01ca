"""A hand dragged by a page: limited speed, release, and bit-exact replay."""

from __future__ import annotations

import ctypes
import itertools
import math
import threading
import time
from pathlib import Path

import msgspec
import numpy as np
import pytest

from messages.topics import DEVICE_STATE
from nodes.compiled.choose_tick import WantedTick, choose
from nodes.driver.pointer import (
    PointerParameters,
    PointerReader,
    PointerWriter,
    pointer_file,
)
from nodes.parameters.store import ParameterError
from nodes.recording.reader import Recording
from sim.cli.bench.loop import KERNELS
from sim.device.driver import SimDevice, SimDriver
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.device.state import PENDING, VirtualDevice, target
from sim.identify.counterfactual import replay
from sim.identify.recorded_scene import rebuild
from tests.support import slowly
from tests.support.launching import running, wait_for
from tests.support.setups import setup_of

SETUP = setup_of(axes=["x"], pace="realtime")
KEPT: list[SimDevice] = []
"""References that keep the buffers of test states alive."""


def dragged(hand: Hand, tmp_path: Path, parameters: PointerParameters) -> VirtualDevice:
    """Return a device whose hand a page may drag."""
    setup = msgspec.structs.replace(SETUP, run_dir=str(tmp_path))
    device = SimDevice(DeviceModel(mass=0.1, hand=hand), setup, pointer=parameters)
    KEPT.append(device)
    return device.parts[0]


def test_the_target_moves_no_faster_than_it_may_and_comes_back(tmp_path: Path) -> None:
    hand = Hand(stiffness=100.0, path=[(0.0, 0.001), (0.02, 0.002)])
    d = dragged(hand, tmp_path, PointerParameters(speed=0.5, silence=60.0)).state
    # Nobody at the mouse: exactly the path.
    assert [target(d, seq) for seq in (0, 5, 10)] == [0.001, 0.0015, 0.002]
    writer = PointerWriter(pointer_file(tmp_path, "driver"))
    writer.write((0.0051, 9.0, 9.0))
    # 0.5 m/s is 1 mm a tick.
    assert np.allclose(
        [target(d, seq) for seq in range(11, 16)],
        [0.003, 0.004, 0.005, 0.0051, 0.0051],
        atol=1e-15,
    )
    writer.let_go()
    assert np.allclose(
        [target(d, seq) for seq in range(16, 20)],
        [0.0041, 0.0031, 0.0021, 0.002],
        atol=1e-15,
    )
    assert target(d, 20) == 0.002
    writer.close()


def test_a_hand_that_repeats_its_path_does_so_when_nobody_drags_it(
    tmp_path: Path,
) -> None:
    hand = Hand(stiffness=100.0, path=[(0.0, 0.001), (0.02, 0.002)], repeat=0.04)
    d = dragged(hand, tmp_path, PointerParameters()).state
    assert target(d, 25) == hand.point(0.05) == target(d, 5) == 0.0015


def test_a_pointer_needs_a_hand() -> None:
    setup = msgspec.structs.replace(
        SETUP, parameters={"device": {"mass": 0.1}, "pointer": {}}
    )
    with pytest.raises(
        ParameterError, match=r"driver.pointer: needs driver.device.hand"
    ):
        SimDriver.check(setup)


def test_compiled_calls_move_a_device_as_the_interpreter_does(tmp_path: Path) -> None:
    """To the bit, with encoder, friction, delay, weight, hand, and torn page values."""
    assert choose("compiled", [SimDriver.device_module], print) == "compiled"
    hand = Hand(
        stiffness=100.0,
        mass=0.02,
        damping=1.0,
        path=[(0.0, 0.001), (0.05, 0.003)],
        repeat=0.3,
    )
    model = DeviceModel(
        mass=0.1,
        damping=0.5,
        gravity=9.81,
        friction=0.05,
        resolution=1e-5,
        delay=1.3,
        peak_force=5.0,
        hand=hand,
    )
    setups = [
        msgspec.structs.replace(SETUP, run_dir=str(tmp_path), tick=tick)
        for tick in ("plain", "compiled")
    ]
    pointer = PointerParameters(speed=0.5, silence=60.0)
    plain, compiled = (SimDevice(model, setup, 0.05, pointer) for setup in setups)
    calls = compiled.calls()
    assert calls is not None
    read = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p
    )(calls.read)
    write = ctypes.CFUNCTYPE(
        ctypes.c_int, ctypes.c_int64, ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    )(calls.write)
    writer = PointerWriter(pointer_file(tmp_path, "driver"))
    chance = np.random.default_rng(14)
    out, force = (ctypes.c_double * 6)(), (ctypes.c_double * 3)()
    away = seq = 0
    for _ in range(400):
        seq += 1 if chance.random() < 0.95 else 3
        if chance.random() < 0.2:
            if chance.random() < 0.4:
                writer.let_go()
            else:
                writer.write((chance.normal(0.0, 0.01), 9.0, 9.0))
        elif chance.random() < 0.05:
            torn = bytearray(pointer_file(tmp_path, "driver").read_bytes())
            torn[:8] = (10**6 + seq).to_bytes(8, "little")
            with open(pointer_file(tmp_path, "driver"), "r+b") as file:
                file.write(torn)
        assert read(calls.context, seq, out) == 0
        assert list(out) == [*plain.read_position(seq), *plain.target]
        for _ in range(chance.integers(0, 3)):
            force[0], offset = chance.normal(0.0, 3.0), float(chance.random())
            assert write(calls.context, force, seq, offset) == 0
            plain.write_force((force[0], 0.0, 0.0), seq, offset)
        away += plain.parts[0].state.is_away
        assert list(plain.parts[0].state.pending) == list(
            compiled.parts[0].state.pending
        )
    assert 0 < away < 400
    # More forces under way than there is room for: told by the status, not lost in silence.
    assert any(write(calls.context, force, seq, 0.5) < 0 for _ in range(PENDING + 1))
    writer.close()


@pytest.mark.process
@pytest.mark.parametrize("tick", slowly(["plain", "compiled"], but=["compiled"]))
def test_a_dragged_run_is_recorded_and_plays_again_in_one_process(
    tick: WantedTick, tmp_path: Path
) -> None:
    """In real time with next_tick, one process with the recorded targets is bit-equal."""
    assert choose(tick, KERNELS, print) == tick
    with running(
        tmp_path, "touch_wall", "apply:=next_tick", "duration:=2", "--tick", tick
    ) as launch:
        writer = PointerWriter(pointer_file(launch.run_dir, "driver"))
        ended = threading.Event()

        def drag() -> None:
            while not ended.is_set():
                writer.write(
                    (0.018 + 0.006 * math.sin(4.0 * time.monotonic()), 0.0, 0.0)
                )
                time.sleep(0.005)

        thread = threading.Thread(target=drag)
        thread.start()
        try:
            figures = launch.finish()
        finally:
            ended.set()
            thread.join()
            writer.close()
    states = Recording(tmp_path / figures["recording"]).messages(DEVICE_STATE)
    targets = [state.target[0] for state in states]
    assert max(targets) > 0.02, "the hand was dragged into the wall"
    if figures["overruns"] == 0:
        # Recorded with the state: 0.5 m/s is 1 mm a tick, to rounding.
        assert max(abs(b - a) for a, b in itertools.pairwise(targets)) <= 0.001 * (
            1.0 + 1e-9
        )
    # A dragged hand is no reason to leave the compiled tick.
    assert figures["tick"] == tick
    if tick == "compiled" and figures["missed"] == 0:
        assert figures["ticks_compiled"]["driver"] > 0.9 * figures["ticks"]
    # Up to the first tick that the driver slept through.
    recorded = rebuild(tmp_path / figures["recording"])
    same = replay(recorded)
    if figures["missed"] == 0:
        assert same.measured.tolist() == recorded.position.tolist()
    # A tick that the coupling lost is bridged there, and rendered here; one process knows nothing
    # of a coupling that was away for so long that the driver damped the device.
    if (
        figures["safety"]["entered"].get("damping", 0) == 0
        and figures["nodes"]["coupling"]["gaps"] < 20
    ):
        assert np.max(np.abs(same.measured - recorded.position)) < 1e-3


@pytest.mark.slow
def test_a_hand_whose_page_falls_silent_goes_back_to_its_path(tmp_path: Path) -> None:
    with running(tmp_path, "touch_wall", "--without", "logger") as launch:
        path = pointer_file(launch.run_dir, "driver")
        PointerReader(path, 1.0).close()
        writer = PointerWriter(path)

        def position() -> float:
            return float(launch.call("driver", "progress")["position_m"][0])

        def dragged() -> bool:
            writer.write((-0.02, 0.0, 0.0))
            return position() < -0.015

        wait_for(dragged, "the device follows the hand")
        wait_for(lambda: abs(position()) < 0.002, "the hand has let go")
        writer.close()
