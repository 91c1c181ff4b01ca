"""Judge whether everything a scene attaches to its tool is passive within one step.

Then a heavy tool is a promise of its own, without damping (`nodes.stability.worlds.EulerTool`).
Bodies, contacts, limits and equalities are solved together with the step: with the solver's force
(−b v − k r − (v⁺ − v)/h)/R on a velocity v⁺ = (r⁺ − r)/h the impedance has the real part
(1/h − (1/h − b) cos θ − k h/2)/R, which is not negative iff k h/2 ≤ b ≤ 2/h − k h/2, whatever the
masses. A spring on a joint or a tendon acts from where it was before the step: that is no such
impedance, nor is a motor.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# fields of a model: solver references and the impedances that belong to them
_SOLVED = (
    *(
        (f"{name}_solref", f"{name}_solimp")
        for name in ("geom", "pair", "jnt", "dof", "eq")
    ),
    ("tendon_solref_lim", "tendon_solimp_lim"),
    ("tendon_solref_fri", "tendon_solimp_fri"),
    ("pair_solreffriction", "pair_solimp"),
)


def euler_step(mujoco: Any, model: Any) -> float | None:
    """Return the semi-implicit Euler step of all behind a tool [s], or None.

    Parameters
    ----------
    mujoco : module
        MuJoCo.
    model : MjModel
        The scene.

    Notes
    -----
    A contact whose impedance grows with its depth (``solimp``) is linear about every depth only.
    """
    kinds = mujoco.mjtIntegrator
    euler = (kinds.mjINT_EULER, kinds.mjINT_IMPLICIT, kinds.mjINT_IMPLICITFAST)
    undamped = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP
    explicit = undamped and int(model.opt.integrator) == int(kinds.mjINT_EULER)
    springs = np.any(model.jnt_stiffness) or np.any(model.tendon_stiffness)
    if (
        int(model.opt.integrator) not in [int(kind) for kind in euler]
        or explicit
        or springs
        or model.nu
        or model.nflex
        or model.nplugin
    ):
        return None
    step = float(model.opt.timestep)
    kept = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
    solved = [(getattr(model, ref), getattr(model, imp)) for ref, imp in _SOLVED]
    if model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE:
        solved.append((model.opt.o_solref, model.opt.o_solimp))
    passive = (
        passive_within(np.reshape(ref, (-1, 2)), np.reshape(imp, (-1, 5)), step, kept)
        for ref, imp in solved
    )
    return step if all(bool(one.all()) for one in passive) else None


def passive_within(
    ref: NDArray[np.float64], imp: NDArray[np.float64], step: float, kept: bool = True
) -> NDArray[np.bool_]:
    """Return which MuJoCo constraints are passive within the step that pushes them.

    Parameters
    ----------
    ref : ndarray, shape (N, 2)
        ``solref``: time constant [s] and damping ratio, or −stiffness and −damping.
    imp : ndarray, shape (N, 5)
        ``solimp``: the second is the largest impedance.
    step : float
        Time step of the scene [s].
    kept : bool
        Whether a time constant below two steps is raised to them (flag ``refsafe``).
    """
    most = np.clip(imp[:, 1], 1e-4, 0.9999)
    direct = ref[:, 0] <= 0.0
    time = np.where(direct, 1.0, np.maximum(ref[:, 0], 2.0 * step if kept else 1e-15))
    ratio = np.where(direct, 1.0, np.maximum(ref[:, 1], 1e-15))
    stiff = np.where(direct, -ref[:, 0] / most**2, 1.0 / (most * time * ratio) ** 2)
    loss = np.where(direct, -ref[:, 1] / most, 2.0 / (most * time))
    half = 0.5 * step * stiff
    return np.asarray((half <= loss) & (loss <= 2.0 / step - half), dtype=np.bool_)
