"""Motion under given commands, linearisation at rest, and parameters drawn at random."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError, installed
from airpuck.boundary.numbers import check_finite
from airpuck.compute.arrays import namespace, slopes, with_symbols
from airpuck.craft.vehicle import Vehicle
from airpuck.model.parameters import Parameters
from airpuck.physics import rigid_body
from airpuck.physics.rigid_body import Dynamics, acceleration, rollout
from airpuck.physics.thrust import inverse_thrust, is_monotone, thrust

if TYPE_CHECKING:
    import control

#: x, y, γ and their rates.
_POSE_AND_RATES = 6
#: Commands may exceed their limits by this.
_ROUNDING = 1e-6
#: Sampling fails if a smaller fraction of draws than this is a possible craft.
_LEAST_SHARE = 0.01


def derivative(dynamics: Dynamics, state: Any, command: Any) -> Any:
    """Evaluate the equations of motion; see `Model.derivative`."""
    n = len(dynamics.thrust)
    lagging = namespace(dynamics.thrust) is not np or dynamics.motor_time_constant > 0

    def rates(state: Any, command: Any) -> Any:
        _check(state, _POSE_AND_RATES + n if lagging else _POSE_AND_RATES, "state")
        _check(command, n, "command")
        xp = namespace(state, command, dynamics.thrust)
        return rigid_body.derivative(xp, dynamics, state, command)

    return with_symbols(rates, state, command)


def simulate(dynamics: Dynamics, vehicle: Vehicle, state: Any, commands: Any, period: Any) -> Any:
    """Simulate held commands; see `Model.simulate`."""
    n = vehicle.n_propellers
    period = np.asarray(period) if isinstance(period, list | tuple) else period
    if isinstance(period, float | int | np.ndarray):
        if not (np.all(np.asarray(period) > 0) and np.isfinite(period).all()):
            raise InputError("must be above 0 s, and finite", field="period")
        if np.shape(period)[:1] not in ((), np.shape(commands)[:1]):
            raise InputError("must be one number, or one for each command", field="period")

    def states(state: Any, commands: Any) -> Any:
        xp = namespace(state, commands, period, dynamics.thrust)
        if commands.ndim < 2 or commands.shape[1] != n:
            raise InputError(f"must have {n} columns, one for each motor", field="commands")
        if isinstance(commands, np.ndarray) and commands.dtype != object:
            _check_commands(vehicle, commands)
        _check_finite(state, "state")
        if state.shape[0] == _POSE_AND_RATES:
            state = xp.concatenate([state, commands[0]])
        _check(state, _POSE_AND_RATES + n, "state")
        durations = xp.broadcast_to(xp.asarray(period), commands.shape[:1] + np.shape(period)[1:])
        return rollout(xp, dynamics, state, commands, durations)

    return with_symbols(states, _array(state, "state"), _array(commands, "commands"))


def _array(given: Any, field: str) -> Any:
    """Return an array for a list of numbers; arrays, traced values and symbols are left as is."""
    if not isinstance(given, list | tuple | str):
        return given
    try:
        return np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise InputError("must be an array of numbers", field=field) from None


def _check_finite(state: Any, field: str) -> None:
    """Raise InputError for an array with a number that is not finite; traced ones are skipped."""
    if isinstance(state, np.ndarray) and state.dtype.kind == "f" and not np.isfinite(state).all():
        raise InputError("must be finite numbers", field=field)


def _check_commands(vehicle: Vehicle, commands: Float[np.ndarray, "T n *batch"]) -> None:
    """Reject commands that no motor accepts, such as pulse widths."""
    low, high = min(0.0, vehicle.command_min), max(1.0, vehicle.command_max)
    if not ((commands >= low - _ROUNDING) & (commands <= high + _ROUNDING)).all():
        raise InputError(
            f"go from {commands.min():g} to {commands.max():g}, but motors take {low:g} to "
            f"{high:g}; are they pulse widths, or percent?",
            field="commands",
        )


def draw(
    parameters: Parameters,
    covariance: Float[np.ndarray, "P P"],
    count: int,
    random: np.random.Generator,
    field: str,
) -> list[Parameters]:
    """Draw parameters from a normal distribution; `field` names the model in errors."""
    if not 0 <= count <= 1_000_000:
        raise InputError("must be between 0 and 1000000", field="count")
    center, (lower, upper) = parameters.to_vector(), parameters.bounds()
    factor = _factor(covariance)
    found: list[Parameters] = []
    drawn = 0
    while len(found) < count:
        drawn += 1
        vector = center + factor @ random.standard_normal(factor.shape[1])
        possible = ((vector >= lower) & (vector <= upper)) | (vector == center)
        candidate = parameters.with_vector(vector)
        if possible.all() and is_monotone(candidate.thrust).all():
            found.append(candidate)
        elif drawn * _LEAST_SHARE > len(found) + 1:
            raise InputError(
                "too few draws lie within the bounds with rising thrust curves: the parameters are "
                "too uncertain",
                field=field,
            )
    return found


def _factor(covariance: Float[np.ndarray, "P P"]) -> Float[np.ndarray, "P P"]:
    """Return A with A Aᵀ = V, scaled first since the units differ by orders of magnitude."""
    scale = np.sqrt(np.diag(covariance))
    scale[scale == 0] = 1.0
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def _check(array: Any, length: int, field: str) -> None:
    """Raise InputError if an array has another length."""
    if array.shape[:1] != (length,):
        raise InputError(
            f"must have {length} entries along its first axis, not the shape {array.shape}",
            field=field,
        )


#: Iterations of Newton's method on a trim that effects have moved: it settles in two or three.
_PASSES = 10


def trim(dynamics: Dynamics, yaw: float = 0.0) -> Float[np.ndarray, " n"]:
    """Find commands that keep the craft at rest.

    Among all thrusts that cancel, Π F = 0, choose those nearest to every motor's thrust at half
    speed. If optional effects disturb this trim, Newton's method continues from there with
    minimum-norm steps.
    """
    configuration = np.asarray(dynamics.configuration)
    wanted = thrust(dynamics.thrust, np.full(configuration.shape[1], 0.5))
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
        return rigid_body.derivative(np, dynamics, point[:size], point[size:])

    slope = _slope(rates, np.append(state, command))
    return slope[:, :size], slope[:, size:]


def _slope(
    function: Callable[[Any], Any], point: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "m k"]:
    """Differentiate with complex steps, exact to rounding (Squire, Trapp, SIAM Review 40, 1998)."""
    return slopes(np, lambda moved: np.broadcast_arrays(*function(moved)), point).T


def statespace(
    dynamics: Dynamics,
    name: str,
    propellers: tuple[str, ...],
    yaw: float,
    command: Float[np.ndarray, " n"] | None,
    period: float | None,
) -> control.StateSpace:
    """Linearise a model at rest; see `Model.to_statespace`."""
    with installed("this needs python-control: pip install 'airpuck[control]'"):
        import control
    command = trim(dynamics, yaw=yaw) if command is None else np.asarray(command, dtype=float)
    if command.shape != (len(propellers),):
        raise InputError(f"needs {len(propellers)} numbers, one for each motor", field="command")
    if not ((command >= 0) & (command <= 1)).all():
        raise InputError("must lie in [0, 1]", field="command")
    check_finite(yaw=yaw)
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
