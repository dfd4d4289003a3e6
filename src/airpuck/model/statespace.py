"""A model linearised at rest, as matrices and as python-control has it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.physics.rigid_body import Dynamics

if TYPE_CHECKING:
    import control


from collections.abc import Callable
from typing import Any

from airpuck.physics.rigid_body import acceleration, derivative
from airpuck.physics.thrust import inverse_thrust, thrust

#: Iterations of Newton's method on a trim that effects have moved: it settles in two or three.
_PASSES = 10


def trim(dynamics: Dynamics, level: float = 0.5, yaw: float = 0.0) -> Float[np.ndarray, " n"]:
    """Find commands that keep the craft at rest.

    Among all thrusts that cancel, Π F = 0, choose those nearest to every motor's thrust at `level`.
    If optional effects disturb this trim, Newton's method continues from there with minimum-norm
    steps.
    """
    configuration = np.asarray(dynamics.configuration)
    wanted = thrust(dynamics.thrust, np.full(configuration.shape[1], level))
    cancelling = wanted - np.linalg.pinv(configuration) @ (configuration @ wanted)
    command = inverse_thrust(np, dynamics.thrust, cancelling)
    if not dynamics.effects:
        return command
    motion = np.array([yaw, 0.0, 0.0, 0.0])
    for _ in range(_PASSES):
        left = np.array(acceleration(np, dynamics, motion, command))
        slope = _slope(lambda u: acceleration(np, dynamics, motion[:, None], u), command)
        command = np.clip(command - np.linalg.pinv(slope) @ left, 0.0, 1.0)
    return command


def linearize(
    dynamics: Dynamics, yaw: float, command: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "s s"], Float[np.ndarray, "s n"]]:
    """Linearise the equations of motion of a craft at rest, exactly.

    A = ∂f/∂z and B = ∂f/∂u at z = (0, 0, γ, 0, 0, 0, u), for eq. extended_model_dynamics.

    Parameters
    ----------
    dynamics : Dynamics
        Coefficients.
    yaw : float
        γ [rad].
    command : array, shape (n,)
        Motor commands u, which the motors have reached.

    Returns
    -------
    a, b : array, shape (s, s) and (s, n)
        Matrices for deviations from the operating point. The state is x, y, γ, vx, vy, ω and the n
        motor speeds. Without motor lag (τ = 0) the motor speeds are not states: s = 6 + n or 6.
    """
    pose = np.array([0.0, 0.0, yaw, 0.0, 0.0, 0.0])
    lagging = float(dynamics.motor_time_constant) > 0
    state = np.append(pose, command) if lagging else pose
    size = len(state)

    def rates(point: Any) -> Any:
        return derivative(np, dynamics, point[:size], point[size:])

    slope = _slope(rates, np.append(state, command))
    return slope[:, :size], slope[:, size:]


def _slope(
    function: Callable[[Any], Any], point: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "m k"]:
    """Differentiate with complex steps, exact to rounding (Squire, Trapp, SIAM Review 40, 1998)."""
    step = 1e-30
    moved = function(point[:, None] + 1j * step * np.eye(len(point)))
    return np.imag(np.array(np.broadcast_arrays(*moved))) / step


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
    # For python-control a period of zero means continuous time.
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
