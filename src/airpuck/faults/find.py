"""`find_faults`: when motors did not follow their commands, or something pushed the craft."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import gammaln

from airpuck.data.sampling import runs
from airpuck.data.trajectory import Span, Trajectory, check_propellers
from airpuck.deviation.motor_regression import accelerations_by_motor
from airpuck.model.model_file import Model
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
        left = lag_decay(np, (time[index] - time[begin][:, None])[..., None], np.ravel(lag))
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
    """Return the number of steps after which an undriven motor counts as stopped."""
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
        now /= np.add.reduce(now)
        forward[k] = now
        now = now @ transition
    later = np.ones(len(initial))
    for k in range(len(likelihood) - 1, -1, -1):
        forward[k] *= later
        later = transition @ (likelihood[k] * later)
        later /= np.add.reduce(later)
    return forward / forward.sum(axis=1, keepdims=True)


NOT_ARMED, CONTACT = "not armed", "contact"

#: Degrees of freedom of the Student distribution of the residuals.
_TAIL = 8.0
#: Exponent of the likelihood: residuals of neighbouring steps are not independent.
_TEMPERING = 0.5
#: Residuals below this fraction of the usual acceleration are insignificant, however good the
#: model.
_NEGLIGIBLE = 0.02
#: Unexplained motion may be any acceleration up to this many usual residuals.
_WIDE = 100.0
#: A cause is visible if it changes the acceleration by this many usual residuals.
_SHOWS = 1.0
#: Unexplained motion that ends within this time was a blow [s].
_BLOW = 0.11
#: Number of motor time constants until the initial speeds no longer matter.
_SETTLING = 3.0
#: Fewest steps from which the usual residual is estimated.
_FEWEST = 20


def find_faults(trajectory: Trajectory, model: Model) -> tuple[Span, ...]:
    """Find when motors did not follow their commands, or something pushed the craft.

    Parameters
    ----------
    trajectory : Trajectory
        A recording.
    model : Model
        Model of the healthy craft. A first fit to the same recording will do, preferably a robust
        one.

    Returns
    -------
    tuple of Span
        Spans in order of their starts, with causes ``not armed``, ``radio out``, ``NAME stalled``
        (with a propeller's name), ``contact`` (a blow) and ``unexplained motion``. Their confidence
        is the mean posterior probability of the cause. A span covers only the visible part of a
        fault: a motor that is commanded to idle may stop unnoticed.

    Raises
    ------
    InputError
        If the trajectory is of another craft.

    Notes
    -----
    A hidden Markov model (`fault_chain`): under each hypothesis, motors have their own speeds,
    which give a mean acceleration over each step of 25 ms. Residuals follow Student's distribution
    with the usual width of this recording, plus a part that grows with the change of the modelled
    acceleration, since packets come late. Both past and future count (`state_probabilities`).

    Examples
    --------
    >>> airpuck.find_faults(trajectory, model)
    ()
    """
    check_propellers(model.vehicle, trajectory)
    if trajectory.duration < _FEWEST * STEP:
        return ()
    predicted = predict_faults(trajectory, model.dynamics)
    usable = usable_steps(trajectory, predicted.knots)
    if usable.sum() < _FEWEST:
        return ()
    width = _usual_residual(predicted, usable)
    chain = fault_chain(predicted.faults, trajectory.propellers)
    # The initial motor speeds are a guess: until it is forgotten, accelerations carry no
    # information.
    forgotten = trajectory.time[0] + _SETTLING * float(model.dynamics.motor_time_constant)
    says = usable & (trajectory.time[predicted.knots[:-1]] >= forgotten)
    likelihood = np.where(says[:, None], _log_likelihood(predicted, width), 0.0)
    posterior = state_probabilities(likelihood, chain.transition, chain.initial)
    weighted = posterior * _effects(predicted, width)
    probability = {c: posterior[:, states].sum(axis=1) for c, states in chain.causes.items()}
    time = trajectory.time[predicted.knots]
    spans = []
    for cause, first, last in _runs_of_causes(probability, posterior[:, 0] < 0.5):
        effect = weighted[first:last, chain.causes[cause]].sum(axis=1)
        shows = np.flatnonzero(effect >= _SHOWS * probability[cause][first:last])
        if len(shows) == 0:
            continue
        begin, end = first + shows[0], first + shows[-1] + 1
        confidence = float(probability[cause][begin:end].mean())
        start, stop = float(time[begin]), float(time[end])
        spans.append(Span(start, stop, _in_words(cause, first, stop - start), confidence))
    return tuple(sorted(spans, key=lambda span: span.start))


def _in_words(cause: str, first: int, duration: float) -> str:
    """Distinguish unarmed motors from a silent radio, and a blow from other motion."""
    if cause == RADIO_OUT and first == 0:
        return NOT_ARMED
    return CONTACT if cause == UNEXPLAINED and duration <= _BLOW else cause


def _usual_residual(
    predicted: Predicted, usable: Bool[np.ndarray, " K"]
) -> Float[np.ndarray, "K 3"]:
    """Return the usual size of residuals at each step, from medians, which are robust to faults.

    It is a constant where the modelled acceleration barely changes; elsewhere a fraction of the
    change is added.
    """
    residual = np.abs(predicted.measured - predicted.normal)[usable] / 0.6745
    change = np.abs(predicted.change)[usable]
    constant, share = np.empty(3), np.empty(3)
    for c in range(3):
        calm = change[:, c] <= np.median(change[:, c])
        brisk = change[:, c] > np.quantile(change[:, c], 0.75)
        constant[c] = np.median(residual[calm, c])
        more = (residual[brisk, c] ** 2 - constant[c] ** 2) / change[brisk, c] ** 2
        share[c] = np.sqrt(max(np.median(more), 0.0)) if brisk.any() else 0.0
    least = _NEGLIGIBLE * np.sqrt(np.mean(predicted.normal[usable] ** 2, axis=0))
    constant = np.maximum(np.maximum(constant, least), np.finfo(float).tiny)
    return np.sqrt(constant**2 + (share * predicted.change) ** 2)


def _log_likelihood(
    predicted: Predicted, width: Float[np.ndarray, "K 3"]
) -> Float[np.ndarray, "K S"]:
    """Return the log-likelihood of each state of the chain, in units of the usual residual."""
    peak = gammaln((_TAIL + 3) / 2) - gammaln(_TAIL / 2) - 1.5 * np.log(_TAIL * np.pi)

    def student(modelled: Float[np.ndarray, "ages K 3"]) -> Float[np.ndarray, "ages K"]:
        square = (((predicted.measured - modelled) / width) ** 2).sum(axis=-1)
        return peak - (_TAIL + 3) / 2 * np.log1p(square / _TAIL)

    states = [student(predicted.normal[None]), *map(student, predicted.faulty)]
    states.append(np.full((1, len(width)), -3 * np.log(2 * _WIDE)))
    return _TEMPERING * np.concatenate(states).T


def _effects(predicted: Predicted, width: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K S"]:
    """Return how far each state moves the acceleration, in usual residuals."""
    sizes = [np.zeros((1, len(width)))]
    for modelled in predicted.faulty:
        sizes.append(np.sqrt((((modelled - predicted.normal) / width) ** 2).sum(axis=-1)))
    # Unexplained motion has no modelled acceleration: it is visible everywhere.
    sizes.append(np.full((1, len(width)), np.finfo(float).max))
    return np.concatenate(sizes).T


def _runs_of_causes(
    probability: dict[str, Float[np.ndarray, " K"]], faulty: Bool[np.ndarray, " K"]
) -> list[tuple[str, int, int]]:
    """Return causes with their first step and the step after their last.

    Each cause gets the steps where it is more probable than not. Faulty steps without such a cause
    go to the most probable one.
    """
    probable = {cause: p >= 0.5 for cause, p in probability.items()}
    likeliest = np.argmax(list(probability.values()), axis=0)
    undecided = faulty & ~np.logical_or.reduce(list(probable.values()))
    return [
        (cause, first, last)
        for number, (cause, here) in enumerate(probable.items())
        for first, last in runs(here | (undecided & (likeliest == number)))
    ]
