"""Hypotheses about the motors, and the acceleration that each predicts.

Time is divided into steps. A fault begins at a step's start, and its motor speeds follow from
there: speeds decay if nothing drives a motor, and approach the last received command if the radio
is silent. So every fault is a chain of hypotheses, one for each age of the fault in steps. The
chain of a stopped motor ends in a permanent state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.data.trajectory import Trajectory
from airpuck.estimate.motor_regression import accelerations_by_motor
from airpuck.physics.motor import lag_decay, motor_speeds
from airpuck.physics.rigid_body import Dynamics

#: Length of a step [s]: about the motors' lag, and long enough that smoothed velocities at its two
#: ends share no pose.
STEP = 0.025
#: Shorter faults are the radio's jitter [s].
SHORTEST = 0.1
#: How long a silent radio can leave the last command in force [s].
LONGEST_HOLD = 0.6
#: Number of samples between the times in a step at which accelerations are evaluated.
_SPACING = 2


@dataclass(frozen=True)
class Fault:
    """A way in which motors do not follow their commands."""

    #: The stopped motors; empty: all motors keep the last received command.
    motors: tuple[int, ...]
    #: Steps in its chain.
    ages: int


@dataclass(frozen=True, eq=False)
class Predicted:
    """Mean accelerations over K steps, measured and under each hypothesis."""

    #: Samples at the steps' boundaries.
    knots: Int[np.ndarray, " K1"]
    #: From the smoothed velocities [m/s², m/s², rad/s²].
    measured: Float[np.ndarray, "K 3"]
    #: Modelled with motors that follow their commands.
    normal: Float[np.ndarray, "K 3"]
    #: Change of the modelled acceleration over each step.
    change: Float[np.ndarray, "K 3"]
    #: The other hypotheses.
    faults: tuple[Fault, ...]
    #: Modelled under each of them; entry j: the fault began j steps before this one.
    faulty: tuple[Float[np.ndarray, "_ K 3"], ...]


def predict_faults(trajectory: Trajectory, dynamics: Dynamics) -> Predicted:
    """Predict the craft's acceleration under each hypothesis, along the measured motion."""
    half = max(1, round(STEP / trajectory.sample_period / _SPACING))
    knots = np.arange(0, len(trajectory), _SPACING * half)
    # The midpoints of equal parts of every step.
    index = knots[:-1, None] + np.arange(_SPACING // 2, _SPACING * half, _SPACING)
    lag, time = float(dynamics.motor_time_constant), trajectory.time
    speed = motor_speeds(time, trajectory.input, lag, dynamics.idle_lag)
    length = float(np.median(np.diff(time[knots])))
    stopping = _stopping_steps(lag, length)

    def means(index: Any, speed: Any) -> tuple[Any, Any]:
        """Mean accelerations over all steps, of each motor and in total."""
        state = np.moveaxis(trajectory.state[index], 2, 1)
        by_motor, rest = accelerations_by_motor(dynamics, state, np.moveaxis(speed, 2, 1))
        by_motor, rest = by_motor.mean(axis=-1), rest.mean(axis=-1)
        return by_motor, by_motor.sum(axis=-1) + rest

    normal, total = means(index, speed[index])
    standing = np.zeros((stopping, *normal.shape))
    held = np.zeros((round(LONGEST_HOLD / length), *total.shape))
    for age in range(max(len(held), stopping - 1)):
        begin = knots[np.maximum(np.arange(len(total)) - age, 0)]
        elapsed = time[index] - time[begin][:, None]
        left = lag_decay(np, elapsed, lag)[..., None]
        before = speed[begin][:, None]
        if age < stopping - 1:
            standing[age], _ = means(index, before * left)
        if age < len(held):
            last = trajectory.input[np.maximum(begin - 1, 0)][:, None]
            _, held[age] = means(index, last + (before - last) * left)
    n, lost = speed.shape[1], normal - standing
    faults, faulty = [Fault((), len(held))], [held]
    for number in (n, *range(1, min(n, 3))):
        for motors in combinations(range(n), number):
            faults.append(Fault(motors, stopping))
            faulty.append(total - lost[..., list(motors)].sum(axis=-1))
    _, ends = means(knots[:, None], speed[knots][:, None])
    return Predicted(
        knots=knots,
        measured=np.diff(trajectory.state[knots, 3:], axis=0) / np.diff(time[knots])[:, None],
        normal=total,
        change=np.diff(ends, axis=0),
        faults=tuple(faults),
        faulty=tuple(faulty),
    )


def _stopping_steps(lag: float, length: float) -> int:
    """Return after how many steps an undriven motor counts as stopped."""
    return max(2, min(math.ceil(max(3 * lag, SHORTEST) / length), 20))


def usable_steps(trajectory: Trajectory, knots: Int[np.ndarray, " K1"]) -> Bool[np.ndarray, " K"]:
    """Return which steps touch no excluded span."""
    return np.logical_and.reduceat(trajectory.usable, knots[:-1]) & trajectory.usable[knots[1:]]
