"""The hidden Markov chain of the craft's faults, and the probabilities of its states.

Hypotheses about the motors, and the acceleration that each predicts.

Time is divided into steps. A fault begins at a step's start, and its motor speeds follow from
there: speeds decay if nothing drives a motor, and approach the last received command if the radio
is silent. So every fault is a chain of hypotheses, one for each age of the fault in steps. The
chain of a stopped motor ends in a permanent state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.data.trajectory import Trajectory
from airpuck.deviation.motor_regression import accelerations_by_motor
from airpuck.physics.motor import lag_decay, motor_speeds
from airpuck.physics.rigid_body import Dynamics

#: Length of a step [s]: about the motors' lag, and long enough that smoothed velocities at its two
#: ends share no pose.
STEP = 0.025
#: Faults shorter than this count as jitter of the radio [s].
SHORTEST = 0.1
#: Longest time for which a silent radio leaves the last command in force [s].
LONGEST_HOLD = 0.6
#: Number of samples between the times in a step at which accelerations are evaluated.
_SPACING = 2
RADIO_OUT, UNEXPLAINED = "radio out", "unexplained motion"
#: Fraction of the steps at which a fault of one kind begins: each about once an hour. Two motors at
#: once are thirty times rarer, so that they are not preferred if one explains as much.
_BEGINS, _PAIR = 1e-5, 1 / 30
#: Fraction of the faults that end within a step, once they may.
_ENDS = 0.1
#: Fraction of the held commands that end within a step in a stop, due to an on-board timeout.
_TIMES_OUT = 0.02
#: Number of steps after which a held command is no longer jitter.
_HELD_AT_LEAST = 4
#: Fraction of the steps at which an unexplained motion begins, and fraction at which it ends.
_COMES, _PASSES = 1e-3, 0.3
#: Probability that a recording begins before the motors are armed.
_UNARMED = 0.02


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
    lag, time = dynamics.lag, trajectory.time
    speed = motor_speeds(time, trajectory.input, lag, dynamics.idle_lag)
    length = float(np.median(np.diff(time[knots])))
    stopping = _stopping_steps(float(np.max(lag)), length)

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
        left = lag_decay(np, elapsed[..., None], np.ravel(lag))
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
    """Return which steps touch no excluded span, and have velocities at both ends."""
    usable, known = trajectory.usable, trajectory.determined[knots]
    whole = np.logical_and.reduceat(usable, knots[:-1]) & usable[knots[1:]]
    return whole & known[:-1] & known[1:]


@dataclass(frozen=True, eq=False)
class Chain:
    """States: normal, each fault at each age, and last unexplained motion."""

    #: Probability of going from a row's state to a column's within a step.
    transition: Float[np.ndarray, "S S"]
    #: Initial probabilities.
    initial: Float[np.ndarray, " S"]
    #: The states in which each cause is active. Two causes may be active at once.
    causes: dict[str, Bool[np.ndarray, " S"]]


def stalled(name: str) -> str:
    """Name the cause of a stopped motor."""
    return f"{name} stalled"


def fault_chain(faults: Sequence[Fault], names: Sequence[str]) -> Chain:
    """Build the chain.

    A fault passes through all of its ages before it can end; stopped motors then stay stopped. A
    held command may also end earlier, or in a stop.
    """
    first = np.cumsum([1, *(fault.ages for fault in faults)])
    size = int(first[-1]) + 1
    transition, initial = np.zeros((size, size)), np.zeros(size)
    causes = {cause: np.zeros(size, dtype=bool) for cause in (RADIO_OUT, *map(stalled, names))}
    pairs = sum(len(fault.motors) == 2 for fault in faults)
    for fault, begin in zip(faults, first[:-1], strict=True):
        last = begin + fault.ages - 1
        ages = np.arange(begin, last)
        transition[ages, ages + 1] = 1.0
        transition[0, begin] = _BEGINS
        if not fault.motors:
            stop = first[[len(f.motors) for f in faults].index(len(names))]
            ending = ages[_HELD_AT_LEAST - 1 :]
            transition[ending, ending + 1] = 1 - _ENDS - _TIMES_OUT
            transition[ending, 0], transition[ending, stop] = _ENDS, _TIMES_OUT
            transition[last, [0, stop]] = 0.5
        else:
            transition[last, [last, 0]] = 1 - _ENDS, _ENDS
        if len(fault.motors) == len(names):
            initial[last] = _UNARMED
        elif len(fault.motors) == 2:
            transition[0, begin] *= _PAIR * len(names) / pairs
        everything = len(fault.motors) in (0, len(names))
        for cause in (
            [RADIO_OUT] if everything else [stalled(names[motor]) for motor in fault.motors]
        ):
            causes[cause][begin : last + 1] = True
    transition[0, -1] = _COMES
    transition[-1, [-1, 0]] = 1 - _PASSES, _PASSES
    transition[0, 0], initial[0] = 1 - transition[0].sum(), 1 - initial.sum()
    causes[UNEXPLAINED] = np.arange(size) == size - 1
    return Chain(transition, initial, causes)


def state_probabilities(
    log_likelihood: Float[np.ndarray, "K S"],
    transition: Float[np.ndarray, "S S"],
    initial: Float[np.ndarray, " S"],
) -> Float[np.ndarray, "K S"]:
    """Return the probabilities of the states of a hidden Markov chain, given all observations.

    L. E. Baum, T. Petrie, G. Soules and N. Weiss, Annals of Mathematical Statistics 41 (1970)
    164-171, scaled at every step (Rabiner, Proceedings of the IEEE 77, 1989, sec. V.A).
    """
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    forward = np.empty_like(likelihood)
    now = initial
    for k, seen in enumerate(likelihood):
        now = now * seen
        now /= now.sum()
        forward[k] = now
        now = now @ transition
    later = np.ones(len(initial))
    for k in range(len(likelihood) - 1, -1, -1):
        forward[k] *= later
        forward[k] /= forward[k].sum()
        later = transition @ (likelihood[k] * later)
        later /= later.sum()
    return forward
