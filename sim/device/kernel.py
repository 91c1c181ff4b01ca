"""The compiled virtual device: the two device calls of a compiled driver."""

from typing import Final

import nodes.compiled.kernels.hop  # noqa: F401  # what a kernel does in place of the clock
from nodes.compiled.kernels.machine import compilable, reals_at, record_at, wholes_at
from nodes.compiled.kernels.sources import record_of, register_rules
from sim.device.state import AxisState, read_axis, write_axis

register_rules()
_look = record_at(record_of(AxisState))


@compilable
def read(context: int, seq: int, out: int) -> int:
    """Read a device's position and hand target.

    `context` holds the number of axes and the address of each axis' state.
    """
    axes = wholes_at(context, 4)
    position = reals_at(out, 6)
    for i in range(6):
        position[i] = 0.0
    for n in range(axes[0]):
        d = _look(axes[1 + n])
        position[d.axis] = read_axis(d, seq)
        position[3 + d.axis] = d.pull
    return 0


@compilable
def write(context: int, force: int, seq: int, offset: float) -> int:
    """Hand over a force; return −1 if an axis has no room for it."""
    axes = wholes_at(context, 4)
    forces = reals_at(force, 3)
    status = 0
    for n in range(axes[0]):
        d = _look(axes[1 + n])
        if not write_axis(d, forces[d.axis], seq, offset):
            status = -1
    return status


# Entry points called by address, with C's calling convention.
ENTRIES: Final = {
    "read": (read, "int64(int64,int64,int64)"),
    "write": (write, "int64(int64,int64,int64,float64)"),
}
