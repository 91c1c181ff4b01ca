"""Interactive device check: noise, rate, axes without force, then a first force in steps.

Nothing is pushed before the axes are known to be right, because a force along a wrong axis feels
like an unstable wall. Each push ramps up and down, and ends at once if the handle moves faster than
`FASTEST`.
"""

import math
import sys
import time
from typing import Any, Final

import msgspec
import numpy as np

from messages.errors import RefusedError, UsageError
from messages.types import ZERO, Vector
from nodes.driver.hardware.mailbox import MailboxDevice
from nodes.driver.hardware.mapping import AxisName, Mapping
from sim.device_check.delay import FORCE, PULSES, MeasuredDelay, measure

REST: Final = 1.0  # duration of the measurement at rest [s]
# Distance that the handle must move, and more than twice as far as along the other axes [m].
MOVED: Final = 0.02
PUSH_TIME: Final = 0.6  # duration of a push with its ramps [s]
FASTEST: Final = 0.25  # speed of the handle at which a push ends [m/s]
STEP: Final = 0.001  # time between two force commands [s]

FRESH: Final = 5  # samples after which a position counts as new
WAYS: Final = (("forward", "away from you"), ("left", "to the left"), ("up", "upwards"))


class SamplesAtRest(msgspec.Struct, frozen=True, kw_only=True):
    """Noise, resolution and rate of a device at rest."""

    noise: Vector  # standard deviation of its position [m]
    # Smallest change of position seen [m]: the encoder's step, or finer; None without a change.
    step: float | None
    rate: float  # measured rate of its servo loop [Hz]
    asked: float  # requested rate [Hz]
    missed: int  # samples missing at the requested rate
    longest: float  # longest time without a sample [s]


class TriedForce(msgspec.Struct, frozen=True, kw_only=True):
    """Result of one upward push."""

    force: float  # magnitude [N]
    moved: float  # upward movement of the handle [m]
    felt: bool  # whether the user felt it
    why: str  # the device's reason for not rendering a force; empty if none
    ended: str  # why the push ended early; empty if it did not


def ask(question: str) -> str:
    """Ask the user on standard error; return the answer."""
    print(question, end=" ", file=sys.stderr, flush=True)
    answer = sys.stdin.readline()
    if not answer:
        raise UsageError(
            "no answer: `haptic device check` asks before each step; run it on a terminal"
        )
    return answer.strip().lower()


def at_rest(device: MailboxDevice) -> SamplesAtRest:
    """Measure noise, resolution and rate of a device that nobody moves."""
    places: list[Vector] = []
    begun = time.monotonic()
    ticks = seen = device.ticks
    last = begun
    longest = 0.0
    while (now := time.monotonic()) - begun < REST:
        if device.ticks != seen:
            longest = max(longest, now - last)
            seen = device.ticks
            last = now
            place = device.read_position(0)
            if all(map(math.isfinite, place)):
                places.append(place)
        time.sleep(0.0002)
    if len(places) < 2:
        raise RefusedError(
            f"{device.TITLE}: {len(places)} positions in {REST:g} s:"
            f" {device.condition() or 'it sends none'}"
        )
    x, y, z = np.std(places, axis=0).tolist()
    changes = np.abs(np.diff(places, axis=0))
    return SamplesAtRest(
        noise=(x, y, z),
        step=min(changes[changes > 1e-12].tolist(), default=None),
        rate=(seen - ticks) / (last - begun) if last > begun else 0.0,
        asked=device.servo_rate,
        missed=max(0, round((last - begun) * device.servo_rate) - (seen - ticks)),
        longest=longest,
    )


def place_of(device: MailboxDevice) -> Vector:
    """Return a valid position [m] sampled after the call."""
    until = time.monotonic() + 2.0
    ticks = device.ticks
    while time.monotonic() < until:
        place = device.read_position(0)
        if device.ticks > ticks + FRESH and all(map(math.isfinite, place)):
            return place
        time.sleep(STEP)
    raise RefusedError(
        f"{device.TITLE}: no position: {device.condition() or 'check cable and power'}"
    )


