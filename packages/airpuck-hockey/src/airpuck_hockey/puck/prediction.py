"""Predictions of a puck over several bounces, and their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

import numpy as np
from jaxtyping import Float

from airpuck import AirHockey, PuckState
from airpuck.extend import PUCK_NUMBERS, Puck, PuckOnTable, Touch, coast, puck_paths, time_of
from airpuck_hockey.puck.flights import sigmas

#: Standard deviations of parameters that were not identified on this table. Restitution: the
#: scatter of single bounces of a real puck (studies/real_puck.md); others are guesses.
_ASSUMED = {"drag_1_s": 0.05, "spin_drag_1_s": 0.1, "rail.restitution": 0.07, "rail.grip": 0.1}
#: White accelerations by air and slope: [m/s²/√Hz] and [rad/s²/√Hz].
ACCELERATION_DENSITY, SPIN_DENSITY = 0.03, 1.0
#: Just beyond the next bounce [s]: a puck on the rail would meet the rail again.
_BEYOND = 1e-8
#: For at most this many times, plain numbers are faster than arrays.
_FEW = 4
#: Times at which a path is drawn, in addition to its bounces [s].
_DRAWN = np.arange(0.0, 1.2, 0.02)


@dataclass(frozen=True, eq=False)
class PuckBelief:
    """Belief about a puck: mean and covariance."""

    #: Time [s].
    time: float
    #: x, y [m], yaw [rad] and their rates.
    mean: Float[np.ndarray, " 6"]
    #: Covariance of the mean.
    covariance: Float[np.ndarray, "6 6"]


@dataclass(frozen=True, eq=False)
class PuckPrediction:
    """Prediction of a puck.

    Attributes
    ----------
    time : array, shape (T,)
        When [s].
    mean : array, shape (T, 6)
        x, y [m], yaw [rad] and their rates; after a goal, the state in the goal.
    covariance : array, shape (T, 6, 6)
        Covariances of the mean.
    touches : tuple of Touch
        Number of bounces of the mean until the last time.
    goal : int
        The goal in which it ends, by the sign of x; 0: none.
    """

    time: Float[np.ndarray, " T"]
    mean: Float[np.ndarray, "T 6"]
    covariance: Float[np.ndarray, "T 6 6"]
    touches: tuple[Touch, ...]
    goal: int


class PuckModel:
    """A table with a puck, and pucks with each uncertain number shifted by a standard deviation.

    Parameters
    ----------
    equipment : AirHockey
        Table and puck. Identified parameters vary by their standard errors, others by a guess.
    """

    def __init__(self, equipment: AirHockey) -> None:
        self.equipment = equipment
        #: Standard deviation of each number.
        self.spread = _spread(equipment.puck)

    @cached_property
    def numbers(self) -> Float[np.ndarray, "V 4"]:
        """`NUMBERS` of the pucks of a prediction, one in each row.

        The state of the first differs, to both sides of six axes; then each number is too high, and
        too low. The last is the mean.
        """
        read = attrgetter(*PUCK_NUMBERS)
        given = read(self.equipment.puck)
        high, low = (
            [read(table.puck) for table in side] for side in zip(*self.variants, strict=True)
        )
        return np.array([*[given] * (2 * len(PuckState._fields)), *high, *low, given])

    @cached_property
    def variants(self) -> list[tuple[AirHockey, AirHockey]]:
        """Tables with each number too high, and too low."""

        def changed(name: str, by: float) -> AirHockey:
            puck = _changed(self.equipment.puck, name, by)
            return self.equipment.model_copy(update={"puck": puck})

        return [(changed(name, by), changed(name, -by)) for name, by in self.spread.items()]


def _spread(puck: Puck) -> dict[str, float]:
    """Return the standard deviation of each uncertain number."""
    return {name: puck.standard_error.get(name, assumed) for name, assumed in _ASSUMED.items()}


def drawn_puck(puck: Puck, random: np.random.Generator) -> Puck:
    """Draw a puck and its rails within their uncertainty."""
    for name, spread in _spread(puck).items():
        puck = _changed(puck, name, float(random.normal(0.0, spread)))
    return puck


def _changed(puck: Puck, name: str, change: float) -> Puck:
    """Return a puck with another value of a number, within its bounds."""
    section, _, key = name.rpartition(".")
    if not section:
        return puck.model_copy(update={name: max(getattr(puck, name) + change, 0.0)})
    law = getattr(puck, section)
    value = min(max(getattr(law, key) + change, 0.0), 1.0)
    return puck.model_copy(update={section: law.model_copy(update={key: value})})


def predict_puck(model: PuckModel, belief: PuckBelief, times: Sequence[float]) -> PuckPrediction:
    """Predict an untouched puck.

    Central differences of one standard deviation carry mean and covariance through the bounces
    (Nørgaard, Poulsen and Ravn, *Automatica* 36, 2000): along each axis of the belief, and in each
    uncertain number of the puck.

    Parameters
    ----------
    model : PuckModel
        The table.
    belief : PuckBelief
        The present belief.
    times : sequence of float
        Prediction times [s], increasing, none before the belief.

    Returns
    -------
    PuckPrediction
        Mean, covariance and bounces.
    """
    when = np.array(times, dtype=float)
    puck = PuckOnTable(model.equipment, PuckState(*belief.mean.tolist()), belief.time)
    puck.run(max(when, default=belief.time))
    steps = axes_of(belief.covariance).T
    count, other = len(steps), len(PUCK_NUMBERS)
    states = np.tile(belief.mean, (len(model.numbers), 1))
    states[:count] += steps
    states[count : 2 * count] -= steps
    found = puck_paths(model.equipment, states, model.numbers, when - belief.time)
    *sides, mean = np.split(found, np.cumsum([count, count, other, other]))
    deviation = np.concatenate([sides[0] - sides[1], sides[2] - sides[3]]) / 2
    covariance = np.einsum("kti,ktj->tij", deviation, deviation)
    covariance += process_noise(when - belief.time, ACCELERATION_DENSITY)
    return PuckPrediction(when, mean[0], covariance, tuple(puck.touches), puck.goal)


def predict_path(
    equipment: AirHockey, belief: PuckBelief, times: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "T 6"]:
    """Return the mean state of an untouched puck at increasing times."""
    puck, after = _untouched(equipment, belief), times - belief.time
    found, done = np.empty((len(times), 6)), 0
    while done < len(times):
        until = min(puck.next_meeting + _BEYOND, after[-1])
        here = int(np.searchsorted(after, until, side="right"))
        found[done:here] = _coasting(equipment.puck, puck.state, after[done:here] - puck.time)
        done = here
        if puck.goal:
            found[done:] = puck.state
            break
        puck.run(until)
    return found


def goal_within(equipment: AirHockey, state: PuckState, duration: float) -> int:
    """Return the goal that an untouched puck enters within a time, by the sign of x; 0: none."""
    alone = PuckOnTable(equipment, state, logs=False)
    alone.run(duration)
    return alone.goal


def drawn_path(equipment: AirHockey, belief: PuckBelief) -> Float[np.ndarray, "N 2"]:
    """Return the path of an untouched puck over the next 1.2 s, with corners at the rails."""
    puck, bounces = _untouched(equipment, belief), []
    while not puck.goal and (bounce := puck.next_meeting) < _DRAWN[-1]:
        bounces.append(bounce)
        puck.run(bounce + _BEYOND)
    return predict_path(equipment, replace(belief, time=0.0), np.union1d(_DRAWN, bounces))[:, :2]


def _untouched(equipment: AirHockey, belief: PuckBelief) -> PuckOnTable:
    """Return a puck that starts from the belief's mean at time 0.

    Time stamps count from 1970: their last digit is 0.2 µs, too coarse to get past a bounce.
    """
    return PuckOnTable(equipment, PuckState(*belief.mean.tolist()), logs=False)


def _coasting(
    puck: Puck, state: PuckState, durations: Float[np.ndarray, " T"]
) -> Float[np.ndarray, "T 6"]:
    """Return the states of a puck that coasts: `coast` at many times."""
    if len(durations) <= _FEW:
        return np.array([coast(puck, state, each) for each in durations.tolist()]).reshape(-1, 6)
    rates = np.array([puck.drag_1_s, puck.drag_1_s, puck.spin_drag_1_s])
    sigma, start, found = sigmas(rates, durations), np.array(state), np.empty((len(durations), 6))
    found[:, :3] = start[:3] + start[3:] * sigma
    found[:, 3:] = start[3:] * (1 - rates * sigma)
    return found


@dataclass(frozen=True, eq=False)
class PuckCrossing:
    """Prediction of where a puck crosses a line across the table.

    Attributes
    ----------
    time : float
        Time at which its centre is there [s].
    state : PuckState
        State at that time.
    covariance : array, shape (2, 2)
        Covariance of time and y.
    """

    time: float
    state: PuckState
    covariance: Float[np.ndarray, "2 2"]


def predict_crossing(
    model: PuckModel, belief: PuckBelief, x: float, horizon: float = 2.0
) -> PuckCrossing | None:
    """Predict when and where an untouched puck will first cross a line across the table.

    Parameters
    ----------
    model : PuckModel
        The table.
    belief : PuckBelief
        The present belief.
    x : float
        Position of the line [m].
    horizon : float, default 2
        Prediction horizon [s].

    Returns
    -------
    PuckCrossing or None
        The crossing; None if there is none in time.
    """
    end = belief.time + horizon
    middle = _crossing(model.equipment, belief, x, end)
    if middle is None:
        return None
    centre = np.array([middle[0], middle[1].y])
    columns = []
    for above, below in _both_sides(model, belief):
        found = [_crossing(*above, x, end), _crossing(*below, x, end)]
        # A variant that does not cross in time is assumed to mirror its counterpart.
        ends = [np.array([time, state.y]) - centre for time, state in filter(None, found)]
        if found[1] is not None:
            ends[-1] = -ends[-1]
        columns.append(np.mean(ends, axis=0) if ends else np.zeros(2))
    deviation = np.array(columns)
    return PuckCrossing(*middle, deviation.T @ deviation)


def axes_of(covariance: Float[np.ndarray, "*n 6 6"]) -> Float[np.ndarray, "*n 6 6"]:
    """Return the axes of covariances in columns, each a standard deviation long."""
    variance, axes = np.linalg.eigh(covariance)
    return axes * np.sqrt(np.maximum(variance, 0.0))[..., None, :]


def _both_sides(
    model: PuckModel, belief: PuckBelief
) -> Iterator[tuple[tuple[AirHockey, PuckBelief], tuple[AirHockey, PuckBelief]]]:
    """Yield table and belief a standard deviation to both sides: of the state, of the numbers."""
    for step in filter(np.any, axes_of(belief.covariance).T):
        above, below = (replace(belief, mean=belief.mean + sign * step) for sign in (1, -1))
        yield (model.equipment, above), (model.equipment, below)
    for upper, lower in model.variants:
        yield (upper, belief), (lower, belief)


def _crossing(
    equipment: AirHockey, belief: PuckBelief, x: float, end: float
) -> tuple[float, PuckState] | None:
    """Return when a puck crosses a line, and its state there: free puck_paths are straight in σ."""
    puck, last = _untouched(equipment, belief), end - belief.time
    while puck.time < last and not puck.goal:
        now, start = puck.time, puck.state
        until = min(puck.next_meeting + _BEYOND, last)
        sigma = (x - start.x) / start.vx if start.vx else -1.0
        after = time_of(equipment.puck.drag_1_s, sigma) if sigma >= 0 else math.inf
        if now + after <= until:
            return belief.time + now + after, coast(equipment.puck, start, after)
        puck.run(until)
    return None


def process_noise(
    duration: float | Float[np.ndarray, " T"], density: float
) -> Float[np.ndarray, "*T 6 6"]:
    """Return the contribution of white accelerations to the covariance."""
    found = np.zeros((*np.shape(duration), 6, 6))
    place, cross = duration**3 / 3, duration**2 / 2
    for axis, squared in enumerate((density**2, density**2, SPIN_DENSITY**2)):
        found[..., axis, axis] = squared * place
        found[..., axis, axis + 3] = found[..., axis + 3, axis] = squared * cross
        found[..., axis + 3, axis + 3] = squared * duration
    return found
