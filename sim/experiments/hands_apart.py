"""Two devices coupled over a network: stability for any hands, rendering, and guards.

Each side has a device, a law on its own position and on the delayed position of the other side, and
optionally a passivity guard (nodes/driver/passivity.py) whose credit travels: energy that one side
absorbed beyond what its law can store is sent to the other side, which may release it (energy
tanks: Franken et al. 2011; observers at both ends: Ryu, Artigas & Preusche 2010). Cumulative sums
are sent, so delay and loss only delay energy and never generate any.

This is no scene of the player, which plays one launch, whose nodes share a tick: two launches over
a network share none, and their messages are late, swapped and lost. The guard's rules are the
driver's own (`nodes.driver.passivity`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.driver.passivity import control, observe
from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant, held_step
from sim.measure.cancelling import check

FELT_AT = 1.0  # frequency at which stiffness and drag are measured [Hz]


@dataclass(frozen=True)
class EndGuard:
    """Passivity guard at one end.

    Attributes
    ----------
    stiffness : float
        Stiffness of the law's spring [N/m]: limits the energy that is stored.
    damping : float
        Largest damper that recovers excess energy [N s/m].
    """

    stiffness: float
    damping: float


@dataclass(frozen=True)
class Network:
    """Delay, jitter and loss of the network.

    Attributes
    ----------
    there, back : int
        Delay from the first side to the second, and back [ticks].
    jitter : int
        Largest additional delay of a message, uniformly distributed [ticks].
    loss : float
        Fraction of messages lost [1].
    seed : int
        Seed of jitter and loss.
    """

    there: int
    back: int
    jitter: int = 0
    loss: float = 0.0
    seed: int = 1


@dataclass(frozen=True)
class HandsRun:
    """Recorded motion of both sides, one row per tick.

    Attributes
    ----------
    position, force : ndarray, shape (ticks, 2)
        Positions of both devices [m]; forces of the laws on them [N].
    given_out_j : ndarray, shape (ticks,)
        Energy released by laws and network to both hands [J]; positive: energy was
        generated.
    """

    position: NDArray[np.float64]
    force: NDArray[np.float64]
    given_out_j: NDArray[np.float64]


class _Side:
    """A device, its law and its energy account."""

    def __init__(self, plant: Plant, law: CompiledLaw, guard: EndGuard | None) -> None:
        whole, self._motion, self._push, late = held_step(plant)
        if whole or any(late):
            raise ValueError(
                f"delay = {plant.delay:g}: a side's own delay must be 0 here; the network's is in"
                " `Network`"
            )
        self._taps = law.taps
        self._guard = guard
        self._rate = guard.damping / plant.period if guard else 0.0
        self.x = self.v = self.force = 0.0
        self._own: list[float] = [0.0] * len(law.taps)
        self._other: list[float] = [0.0] * len(law.taps)
        self._step = self.energy = self.sent = self._received = 0.0

    def choose(self, other: float, credit: float) -> float:
        """Return the force of this tick [N].

        `other` is the partner's position [m], `credit` the energy that it has sent so far
        [J].
        """
        self._own = [self.x, *self._own[:-1]]
        self._other = [other, *self._other[:-1]]
        force = sum(
            h * (b - a)
            for h, a, b in zip(self._taps, self._own, self._other, strict=True)
        )
        if self._guard is not None:
            force = self._guarded(self._guard, force, credit)
        self.force = force
        return force

    def _guarded(self, guard: EndGuard, force: float, credit: float) -> float:
        self.energy -= credit - self._received
        self._received = credit
        kept = -force * force / (2.0 * guard.stiffness)
        if self.energy < kept:
            self.sent += kept - self.energy
            self.energy = kept
        return control(self.energy, force, self._step, self._rate)

    def move(self, outside: float) -> None:
        """Advance one tick under the law's force and the hand's [N]."""
        (a11, a12, a21, a22), (g1, g2) = self._motion, self._push
        push = self.force + outside
        before = self.x
        self.x, self.v = (
            a11 * self.x + a12 * self.v + g1 * push,
            a21 * self.x + a22 * self.v + g2 * push,
        )
        self._step = self.x - before
        self.energy = observe(self.energy, self.force, self._step)


Pull = Callable[[int], float]  # force of a hand beyond its resting spring, by tick [N]


def play(
    plants: tuple[Plant, Plant],
    laws: tuple[CompiledLaw, CompiledLaw],
    network: Network,
    pull: tuple[Pull, Pull],
    ticks: int,
    guard: EndGuard | None = None,
) -> HandsRun:
    """Play both sides of a coupled pair.

    Parameters
    ----------
    plants : tuple of Plant
        Both devices, each with its hand's mass, damping and spring.
    laws : tuple of CompiledLaw
        Law of each side.
    network : Network
        Delays between the sides.
    pull : tuple of callable
        Force of each hand by tick [N].
    ticks : int
        Length [ticks].
    guard : EndGuard, optional
        Guard at both ends.

    Returns
    -------
    HandsRun
        Positions, forces and energy.
    """
    random = np.random.default_rng(network.seed)
    sides = [_Side(plant, law, guard) for plant, law in zip(plants, laws, strict=True)]
    # By receiving side: messages in flight, newest last, with their arrival tick.
    under_way: list[list[tuple[int, int, float, float]]] = [[], []]
    heard: list[tuple[int, float, float]] = [(-1, 0.0, 0.0)] * 2
    delays = (network.back, network.there)
    rows = np.empty((ticks, 4))
    energy = np.empty(ticks)
    total = 0.0
    for k in range(ticks):
        for listener in (0, 1):
            speaker = sides[1 - listener]
            late = delays[listener] + (
                int(random.integers(network.jitter + 1)) if network.jitter else 0
            )
            if network.loss <= 0.0 or random.random() >= network.loss:
                under_way[listener].append((k + late, k, speaker.x, speaker.sent))
            arrived = [one for one in under_way[listener] if one[0] <= k]
            under_way[listener] = [one for one in under_way[listener] if one[0] > k]
            for _, sent_at, x, credit in arrived:
                if sent_at > heard[listener][0]:
                    heard[listener] = (sent_at, x, credit)
        for side, (_, x, credit) in zip(sides, heard, strict=True):
            side.choose(x, credit)
        rows[k] = (sides[0].x, sides[1].x, sides[0].force, sides[1].force)
        before = [side.x for side in sides]
        for side, outside in zip(sides, pull, strict=True):
            side.move(outside(k))
        total += sum(
            side.force * (side.x - x) for side, x in zip(sides, before, strict=True)
        )
        energy[k] = total
    return HandsRun(rows[:, :2], rows[:, 2:], energy)


@dataclass(frozen=True)
class FeltPartner:
    """What the first hand feels of the second at 1 Hz.

    Attributes
    ----------
    stiffness_n_per_m : float
        Stiffness with a fixed partner: force in phase with the first hand's motion [N/m].
    drag_n_s_per_m : float
        Drag with a released partner: force in phase with the speed, minus what the device
        itself needs [N s/m].
    made_j : float
        Largest energy that laws and network released beyond the energy put in [J].
    """

    stiffness_n_per_m: float
    drag_n_s_per_m: float
    made_j: float


def felt(
    plant: Plant,
    law: CompiledLaw,
    network: Network,
    guard: EndGuard | None = None,
    seconds: float = 4.0,
) -> FeltPartner:
    """Measure felt stiffness and drag: hand 1 moves by 10 mm, partner fixed or released.

    Parameters
    ----------
    plant : Plant
        Either device, without a hand.
    law : CompiledLaw
        Law of each side.
    network : Network
        Network between them.
    guard : EndGuard, optional
        Guard at both ends.
    seconds : float
        Length; the second half is measured [s].

    Returns
    -------
    FeltPartner
        Stiffness, drag and energy.
    """
    period = plant.period
    omega = 2.0 * math.pi * FELT_AT
    ticks = round(seconds / period)
    # A hand of 2 kN/m and 40 N s/m is nearly a motion source; an equal fist fixes the device.
    firm = Plant(period, plant.mass + 0.3, plant.damping + 40.0, 0.0, 2000.0)

    def lead(k: int) -> float:
        return 2000.0 * 0.01 * math.sin(omega * k * period)

    def rest(k: int) -> float:
        del k
        return 0.0

    found = []
    made = 0.0
    for partner in (firm, plant):
        run = play((firm, partner), (law, law), network, (lead, rest), ticks, guard)
        made = max(made, float(run.given_out_j.max()))
        half = slice(ticks // 2, None)
        turn = np.exp(-1j * omega * period * np.arange(ticks))[half]
        # Divide by the motion that remains, so that the fist's own compliance is not
        # counted.
        moved = run.position[half, 0] - (
            run.position[half, 1] if partner is firm else 0.0
        )
        found.append(-np.dot(run.force[half, 0], turn) / np.dot(moved, turn))
    held, free = found
    own = omega * plant.mass * 1j + plant.damping
    return FeltPartner(
        float(held.real), float((free / (1j * omega)).real - own.real), made
    )


@dataclass(frozen=True)
class HandsAtDelay:
    """Stable and felt stiffness of two coupled hands at one delay, per coupling method.

    Attributes
    ----------
    delay_ticks : int
        One-way delay of the network [ticks].
    one_law_n_per_m, law_each_n_per_m : float or None
        Largest spring stiffness that is passive for any two hands: one law at the first
        device; a law at each device [N/m].
    damped_n_per_m, damper_n_s_per_m : float or None
        The same for PD at each device, with the damper that allows the largest stiffness
        [N/m, N s/m].
    linear : FeltPartner or None
        Felt partner with that PD.
    guarded : FeltPartner
        Felt partner at the requested stiffness with a guard at both ends, which is safe at
        any delay.
    """

    delay_ticks: int
    one_law_n_per_m: float | None
    law_each_n_per_m: float | None
    damped_n_per_m: float | None
    damper_n_s_per_m: float | None
    linear: FeltPartner | None
    guarded: FeltPartner


def over_delay(
    plant: Plant, asked: float, gain: float, delays: list[int], dampers: int = 17
) -> list[HandsAtDelay]:
    """Compare methods of coupling two equal devices over a network, delay by delay.

    Parameters
    ----------
    plant : Plant
        Either device, without a hand.
    asked : float
        Stiffness K of the guarded law [N/m].
    gain : float
        Its damper B [N s/m].
    delays : list of int
        One-way delays [ticks].
    dampers : int
        Number of dampers tried between 0 and the device's own damping.

    Returns
    -------
    list of HandsAtDelay
        One per delay.
    """
    from nodes.laws.pd import PD
    from sim.stability.two_hands import TwoHands, k_max_two_hands

    period = plant.period
    both = (plant.damping, plant.damping)

    def pd(stiffness: float, damper: float) -> CompiledLaw:
        return PD(stiffness=stiffness, damping=damper).compile(period)

    def each(delay: int, damper: float) -> float | None:
        def at(stiffness: float) -> TwoHands:
            law = pd(stiffness, damper)
            return TwoHands.law_each((law, law), delay, delay)

        return k_max_two_hands(at, period, both)

    def one(delay: int) -> float | None:
        def at(stiffness: float) -> TwoHands:
            law = pd(stiffness, 0.0)
            return TwoHands((law, law), ((0, delay), (delay, 2 * delay)))

        return k_max_two_hands(at, period, both)

    rows = []
    for delay in delays:
        check()
        tried = [plant.damping * i / (dampers - 1) for i in range(dampers)]
        bears = [each(delay, damper) for damper in tried]
        stiffest, damper = max(
            (stiffness or 0.0, damper)
            for stiffness, damper in zip(bears, tried, strict=True)
        )
        network = Network(delay, delay)
        rows.append(
            HandsAtDelay(
                delay_ticks=delay,
                one_law_n_per_m=one(delay),
                law_each_n_per_m=bears[0],
                damped_n_per_m=stiffest or None,
                damper_n_s_per_m=damper if stiffest else None,
                linear=felt(plant, pd(stiffest, damper), network) if stiffest else None,
                guarded=felt(
                    plant, pd(asked, gain), network, EndGuard(asked, plant.damping)
                ),
            )
        )
    return rows