def axes(device: MailboxDevice) -> tuple[bool, list[str]]:
    """Ask the user to move the handle along each axis, without force.

    Return whether all axes are right, and the correct axes for ``mapping.axes``.
    """
    found: list[str] = []
    right = True
    for number, (way, where) in enumerate(WAYS):
        ask(f"Hold the handle still, then press Enter to begin with {way}:")
        before = place_of(device)
        ask(f"Move it about 5 cm {where}, hold it there, and press Enter:")
        moved = [b - a for a, b in zip(before, place_of(device), strict=True)]
        largest = max(range(3), key=lambda i: abs(moved[i]))
        others = max(abs(moved[i]) for i in range(3) if i != largest)
        if abs(moved[largest]) < MOVED or abs(moved[largest]) < 2.0 * others:
            text = ", ".join(f"{1e3 * x:+.0f}" for x in moved)
            raise RefusedError(
                f"{way}: the position changed by {text} mm; expected at least {1e3 * MOVED:.0f} mm"
                " along one axis and less than half of it along the others: try again, or set"
                " mapping.rotation for a rotated mount"
            )
        found.append(_theirs(device, largest, moved[largest]))
        right = right and largest == number and moved[largest] >= 0.0
    return right, found


def _theirs(device: MailboxDevice, axis: int, sign: float) -> str:
    """Return the device's own axis that corresponds to an axis of the scene."""
    row = device.turn[axis]
    largest = max(range(3), key=lambda j: abs(row[j]))
    return f"{'+' if row[largest] * sign > 0.0 else '-'}{'xyz'[largest]}"


def push(device: MailboxDevice, force: float) -> TriedForce:
    """Push upwards with a ramp up and down; return the result."""
    before = place_of(device)
    last: Vector | None = None
    at: float | None = None
    begun = time.monotonic()
    ended, why = "", ""
    try:
        while (since := time.monotonic() - begun) < PUSH_TIME:
            share = min(since, PUSH_TIME - since) / (PUSH_TIME / 3.0)
            device.write_force((0.0, 0.0, force * min(max(share, 0.0), 1.0)), 0, 0.0)
            time.sleep(STEP)
            place = device.read_position(0)
            now = time.monotonic()
            if not all(map(math.isfinite, place)):
                # Without a position no force, and no speed until the position is known again.
                device.write_force(ZERO, 0, 0.0)
                last = at = None
                continue
            if last is None or at is None:
                last, at = place, now
            # Over 20 ms, an encoder step does not look like a speed.
            if now - at >= 0.02:
                speed = math.dist(place, last) / (now - at)
                last, at = place, now
                if speed > FASTEST:
                    ended = (
                        f"the handle moved at {speed:.2f} m/s, limit {FASTEST:g} m/s"
                    )
                    break
            why = why or device.condition()
    finally:
        device.write_force(ZERO, 0, 0.0)
    moved = place_of(device)[2] - before[2]
    felt = ask(f"Did it push upwards with {force:g} N? [y/n]").startswith("y")
    return TriedForce(force=force, moved=moved, felt=felt, why=why, ended=ended)


