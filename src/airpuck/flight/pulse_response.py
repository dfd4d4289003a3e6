"""The effect of a pulse of one motor on the craft: a regression of the poses around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck.estimate.motor_regression import normal_equations, solved, twice_integrated
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_step
from airpuck.physics.thrust import thrust

#: Span of poses used before a pulse begins and after it ends [s].
_BEFORE, _AFTER = 0.15, 0.25
#: Transport delays that are tried [s], and the longest step of integration [s].
_DELAYS = np.arange(0.0, 0.15, 1e-3)
_STEP = 1e-3
#: A line needs at least this many poses on each side of a pulse.
_FEWEST = 20
#: A pulse shorter than this share of the usual length was cut off.
_CUT_OFF = 0.7


@dataclass(frozen=True, eq=False)
class PulseResponse:
    """The effect of one pulse."""

    #: Index of the propeller.
    motor: int
    #: Body accelerations per modelled thrust, like a column of Π [1/kg, 1/kg, 1/(kg m)].
    effect: Float[np.ndarray, " 3"]
    #: From the command's stamp to the motion, by which it is explained best [s].
    delay: float
    #: Root mean square of what is left unexplained, in standard deviations of the poses' noise.
    misfit: float


def pulse_responses(
    model: Model,
    time: Float[np.ndarray, " N"],
    pose: Float[np.ndarray, "N 3"],
    command_time: Float[np.ndarray, " K"],
    command: Float[np.ndarray, "K n"],
    delays: Float[np.ndarray, " pulses"] | None = None,
) -> list[PulseResponse]:
    """Measure the effect of each pulse of a recorded test.

    Around a pulse, which begins at a rest, position and yaw are

        p(t) = p₀ + v₀ t + a₀ t²/2 + ∬ R(γ) g F(t - d),
        γ(t) = γ₀ + ω₀ t + ω₀' t²/2 + ∬ g_γ F(t - d),

    with F the thrust that the model expects of the motor, a₀ and ω₀' what is always there (idling
    propellers, a tilted table), and g the effect in question. For a delay d this is a linear
    regression; d is the delay with the least residual. The poses are neither smoothed
    nor differentiated.
    """
    idle = model.vehicle.command_min
    pulses = find_pulses(command_time, command, idle)
    usual = np.median([end - begin for _, begin, end in pulses]) if pulses else 0.0
    responses = []
    for pulse in pulses:
        motor, begin, end = pulse
        near = (time > begin - _BEFORE) & (time < end + _AFTER)
        early, late = time[near] < begin, time[near] > end
        if end - begin < _CUT_OFF * usual or min(early.sum(), late.sum()) < _FEWEST:
            continue
        level = float(command[np.searchsorted(command_time, begin), motor])
        tried = _DELAYS if delays is None else delays[len(responses) :][:1]
        responses.append(_response(model, pulse, level, time[near], pose[near], tried))
    return responses


def find_pulses(
    command_time: Float[np.ndarray, " K"], command: Float[np.ndarray, "K n"], idle: float
) -> list[tuple[int, float, float]]:
    """Find the stretches in which one motor runs and all others idle."""
    runs = command > idle + 1e-6
    alone = np.where(runs.sum(axis=1) == 1, runs.argmax(axis=1), -1)
    edges = np.flatnonzero(np.diff(alone)) + 1
    stretches = zip([0, *edges], [*edges, len(alone)], strict=True)
    return [
        (int(alone[first]), float(command_time[first]), float(command_time[last]))
        for first, last in stretches
        if alone[first] >= 0 and last < len(alone)
    ]


def _response(
    model: Model,
    pulse: tuple[int, float, float],
    level: float,
    time: Float[np.ndarray, " M"],
    pose: Float[np.ndarray, "M 3"],
    delays: Float[np.ndarray, " D"],
) -> PulseResponse:
    """Regress the poses around a pulse on what it can have done, for all delays at once."""
    motor, begin, end = pulse
    elapsed = time - begin
    always = np.stack([np.ones_like(elapsed), elapsed, elapsed**2 / 2], axis=1)
    basis = np.linalg.qr(always)[0]
    before = always[elapsed < 0], pose[elapsed < 0]
    variance = np.var(before[1] - before[0] @ np.linalg.lstsq(*before, rcond=None)[0], axis=0)
    variance[:2] = variance[:2].mean()
    noise = np.sqrt(np.maximum(variance, np.finfo(float).tiny))

    def beyond(values: Float[np.ndarray, "M *k"]) -> Float[np.ndarray, "M *k"]:
        """Take off what is always there: the regression is on the rest."""
        return values - np.tensordot(basis, np.tensordot(basis.T, values, 1), 1)

    grid = np.union1d(np.arange(time[0], time[-1], _STEP), time)
    yaw = np.interp(grid, time, pose[:, 2])[:, None]
    force = _force(model, motor, level, grid[:, None] - begin - delays, end - begin)
    shapes = np.stack([np.cos(yaw) * force, np.sin(yaw) * force, force], axis=1)
    moved = twice_integrated(shapes, np.diff(grid)[:, None])[np.searchsorted(grid, time)]
    along, across, turning = np.moveaxis(beyond(moved), 1, 0)
    none = np.zeros_like(along)
    # The rows of x, y and γ, by the forces along and across and the moment.
    columns = [[along, -across, none], [across, along, none], [none, none, turning]]
    rows = np.transpose(np.array(columns) / noise[:, None, None, None], (3, 0, 2, 1))
    aim = np.broadcast_to((beyond(pose) / noise).T.ravel(), (len(delays), 3 * len(time)))
    information, score, square = normal_equations(rows.reshape(*aim.shape, 3), aim)
    effects, _ = solved(information, score, np.zeros((3, 3)))
    cost = square - (effects * score).sum(axis=1)
    best = int(cost.argmin())
    misfit = float(np.sqrt(max(cost[best], 0.0) / aim.shape[1]))
    return PulseResponse(motor, effects[best], float(delays[best]), misfit)


def _force(
    model: Model, motor: int, level: float, elapsed: Float[np.ndarray, "G D"], length: float
) -> Float[np.ndarray, "G D"]:
    """Return the modelled thrust of a motor beyond its idling thrust [N]."""
    lag, idle = float(model.dynamics.motor_time_constant), model.vehicle.command_min
    peak = motor_step(np, idle, level, np.clip(elapsed, 0.0, length), lag)
    speed = motor_step(np, peak, idle, np.maximum(elapsed - length, 0.0), lag)
    # Motors without lag follow at once, also in the first moment before the pulse.
    speed = np.where(elapsed < 0, idle, np.where(elapsed <= length, peak, speed))
    curve = np.asarray(model.dynamics.thrust)[motor : motor + 1]
    return thrust(curve, speed[None])[0] - thrust(curve, np.array([[[idle]]]))[0]
