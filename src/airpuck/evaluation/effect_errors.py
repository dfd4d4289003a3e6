"""Errors of a model's motor effects and timing, by regression of poses.

Standard errors of a fit show only the effect of chance. They do not include what the model cannot
describe: an inertia that it does not learn, a lag that it lacks, motors in another order. So the
poses, minus the model's accelerations integrated along the measured motion, are regressed on
several possible errors: each motor in any direction, the bend of its thrust curve, later commands
and slower motors. The result is the systematic error of the model (docs/method.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import Windows, integration_parts, make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.estimate.motor_regression import twice_integrated
from airpuck.evaluation.statistical_tests import block_regression
from airpuck.evaluation.timing_change import TimingChange, timing_change
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics, acceleration
from airpuck.physics.thrust import thrust
from airpuck.preprocessing.time_scale import forgetting_time, patience, showing_time

#: Time before and after the present of a window [s]; the latter is longer for a slow craft. Jitter
#: of the radio biases accelerations by 3 % for windows of 0.2 s, and by 1 % for windows of 0.4 s.
_PAST_S, _AHEAD_S = 40 / 240, 0.4
#: Step of the finite differences in transport delay and lag [s].
_STEP_S = 1e-3
#: Integration steps per lag of an actuator, and the largest number between two poses. With a
#: lag of 10 ms and poses every 60 ms, 6 and 12 steps agree to 11 ms in timing, and one step misses
#: it by seconds.
_STEPS_PER_LAG, _MOST_PARTS = 2, 12
#: Commands closer than this to 0 and 1 are those of a switch [1].
_OFF = 0.01
#: Units of the regression, which has a weak prior: fraction of a motor's effect [1], timing [s],
#: fraction of full thrust by which a curve bends [1], other accelerations [m/s², rad/s²] and those
#: per speed [1/s].
_EFFECT_UNIT, _TIME_UNIT, _BEND_UNIT, _OTHER_UNIT = 0.05, 2e-3, 0.2, 0.1
#: Minimum length [s] and number of the blocks of time behind the standard errors.
_BLOCK_S, _FEWEST_BLOCKS = 0.8, 5
#: A motor whose modelled full thrust is below this fraction of the median gets the median curve: a
#: motor that the model considers dead may still run.
_WEAK = 0.3
#: Columns per motor: forward, left, yaw; and the bend of its curve.
_PER_MOTOR = 3
#: Speed at which a model's low thrusts are judged: a craft that holds a position needs no more [1].
LOW_SPEED = 0.2
#: Information in a channel of one window beyond its initial pose and velocity: about two numbers.
_TOLD = 2
#: Order of the differences that remove slow errors; lower if windows have few poses.
_DIFFERENCES = 3
#: Directions of acceleration: row of Π, sign.
WAYS = ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))


@dataclass(frozen=True, eq=False)
class EffectErrors:
    """Systematic errors of a model that a recording reveals."""

    #: Acceleration by each motor at full speed, forward, left [m/s²] and yaw [rad/s²]: modelled,
    #: estimated, and the standard errors of the estimate.
    modelled: Float[np.ndarray, "3 n"]
    found: Float[np.ndarray, "3 n"]
    standard_error: Float[np.ndarray, "3 n"]
    #: Largest accelerations in each direction (`WAYS`): modelled minus estimated, relative to the
    #: modelled; and the standard errors, relative to the larger of the two.
    push: Float[np.ndarray, " 6"]
    push_error: Float[np.ndarray, " 6"]
    #: Errors of the accelerations with motors at `LOW_SPEED`, likewise.
    low: Float[np.ndarray, " 6"]
    #: Delay of the commands' effect beyond the model's, lag and delay together [s].
    later: float
    later_error: float
    #: Standard deviation of the white noise in measured poses [m, m, rad].
    noise: Float[np.ndarray, " 3"]
    #: The clearest change of the delay within the recording.
    timing: TimingChange


def effect_errors(model: Model, trajectory: Trajectory) -> EffectErrors | None:
    """Estimate the systematic errors of a model; None if the recording is too short."""
    remembered = forgetting_time(model.vehicle)
    before = trajectory.steps(max(_PAST_S, remembered), least=2)
    # On a slow craft, thrust takes longer to emerge from the noise; slow motors take time to build
    # it up.
    lasting = max(_AHEAD_S, showing_time([trajectory], model.vehicle), remembered)
    ahead = trajectory.steps(lasting)
    count = len(trajectory.window_starts(before + ahead, ahead))
    block = max(_BLOCK_S, 2 * lasting)
    if count * lasting < _FEWEST_BLOCKS * block:
        return None
    windows = make_windows(trajectory, before, ahead, stride=ahead)
    # Poses are linear in small delays only: the second pass starts where the first ended.
    first = _estimated(model, windows, 0.0, block)
    found = _estimated(model, windows, first.later, block)
    return replace(found, later=first.later + found.later)


def _estimated(model: Model, windows: Windows, moved: float, block: float) -> EffectErrors:
    """Estimate the errors of a model whose transport delay is `moved` [s]."""
    curves = _curves(model)
    columns, values = _regression(model, curves, windows, moved)
    n = len(curves)
    matrix = np.asarray(model.dynamics.configuration)
    force, moment = (np.linalg.norm(rows) / np.sqrt(n) for rows in (matrix[:2], matrix[2]))
    units = np.concatenate(
        [
            _EFFECT_UNIT * np.tile([force, force, moment], n),
            np.full(2, patience(model.vehicle) * _TIME_UNIT),
            np.full(n, _BEND_UNIT),
            np.full(columns.shape[2] - (_PER_MOTOR + 1) * n - 2, _OTHER_UNIT),
        ]
    )
    spread = np.maximum(np.sqrt(np.mean(values**2, axis=0)), 1e-12)
    period = windows.trajectories[0].sample_period
    estimate, covariance, _ = block_regression(
        columns * units / spread[:, None], values / spread, period, block
    )
    told = _TOLD * values.shape[1] * len(windows)
    covariance *= told / max(told - len(units), 1)
    estimate, covariance = estimate * units, covariance * np.outer(units, units)
    left = (values - columns @ estimate).reshape(len(windows), -1, 3)
    found = _in_words_of_control(model, curves, estimate, covariance)
    real = windows.measured[windows.present[:, None] + np.arange(left.shape[1])]
    late = np.zeros(len(units))
    late[_PER_MOTOR * n : _PER_MOTOR * n + 2] = 0.5
    scaled = columns / spread[:, None], (left / spread).reshape(-1, 3)
    changed = timing_change(*scaled, late, windows.time[windows.present], block)
    return replace(found, noise=_white(left, real), timing=changed)


def _white(
    left: Float[np.ndarray, "W T 3"], real: Bool[np.ndarray, "W T"]
) -> Float[np.ndarray, " 3"]:
    """Return the standard deviation of white noise, beside errors that change slowly."""
    order = min(_DIFFERENCES, left.shape[1] - 1)
    # Differences raise the variance of white noise by this factor.
    grown = math.comb(2 * order, order)
    steps = np.diff(left, n=order, axis=1)
    whole = np.lib.stride_tricks.sliding_window_view(real, order + 1, axis=1).all(axis=2)
    if not whole.any():
        return np.zeros(3)
    return np.sqrt(np.mean(steps[whole] ** 2, axis=0) / grown)


def _in_words_of_control(
    model: Model,
    curves: Float[np.ndarray, "n degree"],
    estimate: Float[np.ndarray, " m"],
    covariance: Float[np.ndarray, "m m"],
) -> EffectErrors:
    """Convert coefficients of the regression to accelerations and times."""
    n, vehicle = len(curves), model.vehicle
    matrix = np.asarray(model.dynamics.configuration)
    full = _thrusts(curves, 1.0)
    late = np.zeros(len(estimate))
    late[_PER_MOTOR * n : _PER_MOTOR * n + 2] = 1.0

    def accelerations(speed: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the acceleration of each motor: as modelled, added, and added per coefficient."""
        per, scaled = np.zeros((3, n, len(estimate))), _thrusts(curves, speed)
        for k in range(n):
            per[range(3), k, range(_PER_MOTOR * k, _PER_MOTOR * (k + 1))] = scaled[k]
            per[:, k, _PER_MOTOR * n + 2 + k] = speed * (1 - speed) * full[k] * matrix[:, k]
        return matrix * _thrusts(np.asarray(model.parameters.thrust), speed), per @ estimate, per

    idle = accelerations(vehicle.command_min)

    def pushes(speed: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the relative errors of the largest accelerations with motors up to a speed."""
        ends = idle, accelerations(speed)
        off, error = np.zeros(len(WAYS)), np.zeros(len(WAYS))
        for way, (row, sign) in enumerate(WAYS):
            now = sign * np.array([modelled[row] for modelled, _, _ in ends])
            then = now + sign * np.array([added[row] for _, added, _ in ends])
            before, after = now.max(axis=0).sum(), then.max(axis=0).sum()
            gained = ends[1][2][row] - ends[0][2][row]
            scatter = np.sqrt(np.einsum("nm,mk,nk->n", gained, covariance, gained))
            after -= _gain_by_chance(sign * (now[1] - now[0]), scatter).sum()
            weight = np.where(then[1] > then[0], ends[1][2][row].T, ends[0][2][row].T).sum(axis=1)
            off[way] = 1 - after / max(before, 1e-12)
            error[way] = np.sqrt(weight @ covariance @ weight) / max(before, after, 1e-12)
        return off, error

    modelled, added, per = accelerations(vehicle.command_max)
    errors = np.sqrt(np.einsum("rnm,mk,rnk->rn", per, covariance, per))
    return EffectErrors(
        modelled,
        modelled + added,
        errors,
        *pushes(vehicle.command_max),
        pushes(LOW_SPEED * vehicle.command_max)[0],
        float(late @ estimate),
        float(np.sqrt(late @ covariance @ late)),
        np.zeros(3),
        TimingChange(0.0, 0.0, 0.0),
    )


def _gain_by_chance(
    mean: Float[np.ndarray, " n"], scatter: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return by how much the mean of max(x, 0) exceeds max(mean, 0), for normally distributed x.

    The largest acceleration uses each motor that pushes the right way. A motor that pushes sideways
    does so by chance, so estimates exceed the true value unless this is subtracted.
    """
    size = np.abs(mean) / np.maximum(scatter, 1e-12)
    density = np.exp(-(size**2) / 2) / np.sqrt(2 * np.pi)
    beyond = np.array([0.5 * math.erfc(z / math.sqrt(2)) for z in size])
    return scatter * (density - size * beyond)


def _thrusts(curves: Float[np.ndarray, "n degree"], speed: float) -> Float[np.ndarray, " n"]:
    """Return the thrust of each motor at one speed."""
    return thrust(curves, np.full(len(curves), speed))


def _curves(model: Model) -> Float[np.ndarray, "n degree"]:
    """Return the thrust curves whose scale is estimated: the model's, unless it has no thrust."""
    curves = np.array(model.parameters.thrust, dtype=float)
    full = _thrusts(curves, 1.0)
    weak = full < _WEAK * np.median(full)
    curves[weak] = np.median(curves, axis=0)
    return curves


def _regression(
    model: Model, curves: Float[np.ndarray, "n degree"], windows: Windows, moved: float
) -> tuple[Float[np.ndarray, "M 3 m"], Float[np.ndarray, "M 3"]]:
    """Return each error's effect on the poses, and the residual of the poses.

    The effects of errors in the initial pose and velocity are projected out of both.
    """
    delay, usual = model.transport_delay, model.vehicle.nominal.transport_delay_s
    if not model.delay_learned and not all(t.delay_known for t in windows.trajectories):
        delay = usual
    delay += moved
    parts = _parts(model.dynamics, windows)
    windows = windows.refined(parts)
    held = windows.delayed(delay, usual)
    samples = held.present + np.arange(held.prediction_length + 1)[:, None]
    measured, durations = held.state[samples], np.diff(held.time[samples], axis=0)
    lag = model.dynamics.motor_time_constant + _STEP_S
    slow = replace(model.dynamics, motor_time_constant=lag)
    speed = _motor_speeds(model, model.dynamics, held)
    late = _motor_speeds(model, model.dynamics, windows.delayed(delay + _STEP_S, usual))
    # Along the measured motion instead of a predicted one, poses are linear in every error.
    driven, later, slower = (
        _twice_integrated(_driven(dynamics, measured, phi)[..., None], durations)[..., 0]
        for dynamics, phi in (
            (model.dynamics, speed),
            (model.dynamics, late),
            (slow, _motor_speeds(model, slow, held)),
        )
    )
    timing = np.stack([later - driven, slower - driven], axis=-1) / _STEP_S
    matrix = np.asarray(model.dynamics.configuration)
    added = _twice_integrated(_accelerations(curves, matrix, speed, measured), durations)
    n = _PER_MOTOR * len(curves)
    # Switches tell nothing of the curve between off and on: only their lag passes through it.
    added[..., n : n + len(curves)] *= _graded(windows)
    columns = np.concatenate([added[..., :n], timing, added[..., n:]], axis=3)
    time = np.concatenate([np.zeros((1, len(held))), np.cumsum(durations, axis=0)])[::parts]
    real = held.measured[samples[::parts]]
    values = _without_start((measured[..., :3] - driven)[::parts, ..., None], time, real)[..., 0]
    columns = _without_start(columns[::parts], time, real)
    return columns.reshape(-1, *columns.shape[2:]), values.reshape(-1, 3)


def _parts(dynamics: Dynamics, windows: Windows) -> int:
    """Return the number of steps from one pose to the next that resolve the shortest lag.

    If a valve's force settles within one step, its lag hardly changes the sampled forces, and the
    regression reports many times the true error.
    """
    coarse = max(map(integration_parts, windows.trajectories))
    lags = np.atleast_1d(np.asarray(dynamics.lag, dtype=float))
    if not (lags > 0).any():
        return coarse
    period = max(trajectory.sample_period for trajectory in windows.trajectories)
    needed = math.ceil(_STEPS_PER_LAG * period / lags[lags > 0].min())
    return max(coarse, min(needed, _MOST_PARTS))


def _graded(windows: Windows) -> Bool[np.ndarray, " n"]:
    """Return whether each actuator was ever commanded to a value between off and full."""
    sizes = [np.abs(trajectory.command) for trajectory in windows.trajectories]
    between = [(size > _OFF) & (size < 1 - _OFF) for size in sizes]
    return np.asarray(np.concatenate(between).any(axis=0))


def _motor_speeds(model: Model, dynamics: Dynamics, windows: Windows) -> Float[np.ndarray, "n T W"]:
    """Return the motor speeds from the present of each window on."""
    state, _ = PaperEncoder(model.indexing).begin(dynamics, windows.past())
    commands, durations, _ = windows.future()
    lag = dynamics.lag, dynamics.idle_lag
    speeds = [state[6:]]
    for command, duration in zip(commands, durations, strict=True):
        speeds.append(motor_step(np, speeds[-1], command, duration, *lag))
    return np.stack(speeds, axis=1)


def _driven(
    dynamics: Dynamics, measured: Float[np.ndarray, "T W 6"], speed: Float[np.ndarray, "n T W"]
) -> Float[np.ndarray, "T W 3"]:
    """Return the modelled accelerations along the measured motion."""
    motion = np.moveaxis(measured[..., 2:], 2, 0)
    return np.stack(np.broadcast_arrays(*acceleration(np, dynamics, motion, speed)), axis=-1)


def _accelerations(
    curves: Float[np.ndarray, "n degree"],
    matrix: Float[np.ndarray, "3 n"],
    speed: Float[np.ndarray, "n T W"],
    measured: Float[np.ndarray, "T W 6"],
) -> Float[np.ndarray, "T W 3 m"]:
    """Return the acceleration that each error would add, per unit, in the world.

    The columns are: for each motor its thrust forward, left and turning; for each motor the bend of
    its curve, which is zero at standstill and at full speed; constant accelerations; drag of
    translation and rotation.
    """
    force = np.moveaxis(thrust(curves, speed), 0, 2)
    cos, sin = np.cos(measured[..., 2]), np.sin(measured[..., 2])
    turn = np.zeros((*cos.shape, 3, 3))
    turn[..., 0, 0] = turn[..., 1, 1] = cos
    turn[..., 0, 1], turn[..., 1, 0], turn[..., 2, 2] = -sin, sin, 1.0
    along = np.einsum("twj,twik->twijk", force, turn).reshape(*turn.shape[:3], -1)
    full = _thrusts(curves, 1.0)
    bent = np.einsum("jtw,twik,kj,j->twij", speed * (1 - speed), turn, matrix, full)
    others = np.zeros((*turn.shape[:3], 5))
    others[..., [0, 1, 2], [0, 1, 2]] = 1.0
    others[..., :2, 3], others[..., 2, 4] = -measured[..., 3:5], -measured[..., 5]
    return np.concatenate([along, bent, others], axis=3)


def _twice_integrated(
    acceleration: Float[np.ndarray, "T W 3 m"], duration: Float[np.ndarray, "t W"]
) -> Float[np.ndarray, "T W 3 m"]:
    """Integrate twice, up to a constant velocity and position."""
    last = np.moveaxis(acceleration, 1, -1)
    return np.moveaxis(twice_integrated(last, duration), -1, 1)


def _without_start(
    values: Float[np.ndarray, "T W 3 m"],
    time: Float[np.ndarray, "T W"],
    real: Bool[np.ndarray, "T W"],
) -> Float[np.ndarray, "W T 3 m"]:
    """Remove constants and linear trends from the measured poses of each window, in their order."""
    trend = np.stack([np.ones_like(time), time], axis=-1) * real[..., None]
    basis = np.linalg.qr(trend.swapaxes(0, 1))[0]
    windows = np.swapaxes(values * real[..., None, None], 0, 1)
    flat = windows.reshape(*windows.shape[:2], -1)
    return (flat - basis @ (basis.swapaxes(1, 2) @ flat)).reshape(windows.shape)
