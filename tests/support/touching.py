"""State, proxy and force of one tick, 1 mm deep in a wall."""

from __future__ import annotations

from messages.types import DeviceState, Force, Proxy

STATE = DeviceState(
    seq=9, stamp=0.0, position=(0.021, 0.0, 0.0), force=(-1.0, 0.0, 0.0), force_seq=8
)
PROXY = Proxy(
    seq=9,
    stamp=0.0,
    position=(0.021, 0.0, 0.0),
    proxy=(0.02, 0.0, 0.0),
    normal=(-1.0, 0.0, 0.0),
    distance=-0.001,
    contact=True,
)
FORCE = Force(seq=8, stamp=0.0, force=(-1.0, 0.0, 0.0), law="pd")
