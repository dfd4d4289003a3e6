"""`find_faults`: when motors did not follow their commands, or something pushed the craft."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import gammaln

from airpuck.data.sampling import runs
from airpuck.data.trajectory import Span, Trajectory, check_propellers
from airpuck.faults.chain import (
    RADIO_OUT,
    STEP,
    UNEXPLAINED,
    Predicted,
    fault_chain,
    predict_faults,
    state_probabilities,
    usable_steps,
)
from airpuck.model.model_file import Model

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
