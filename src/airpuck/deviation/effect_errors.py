"""Errors of a model's motor effects and timing, by regression of poses.

Standard errors of a fit show only the effect of chance. They do not include what the model cannot
describe: an inertia that it does not learn, a lag that it lacks, motors in another order. So the
poses, minus the model's accelerations integrated along the measured motion, are regressed on
several possible errors: each motor in any direction, the bend of its thrust curve, later commands
and slower motors. The result is the systematic error of the model (docs/method.md).

A clock that steps or drifts in mid-flight gives a recording two delays, and a fit learns their mean
with a small standard error. The change shows in the residuals: those along the effect of a delay
have one sign in one part of the recording, and the other sign in the other part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import Windows
from airpuck.deviation.motor_regression import (
    OTHER_UNIT,
    PoseRegression,
    body_accelerations,
    judging_windows,
    other_accelerations,
)
from airpuck.deviation.time_scale import patience
from airpuck.model.model_file import Model
from airpuck.physics.thrust import thrust

#: Fewest blocks of time in a part: together at least 10 s.
_FEWEST = 6
#: Smallest variance [s²].
_TINY = 1e-24
#: Commands this close to 0 or 1 count as on/off [1].
_OFF = 0.01
#: Units of the regression, which has a weak prior: fraction of a motor's effect [1], timing [s],
#: fraction of full thrust by which a curve bends [1].
_EFFECT_UNIT, _TIME_UNIT, _BEND_UNIT = 0.05, 2e-3, 0.2
#: A motor whose modelled full thrust is below this fraction of the median gets the median curve: a
#: motor that the model considers dead may still run.
_WEAK = 0.3
#: Columns per motor: forward, left, yaw; and the bend of its curve.
_PER_MOTOR = 3
#: Speed at which a model's low thrusts are judged: a craft that holds a position needs no more [1].
LOW_SPEED = 0.2
#: Directions of acceleration: row of Π, sign.
WAYS = ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))


@dataclass(frozen=True)
class TimingChange:
    """The clearest change of the time after which commands act."""

    #: Later part minus earlier part, and its standard error [s].
    change: float
    error: float
    #: When it happens [s].
    at: float
    #: Probability of such a change between these parts by chance.
    p_value: float = 1.0


def timing_change(
    columns: Float[np.ndarray, "M 3 m"],
    left: Float[np.ndarray, "M 3"],
    timing: Float[np.ndarray, " m"],
    start: Float[np.ndarray, " W"],
    block: float,
) -> TimingChange:
    """Compare the timing before and after each possible change.

    `columns` are the effects of all errors on the poses of W windows, `left` what the errors in the
    whole recording leave; `timing` is the direction of a delay. Windows that begin within `block`
    [s] count as one observation.
    """
    from scipy.special import stdtr

    late = columns @ timing
    flat = columns.reshape(-1, columns.shape[2])
    # What other errors explain of a delay tells nothing about it.
    others = flat - np.outer(flat @ timing, timing) / (timing @ timing)
    known, *_ = np.linalg.lstsq(others, late.ravel(), rcond=1e-8)
    late = late - (others @ known).reshape(late.shape)
    owner = ((start - start[0]) / block).astype(int)
    shape = len(start), -1
    score, weight = (
        np.bincount(owner, (late * one).reshape(shape).sum(axis=1)) for one in (left, late)
    )
    times = start[0] + block * np.flatnonzero(weight > 0)
    score, weight = score[weight > 0], weight[weight > 0]
    cuts = np.arange(_FEWEST, len(score) - _FEWEST + 1)
    if not len(cuts):
        return TimingChange(0.0, 0.0, float(start[0]))
    early, before = np.cumsum(score)[cuts - 1], np.cumsum(weight)[cuts - 1]
    after = weight.sum() - before
    change = (score.sum() - early) / after - early / before
    # The cut that explains most.
    best = int(np.argmax(change**2 * before * after))
    variances, counts = [], []
    for part in (slice(0, cuts[best]), slice(cuts[best], None)):
        mean = score[part].sum() / weight[part].sum()
        count = len(score[part])
        rest = np.sum((score[part] - mean * weight[part]) ** 2)
        variances.append(max(count / (count - 1) * rest / weight[part].sum() ** 2, _TINY))
        counts.append(count)
    error = float(np.sqrt(sum(variances)))
    # Welch's test: the variance of a few blocks is itself uncertain.
    spread = sum(v**2 / (n - 1) for v, n in zip(variances, counts, strict=True))
    degrees = sum(variances) ** 2 / spread
    p_value = 2 * float(stdtr(degrees, -abs(change[best]) / error))
    return TimingChange(float(change[best]), error, float(times[cuts[best]]), p_value)


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
    #: The clearest change of the delay within the recording.
    timing: TimingChange


def effect_errors(model: Model, trajectory: Trajectory) -> EffectErrors | None:
    """Estimate the systematic errors of a model by regression of poses on what would cause them.

    Parameters
    ----------
    model : Model
        The model to judge.
    trajectory : Trajectory
        A recording of the craft.

    Returns
    -------
    EffectErrors or None
        Errors of accelerations, response time and curves, with standard errors; None if the
        recording is too short.
    """
    found = judging_windows(trajectory, model)
    if found is None:
        return None
    # Poses are linear in small delays only: the second pass starts where the first ended.
    first = _estimated(PoseRegression(model, found[0]), found[1])
    again = _estimated(PoseRegression(model, found[0], first.later), found[1])
    return replace(again, later=first.later + again.later)


def _estimated(design: PoseRegression, block: float) -> EffectErrors:
    """Estimate the errors of a model from windows."""
    model, windows = design.model, design.windows
    curves = _curves(model)
    columns, n = _columns(design, curves), len(curves)
    matrix = np.asarray(model.dynamics.configuration)
    force, moment = (np.linalg.norm(rows) / np.sqrt(n) for rows in (matrix[:2], matrix[2]))
    units = np.concatenate(
        [
            _EFFECT_UNIT * np.tile([force, force, moment], n),
            np.full(2, patience(model.vehicle) * _TIME_UNIT),
            np.full(n, _BEND_UNIT),
            np.full(columns.shape[2] - (_PER_MOTOR + 1) * n - 2, OTHER_UNIT),
        ]
    )
    estimate, covariance, left = design.solve(columns, units, block)
    found = _in_words_of_control(model, curves, estimate, covariance)
    late = np.zeros(len(units))
    late[_PER_MOTOR * n : _PER_MOTOR * n + 2] = 0.5
    changed = timing_change(columns, left, late, windows.time[windows.present], block)
    return replace(found, timing=changed)


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


def _columns(
    design: PoseRegression, curves: Float[np.ndarray, "n degree"]
) -> Float[np.ndarray, "M 3 m"]:
    """Return each error's effect on the poses.

    The columns are: for each motor its thrust forward, left and turning; later commands and slower
    motors; for each motor the bend of its curve, which is zero at standstill and at full speed;
    constant accelerations and drag.
    """
    speed, turn = np.moveaxis(design.speed, 1, 0), body_accelerations(design.state)
    each = np.einsum("new,eikw->einkw", thrust(curves, speed), turn)
    matrix, full = np.asarray(design.model.dynamics.configuration), _thrusts(curves, 1.0)
    # Switches tell nothing of the curve between off and on: only their lag passes through it.
    full = full * _graded(design.windows)
    bent = np.einsum("new,eikw,kn,n->einw", speed * (1 - speed), turn, matrix, full)
    free = each.reshape(*turn.shape[:2], -1, turn.shape[3])
    return design.columns(free, design.timing(), bent, other_accelerations(design.state))


def _graded(windows: Windows) -> Bool[np.ndarray, " n"]:
    """Return whether each actuator was ever commanded to a value between off and full."""
    sizes = [np.abs(trajectory.command) for trajectory in windows.trajectories]
    between = [(size > _OFF) & (size < 1 - _OFF) for size in sizes]
    return np.asarray(np.concatenate(between).any(axis=0))
