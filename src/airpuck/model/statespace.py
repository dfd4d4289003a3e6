"""A model linearised at rest, as python-control has it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.physics.linearization import linearize, trim
from airpuck.physics.rigid_body import Dynamics

if TYPE_CHECKING:
    import control


def statespace(
    dynamics: Dynamics,
    name: str,
    propellers: tuple[str, ...],
    yaw: float,
    command: Float[np.ndarray, " n"] | None,
    period: float | None,
) -> control.StateSpace:
    """Linearise a model at rest; see `Model.to_statespace`."""
    try:
        import control
    except ImportError:
        raise InputError("to_statespace needs python-control: pip install control") from None
    command = trim(dynamics, yaw=yaw) if command is None else np.asarray(command, dtype=float)
    if command.shape != (len(propellers),):
        raise InputError(f"needs {len(propellers)} numbers, one for each motor", field="command")
    if not ((command >= 0) & (command <= 1)).all():
        raise InputError("must lie in [0, 1]", field="command")
    if not np.isfinite(yaw):
        raise InputError("must be a finite number", field="yaw")
    # To python-control a period of zero means continuous time.
    if period is not None and not (np.isfinite(period) and period > 0):
        raise InputError("must be a positive number of seconds", field="period")
    a, b = linearize(dynamics, yaw, command)
    states = ["x", "y", "yaw", "vx", "vy", "spin", *(f"speed_{name}" for name in propellers)]
    system = control.StateSpace(
        a,
        b,
        np.eye(3, len(a)),
        np.zeros((3, len(propellers))),
        inputs=list(propellers),
        outputs=states[:3],
        states=states[: len(a)],
        name=name,
    )
    return system if period is None else system.sample(period, method="zoh")
