"""What a pulse of one motor did to the craft: a regression on the poses around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_step
from airpuck.physics.thrust import thrust

#: Poses that are looked at before a pulse begins and after it ends [s].
_BEFORE, _AFTER = 0.15, 0.25
#: Transport delays that are tried [s], and the step of integration.
_DELAYS = np.arange(0.0, 0.15, 1e-3)
_STEP = 1e-3
#: A line needs at least this many poses on each side of a pulse.
_FEWEST = 20
#: A pulse shorter than this share of the usual length was cut off.
_CUT_OFF = 0.7


@dataclass(frozen=True, eq=False)
class PulseResponse:
    """What one pulse did."""

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
    """Measure what each pulse of a recorded test did.

    Around a pulse, which begins at a rest, position and yaw are

        p(t) = p₀ + v₀ t + a₀ t²/2 + ∬ R(γ) g F(t - d),
        γ(t) = γ₀ + ω₀ t + ω₀' t²/2 + ∬ g_γ F(t - d),

    with F the thrust that the model expects of the motor, a₀ and ω₀' what is always there (idling
    propellers, a tilted table), and g the effect in question. For a delay d this is a linear
    regression; d is the one with the least residual. The poses are used as they are, nothing is
    differentiated.
    """
    idle = model.vehicle.command_min
    pulses = find_pulses(command_time, command, idle)
    usual = np.median([end - begin for _, begin, end in pulses]) if pulses else 0.0
    responses = []
    for motor, begin, end in pulses:
        if end - begin < _CUT_OFF * usual:
            continue
        level = float(command[np.searchsorted(command_time, begin), motor])
        near = (time > begin - _BEFORE) & (time < end + _AFTER)
        early, late = time[near] < begin, time[near] > end
        if min(early.sum(), late.sum()) >= _FEWEST:
            known = _DELAYS if delays is None else delays[len(responses) :][:1]
            around = (time[near], pose[near], begin, end)
            responses.append(_response(model, motor, level, *around, known))
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
    motor: int,
    level: float,
    time: Float[np.ndarray, " M"],
    pose: Float[np.ndarray, "M 3"],
    begin: float,
    end: float,
    delays: Float[np.ndarray, " d"],
) -> PulseResponse:
    """Regress the poses around a pulse on what it can have done."""
    grid = np.arange(time[0], time[-1] + _STEP, _STEP)
    yaw = np.interp(grid, time, pose[:, 2])
    elapsed = time - begin
    always = np.stack([np.ones_like(elapsed), elapsed, elapsed**2 / 2], axis=1)
    linear_noise, angular_noise = _noise(always[elapsed < 0], pose[elapsed < 0])
    basis = np.linalg.qr(always)[0]

    def beyond(values: Float[np.ndarray, "M k"]) -> Float[np.ndarray, "M k"]:
        """Take off what is always there: the regression is on the rest."""
        return values - basis @ (basis.T @ values)

    x, y, turn = beyond(pose).T
    fits = []
    for delay in delays:
        force = _force(model, motor, level, grid - begin - delay, end - begin)
        shapes = np.stack([np.cos(yaw) * force, np.sin(yaw) * force, force], axis=1)
        integrals = _twice_integrated(shapes)
        sampled = [np.interp(time, grid, integral) for integral in integrals.T]
        along, across, turning = beyond(np.stack(sampled, axis=1)).T
        # The columns of the two forces, (along, across) and (-across, along), are orthogonal.
        size = along @ along + across @ across
        push = np.array([along @ x + across @ y, along @ y - across @ x]) / size
        moment = turning @ turn / (turning @ turning)
        left = x @ x + y @ y - size * (push @ push)
        left_turn = turn @ turn - moment**2 * (turning @ turning)
        cost = left / linear_noise + left_turn / angular_noise
        fits.append((cost, float(delay), np.append(push, moment)))
    cost, delay, effect = min(fits, key=lambda fit: fit[0])
    return PulseResponse(motor, effect, delay, float(np.sqrt(cost / (3 * len(time)))))


def _force(
    model: Model, motor: int, level: float, elapsed: Float[np.ndarray, " G"], length: float
) -> Float[np.ndarray, " G"]:
    """Return what the model expects of a motor beyond its idling thrust [N]."""
    lag, idle = float(model.dynamics.motor_time_constant), model.vehicle.command_min
    up = motor_step(np, idle, level, np.maximum(elapsed, 0.0), lag)
    peak = motor_step(np, idle, level, length, lag)
    speed = np.where(
        elapsed <= length, up, motor_step(np, peak, idle, np.maximum(elapsed - length, 0.0), lag)
    )
    # Motors without lag follow at once, also in the first moment before the pulse.
    speed = np.where(elapsed < 0, idle, speed)
    curve = np.asarray(model.dynamics.thrust)[motor : motor + 1]
    return thrust(curve, speed[None])[0] - thrust(curve, np.array([[idle]]))[0]


def _twice_integrated(acceleration: Float[np.ndarray, "G k"]) -> Float[np.ndarray, "G k"]:
    """Integrate twice from the first moment on, by the trapezoidal rule."""
    for _ in range(2):
        ends = acceleration + acceleration[0]
        acceleration = _STEP * (np.cumsum(acceleration, axis=0) - ends / 2)
    return acceleration


def _noise(always: Float[np.ndarray, "m 3"], pose: Float[np.ndarray, "m 3"]) -> tuple[float, float]:
    """Return the variances of positions and yaw about the motion before the pulse."""
    left = pose - always @ np.linalg.lstsq(always, pose, rcond=None)[0]
    variance = np.maximum(np.mean(left**2, axis=0), np.finfo(float).tiny)
    return float(variance[:2].mean()), float(variance[2])
