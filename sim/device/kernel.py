"""The virtual device, compiled: the two calls that a compiled driver makes of a device (nodes/driver/device.py)."""

from typing import Final

import nodes.compiled.kernels.hop  # noqa: F401  # what a kernel does in place of the clock
from nodes.compiled.kernels.machine import compilable, reals_at, record_at, wholes_at
from nodes.compiled.kernels.sources import record_of, register_rules
from sim.device.state import AxisState, read_axis, write_axis

register_rules()
_look = record_at(record_of(AxisState))


@compilable
def read(context: int, seq: int, out: int) -> int:
    """Read the position of a device, and where its hand pulls to: `context` is how many axes it has, and where each is."""
    axes, position = wholes_at(context, 4), reals_at(out, 6)
    for i in range(6):
        position[i] = 0.0
    for n in range(axes[0]):
        d = _look(axes[1 + n])
        position[d.axis] = read_axis(d, seq)
        position[3 + d.axis] = d.pull
    return 0


@compilable
def write(context: int, force: int, seq: int, offset: float) -> int:
    """Hand a force to it."""
    axes, forces = wholes_at(context, 4), reals_at(force, 3)
    status = 0
    for n in range(axes[0]):
        d = _look(axes[1 + n])
        if not write_axis(d, forces[d.axis], seq, offset):
            status = -1
    return status


# What other code calls by its address, with C's way of calling.
ENTRIES: Final = {
    "read": (read, "int64(int64,int64,int64)"),
    "write": (write, "int64(int64,int64,int64,float64)"),
}