def check(device: MailboxDevice, kind: str) -> dict[str, Any]:
    """Run the whole check; refuse what is wrong; always close the device."""
    try:
        device.connect()
        device.open()
        for name, value in device.facts.items():
            print(f"  {name}: {value}", file=sys.stderr)
        ask(
            "No force yet. Put the handle down so that nothing moves it, and press Enter:"
        )
        rest = at_rest(device)
        step = "none was seen" if rest.step is None else f"{1e6 * rest.step:.3g} µm"
        noise = "/".join(f"{1e6 * value:.3g}" for value in rest.noise)
        print(
            f"  noise {noise} µm, step {step}, {rest.rate:.0f} samples/s of {rest.asked:.0f}"
            f" requested, {rest.missed} missed in {REST:g} s,"
            f" longest gap {1e3 * rest.longest:.3g} ms",
            file=sys.stderr,
        )
        right, found = axes(device)
        if not right:
            written = ", ".join(f'"{name}"' for name in found)
            try:
                Mapping(
                    axes=msgspec.convert(found, tuple[AxisName, AxisName, AxisName])
                )
            except ValueError as error:
                raise RefusedError(
                    f"the handle's movements give {error}; nothing was pushed. Check again: forward"
                    " is away from you, left is your left"
                ) from error
            raise RefusedError(
                "the axes differ from the driver's mapping; nothing was pushed. Set mapping:"
                f" {{axes: [{written}]}} and check again"
            )
        pushes = _pushes(device)
        passed = all(one.felt and not one.ended for one in pushes)
        measured = _delay(device) if len(pushes) > 1 and passed else None
    except OSError as error:
        raise RefusedError(str(error)) from error
    finally:
        device.close()
    felt = (
        ", ".join(
            f"{one.force:g} N {'felt' if one.felt else 'NOT felt'}" for one in pushes
        )
        or "no force tried"
    )
    facts = ", ".join(
        str(device.facts[name])
        for name in ("model", "serial")
        if device.facts.get(name)
    )
    line = (
        f"haptic device check {kind}: {facts}; axes {' '.join(found)} right; noise {noise} µm, step"
        f" {step}; {rest.rate:.0f} samples/s of {rest.asked:.0f}, {rest.missed} missed, longest gap"
        f" {1e3 * rest.longest:.3g} ms; upwards: {felt}; {delay_in_words(measured)}"
    )
    told = {"rest": rest, "pushes": pushes, "delay": measured}
    found_out = {"axes_right": right, "axes": found, **msgspec.to_builtins(told)}
    return {
        "kind": kind,
        "facts": device.facts,
        **found_out,
        "line": line,
        "passed": passed,
    }


def _pushes(device: MailboxDevice) -> list[TriedForce]:
    """Push with 0.1 N, 1 N and the device's limit, asking first; stop if not felt."""
    pushes: list[TriedForce] = []
    for force in (0.1, 1.0, device.limits.peak_force):
        largest = (
            " (the largest that the device allows)"
            if force == device.limits.peak_force
            else ""
        )
        if not ask(
            f"Hold the handle loosely. Push upwards with {force:g} N{largest}? [y/n]"
        ).startswith("y"):
            break
        one = push(device, force)
        pushes.append(one)
        if one.ended:
            print(f"  let go: {one.ended}", file=sys.stderr)
        if not one.felt:
            print(f"  {one.why or no_force(device, one)}", file=sys.stderr)
        if one.ended or not one.felt:
            break
    return pushes


def _delay(device: MailboxDevice) -> MeasuredDelay | None:
    """Measure the delay from force to effect, if the user allows it."""
    question = (
        f"Hold the handle loosely. Push up and down {PULSES} times with"
        f" {min(FORCE, device.limits.peak_force):g} N"
    )
    if not ask(f"{question}, 60 ms each, to measure the delay? [y/n]").startswith("y"):
        return None
    measured = measure(device)
    print(f"  {delay_in_words(measured)}", file=sys.stderr)
    if measured.delay is not None:
        ticks = measured.delay * 500.0
        print(
            f"  for a launch file at 500 Hz: plant: {{device_delay: {ticks:.2g}}}",
            file=sys.stderr,
        )
    return measured


def delay_in_words(measured: MeasuredDelay | None) -> str:
    """Return a delay as text."""
    if measured is None:
        return "delay not measured"
    if measured.delay is None:
        return f"delay not measured: {measured.why}"
    return (
        f"force to effect {1e3 * measured.delay:.1f} ± {1e3 * measured.uncertainty:.1f} ms (95 %,"
        f" {measured.pulses} pulses)"
    )


def no_force(device: MailboxDevice, one: TriedForce) -> str:
    """Return possible reasons why no force is felt, if the device reports none."""
    if one.moved > 0.001:
        return (
            f"the handle moved up by {1e3 * one.moved:.1f} mm: the force acts, but is small for"
            " your hand"
        )
    if device.let_go:
        return (
            f"the servo loop released the force {device.let_go} times because none came in time:"
            " the machine is busy"
        )
    return (
        "the device reports no reason: is a switch on its housing off, or an emergency stop"
        " pressed?"
    )
