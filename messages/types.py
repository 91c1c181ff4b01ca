"""The messages of the loop, as typed maps with named SI fields.

Every message carries ``seq``, the tick it belongs to (the driver counts the ticks, everyone else
answers a tick), and ``stamp`` in seconds: the monotonic clock of the host in real time, simulated
time (``seq``·T) in lockstep. Vectors are three floats: +x forward (away from the user), +y left, +z
up, as in ROS (REP 103).

Evolution: a field keeps its name, type and unit for ever; new fields come last and have a default,
so old recordings and old listeners go on working.
"""

import sys
from typing import Annotated, TypeAlias

import msgspec

__all__ = [
    "MAX_COUNT",
    "ZERO",
    "Count",
    "DeviceState",
    "Event",
    "Force",
    "Handle",
    "Message",
    "Name",
    "NodeStatus",
    "Proxy",
    "Real",
    "Receipt",
    "Text",
    "Vector",
]

Real: TypeAlias = Annotated[float, msgspec.Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
"""A finite number. MessagePack carries NaN and infinity too, which a haptic device must never see: no bound holds for them."""

Vector: TypeAlias = tuple[Real, Real, Real]
MAX_COUNT = 2**53 - 1
"""Largest counter: exact as a double, so exact in JSON and in any language."""

Count: TypeAlias = Annotated[int, msgspec.Meta(ge=0, le=MAX_COUNT)]
Text: TypeAlias = Annotated[str, msgspec.Meta(max_length=4096)]
Name: TypeAlias = Annotated[str, msgspec.Meta(max_length=128)]

ZERO: Vector = (0.0, 0.0, 0.0)


class Message(msgspec.Struct, frozen=True, kw_only=True, gc=False):
    """What every message has: the tick it belongs to and when its content was true.

    Attributes
    ----------
    seq : int
        Tick number, counted by the driver from 0.
    stamp : float
        Time of the content [s]: host's monotonic clock in real time, seq·T in lockstep.
    """

    seq: Count
    stamp: Real


class DeviceState(Message, frozen=True, kw_only=True, gc=False):
    """``/device/state``: the position sampled at a tick, and how the tick before it went.

    Attributes
    ----------
    position : tuple of float, shape (3,)
        Position of the device's end point at the tick, as its encoders give it [m].
    force : tuple of float, shape (3,)
        Force handed to the device when the previous tick closed, after all limits [N].
    mean_force : tuple of float, shape (3,)
        Mean of the forces that were on the device since the position before this one, where they
        changed within a tick too [N].
    changed_at : float
        Part of the previous tick after which its first new force was handed over: less than `delay`
        where an earlier tick's answer came in it; 1 where none was [ticks].
    force_seq : int
        Tick that this force answers; -1 before the first one.
    age : int
        Ticks between the previous tick and the one its force answered: 0 when it was answered in
        time.
    response : float
        Time from publishing the previous tick's state to receiving its answer [s]; 0 when it was
        not answered in time.
    lateness : float
        How long after its deadline this tick was sampled [s]; 0 in lockstep.
    missed : int
        Ticks so far whose answer had not come when the next tick was due.
    overruns : int
        Ticks so far that had to be left out because the driver itself was late by a whole period or
        more.
    safety : str
        ``waiting``, ``ramp``, ``active``, ``damping``, ``zero``, ``fault`` or ``stopped``: what the
        driver does with forces now.
    energy : float
        Energy given out by the virtual side up to this tick [J]: exact where forces change at
        ticks; one that changes within a tick counts as if the device moved evenly in it.
    delay : float
        Measured delay of the previous tick, from its sample to the force that answered it taking
        effect [ticks].
    guard : float
        Energy that the passivity guard counts as given out: what is negative is in store and may be
        given back, what is positive is owed [J]; 0 without a guard.
    target : tuple of float, shape (3,)
        Where a hand pulls the device to during the tick that begins here [m]; zero without a
        simulated hand.
    rebased : int
        Tick of the latest jump of `position` that no motion made (re-centred, another scale, a
        partner met anew); 0 for none.
    surplus : float
        Energy that was put into this device so far and that its law cannot give back, as the
        passivity guard counts it [J]: a partner's device may give out as much. 0 without a guard.
    """

    position: Vector
    force: Vector = ZERO
    mean_force: Vector = ZERO
    changed_at: Real = 0.0
    force_seq: Annotated[int, msgspec.Meta(ge=-1, le=MAX_COUNT)] = -1
    age: Count = 0
    response: Real = 0.0
    lateness: Real = 0.0
    missed: Count = 0
    overruns: Count = 0
    safety: Name = "active"
    energy: Real = 0.0
    delay: Real = 0.0
    guard: Real = 0.0
    target: Vector = ZERO
    rebased: Count = 0
    surplus: Real = 0.0


class Handle(Message, frozen=True, kw_only=True, gc=False):
    """``/device/handle``: what a device gives beside its position, when it changes and once a second.

    Attributes
    ----------
    orientation : tuple of float, shape (4,)
        Of the handle in the scene's axes, a quaternion x, y, z, w; (0, 0, 0, 1) for a device
        without one.
    gripper : float
        How far the gripper is open [m]; 0 without one.
    buttons : int
        One bit each, the first one lowest.
    velocity : tuple of float, shape (3,)
        As the vendor's library computes it, in the scene's axes [m/s]; for comparison only.
    """

    orientation: tuple[Real, Real, Real, Real] = (0.0, 0.0, 0.0, 1.0)
    gripper: Real = 0.0
    buttons: Count = 0
    velocity: Vector = ZERO


class Proxy(Message, frozen=True, kw_only=True, gc=False):
    """``/environment/proxy``: where the device would be if the wall were solid.

    Attributes
    ----------
    position : tuple of float, shape (3,)
        The device position of the same tick, forwarded so that the coupling needs one input only
        [m].
    proxy : tuple of float, shape (3,)
        The point on the surface while in contact, the device position in free space [m].
    normal : tuple of float, shape (3,)
        Outward normal of the surface that matters now; zero when the scene has no one-sided
        surface.
    distance : float
        Signed distance to that surface along its normal, negative inside [m].
    contact : bool
        Whether the surface is touched at this tick.
    delay : float
        The loop's measured delay, forwarded from the device state [ticks].
    rebased : int
        Tick of the latest jump of position, surface or proxy that no motion made; 0 for none. The
        coupling eases its force over each.
    ease : int
        Length of that easing [ticks]; 0 for the coupling's own.
    credit : float
        Energy that a partner has put in for this device so far, its `surplus` [J].
    compliance : float
        How far the force of this very tick moves the proxy, against the force [m/N]: it ends at
        `proxy` − `compliance` times the force, which the coupling solves for. 0 (or less) for a
        surface, and for a body that answers a tick later.
    """

    position: Vector
    proxy: Vector
    normal: Vector = ZERO
    distance: Real = 0.0
    contact: bool = False
    delay: Real = 0.0
    rebased: Count = 0
    ease: Count = 0
    credit: Real = 0.0
    compliance: Real = 0.0


class Force(Message, frozen=True, kw_only=True, gc=False):
    """``/coupling/force``: the force the law renders for a tick.

    Attributes
    ----------
    force : tuple of float, shape (3,)
        Force on the device's end point [N].
    law : str
        Name of the law that computed it (the fallback's, after a failure).
    revision : int
        Counts the applied changes of law or parameters; the receipts tell what each one was.
    normal : tuple of float, shape (3,)
        Outward normal of the surface that is touched; zero where nothing is, or the law holds from
        all sides. The guard keeps what the law stores along it apart from what the surface rubs
        away.
    credit : float
        Energy that a partner has put in for this device so far, forwarded from the proxy [J].
    """

    force: Vector
    law: Name = ""
    revision: Count = 0
    normal: Vector = ZERO
    credit: Real = 0.0


class NodeStatus(Message, frozen=True, kw_only=True, gc=False):
    """``/<node>/status``: a node's state and its counters, every half second and at each change of state.

    Attributes
    ----------
    node, kind, state : str
        Name in the launch, kind, and ``configuring``, ``waiting``, ``ready``, ``running``,
        ``finished`` or ``failed``.
    pid : int
        Process number.
    ticks : int
        Ticks handled so far.
    sent, received, refused, skipped, gaps : int
        Messages published and taken; refused as malformed; skipped because a newer one was there;
        missing in ``seq``.
    reason : str
        Why it ended or failed; empty while it runs.
    memory : float
        Resident memory [bytes].
    cpu : float
        Processor time used so far [s].
    denied : int
        Connections that were not let in: unknown key, no key, or a peer that is not who it should
        be.
    clock_offset, clock_error : float
        What is added to this host's monotonic clock to get the run's time (that of the launcher's
        host), and how far off that may be [s]; both 0 on the launcher's host itself.
    """

    node: Name
    kind: Name
    state: Name
    pid: Count
    ticks: Count = 0
    sent: Count = 0
    received: Count = 0
    refused: Count = 0
    skipped: Count = 0
    gaps: Count = 0
    reason: Text = ""
    memory: Real = 0.0
    cpu: Real = 0.0
    denied: Count = 0
    clock_offset: Real = 0.0
    clock_error: Real = 0.0


class Receipt(Message, frozen=True, kw_only=True, gc=False):
    """``/coupling/receipt``: a change of law or parameters, applied at a tick.

    Attributes
    ----------
    action : str
        ``switch``, ``set`` or ``fallback``.
    before, after : str
        Law and its parameters as YAML flow text, before and after.
    force_step : float
        Norm of the difference between the new and the old law's force at this very tick [N].
    ramp : int
        Ticks of cross-fade, 0 for a hard swap.
    reason : str
        Who asked, or what failed.
    revision : int
        Revision that the forces carry from this tick on.
    """

    action: Name
    before: Text
    after: Text
    force_step: Real = 0.0
    ramp: Count = 0
    reason: Text = ""
    revision: Count = 0


class Event(Message, frozen=True, kw_only=True, gc=False):
    """``/<node>/event``: something that must not be overlooked (safety state, refused message, lost peer, limit reached).

    Attributes
    ----------
    node, kind : str
        Node that publishes it, and its kind: one of messages/event_kinds.py, or ``package.kind``.
    reason : str
        One sentence with value and limit, for people.
    data : dict of str to float
        Numbers of the event by name, for programs; units end the names (messages/event_kinds.py).
    """

    node: Name
    kind: Name
    reason: Text
    data: Annotated[dict[Name, Real], msgspec.Meta(max_length=64)] = {}
