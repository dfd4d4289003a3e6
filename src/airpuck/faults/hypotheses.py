"""What the motors may have done: hypotheses, and the acceleration that each of them predicts.

Time is cut into steps. A fault begins at a step's start, and its motor speeds follow from there on:
speeds decay where nothing drives a motor, and tend to the last command received where the radio is
silent. So every fault is a chain of hypotheses, one for each age of the fault in steps; standing
motors end in one that lasts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.data.trajectory import Trajectory
from airpuck.physics.motor import lag_decay, motor_speeds
from airpuck.physics.rigid_body import Dynamics, acceleration

#: Length of a step [s]: about the motors' lag, and long enough that smoothed velocities at its two
#: ends share no pose.
STEP = 0.025
#: Shorter faults are the radio's jitter [s].
SHORTEST = 0.1
#: For how long a radio that is silent can leave the last command in force [s].
LONGEST_HOLD = 0.6
#: Samples between the instants of a step at which accelerations are evaluated.
_SPACING = 2


@dataclass(frozen=True)
class Fault:
    """A way in which motors do not do what they are told."""

    #: Motors that stand; empty: all motors stay at the last command received.
    motors: tuple[int, ...]
    #: Steps in its chain.
    ages: int


@dataclass(frozen=True, eq=False)
class Predicted:
    """Mean accelerations over K steps, measured and under each hypothesis."""

    #: Samples at the steps' borders.
    knots: Int[np.ndarray, " K1"]
    #: From the smoothed velocities [m/s², m/s², rad/s²].
    measured: Float[np.ndarray, "K 3"]
    #: Modelled with motors that follow their commands.
    normal: Float[np.ndarray, "K 3"]
    #: By how much the modelled acceleration changes over each step.
    change: Float[np.ndarray, "K 3"]
    #: The other hypotheses.
    faults: tuple[Fault, ...]
    #: Modelled under each of them; entry j: it began j steps before this one.
    faulty: tuple[Float[np.ndarray, "_ K 3"], ...]


def predict_faults(trajectory: Trajectory, dynamics: Dynamics) -> Predicted:
    """Predict what each hypothesis would have done to the craft, along the measured motion."""
    half = max(1, round(STEP / trajectory.sample_period / _SPACING))
    knots = np.arange(0, len(trajectory), _SPACING * half)
    steps = len(knots) - 1
    # The middles of equal parts of every step.
    index = knots[:-1, None] + np.arange(_SPACING // 2, _SPACING * half, _SPACING)
    speed = motor_speeds(trajectory.time, trajectory.input, float(dynamics.motor_time_constant))
    length = float(np.median(np.diff(trajectory.time[knots])))
    stopping = _stopping_steps(dynamics, length)
    motion = trajectory.state[index, 2:6]

    def by_motor(speed: Float[np.ndarray, "K q n"]) -> Float[np.ndarray, "K 3 m"]:
        return _by_motor(dynamics, motion, speed).mean(axis=1)

    normal = by_motor(speed[index])
    n = speed.shape[1]
    standing = np.zeros((stopping, steps, 3, n + 1))
    standing[..., -1] = normal[..., -1]
    held = np.zeros((round(LONGEST_HOLD / length), steps, 3))
    for age in range(max(len(held), stopping - 1)):
        begin = knots[np.maximum(np.arange(steps) - age, 0)]
        elapsed = trajectory.time[index] - trajectory.time[begin][:, None]
        left = lag_decay(np, elapsed, dynamics.motor_time_constant)[..., None]
        before = speed[begin][:, None]
        if age < stopping - 1:
            standing[age] = by_motor(before * left)
        if age < len(held):
            last = trajectory.input[np.maximum(begin - 1, 0)][:, None]
            followed = _together(dynamics, motion, last + (before - last) * left)
            held[age] = followed.mean(axis=1)
    total = normal.sum(axis=-1)
    faults = [Fault(tuple(range(n)), stopping), Fault((), len(held))]
    faulty = [standing.sum(axis=-1), held]
    lost = normal - standing
    for number in range(1, min(n, 3)):
        for motors in combinations(range(n), number):
            faults.append(Fault(motors, stopping))
            faulty.append(total - lost[..., list(motors)].sum(axis=-1))
    ends = _together(dynamics, trajectory.state[knots, 2:6], speed[knots])
    rates = trajectory.state[knots, 3:]
    return Predicted(
        knots=knots,
        measured=np.diff(rates, axis=0) / np.diff(trajectory.time[knots])[:, None],
        normal=total,
        change=np.diff(ends, axis=0),
        faults=tuple(faults),
        faulty=tuple(faulty),
    )


def _stopping_steps(dynamics: Dynamics, length: float) -> int:
    """Return after how many steps a motor that nothing drives counts as standing."""
    lasting = max(3 * float(dynamics.motor_time_constant), SHORTEST)
    return max(2, min(math.ceil(lasting / length), 20))


def _together(
    dynamics: Dynamics, motion: Float[np.ndarray, "*B 4"], speed: Float[np.ndarray, "*B n"]
) -> Float[np.ndarray, "*B 3"]:
    """Return the accelerations that all motors give together."""
    axes = acceleration(np, dynamics, np.moveaxis(motion, -1, 0), np.moveaxis(speed, -1, 0))
    return np.stack(np.broadcast_arrays(*axes), axis=-1)


def _by_motor(
    dynamics: Dynamics, motion: Float[np.ndarray, "K q 4"], speed: Float[np.ndarray, "K q n"]
) -> Float[np.ndarray, "K q 3 m"]:
    """Return the accelerations that each motor gives, and last all others."""
    n = speed.shape[-1]
    # Accelerations are linear in the columns of Π: one at a time, and none.
    columns = np.concatenate([np.eye(n), np.zeros((1, n))])
    matrix = np.asarray(dynamics.configuration)[:, :, None] * columns.T
    one_motor = replace(dynamics, configuration=matrix[..., None, None])
    parts = np.stack(
        np.broadcast_arrays(
            *acceleration(
                np,
                one_motor,
                np.moveaxis(motion, -1, 0)[:, None],
                np.moveaxis(speed, -1, 0)[:, None],
            )
        )
    )
    parts[:, :-1] -= parts[:, -1:]
    return np.moveaxis(parts, (0, 1), (-2, -1))


def usable_steps(trajectory: Trajectory, knots: Int[np.ndarray, " K1"]) -> Bool[np.ndarray, " K"]:
    """Say which steps touch no excluded span."""
    return np.logical_and.reduceat(trajectory.usable, knots[:-1]) & trajectory.usable[knots[1:]]
