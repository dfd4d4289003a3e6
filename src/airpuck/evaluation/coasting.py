"""The baseline of predictions: a craft that coasts at constant velocity."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Result
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import Evaluation, EveryStart
from airpuck.evaluation.statistical_tests import redrawn_means


def coasting(evaluation: Evaluation, trajectory: Trajectory) -> Evaluation:
    """Predict the same windows with constant velocity, as a baseline that needs no model.

    Parameters
    ----------
    evaluation : Evaluation
        Of a model on the trajectory.
    trajectory : Trajectory
        The same one.

    Returns
    -------
    Evaluation
        With the errors of a craft that coasts.

    Examples
    --------
    >>> found = airpuck.evaluate(model, trajectory)
    >>> bool((found.rmse < airpuck.coasting(found, trajectory).rmse).all())
    True
    """

    def errors(starts: Float[np.ndarray, " W"], steps: int) -> Float[np.ndarray, "T 3 W"]:
        first = np.searchsorted(trajectory.time, starts - trajectory.sample_period / 2)
        later = first + np.arange(1, steps + 1)[:, None]
        lasted = (trajectory.time[later] - trajectory.time[first])[..., None]
        state = trajectory.state
        moved = state[first, 3:] * lasted - (state[later, :3] - state[first, :3])
        moved[~trajectory.measured[later]] = np.nan
        return np.swapaxes(moved, 1, 2)

    start, every = evaluation.start, evaluation.every_start.start
    return replace(
        evaluation,
        model="constant velocity",
        encoder="none",
        errors=errors(start, len(evaluation.errors)),
        every_start=EveryStart(errors(every, evaluation.horizon_step)[-1], every),
    )


@dataclass(frozen=True)
class BetterFrom(Result):
    """The horizon from which positions are predicted better than by coasting."""

    JSON = "better_from_s=since better_from_interval_95_s=interval"

    #: The horizon [s]; None if coasting predicts as well at the longest one.
    since: float | None
    #: 95 % interval by block bootstrap; an end beyond the longest horizon is None. None if the
    #: recording is too short [s].
    interval: tuple[float | None, float | None] | None
    #: Longest horizon [s].
    longest: float

    def __str__(self) -> str:
        """Describe the result in a sentence."""
        begun = f"positions up to {self.longest:.2g} s ahead: "
        begun += "not better" if self.since is None else "better"
        begun += " than constant velocity" + (f" from {self.since:.2g} s on" if self.since else "")
        if self.interval is None:
            return begun
        low, high = self.interval
        if low is None:
            return begun + f" (with 95 % confidence not before {self.longest:.2g} s)"
        end = f"{high:.2g} s" if high else f"beyond {self.longest:.2g} s"
        return begun + f" (95 % interval {low:.2g} s to {end})"


def better_from(evaluation: Evaluation, trajectory: Trajectory) -> BetterFrom:
    """Return the horizon from which positions are predicted better than by coasting."""
    period, steps = evaluation.sample_period, len(evaluation.errors)
    squares = [
        np.sum(one.errors[:, :2] ** 2, axis=1)
        for one in (evaluation, coasting(evaluation, trajectory))
    ]

    def first(means: Float[np.ndarray, "S D"]) -> Float[np.ndarray, " D"]:
        """Return the step from which all are better; infinite if there is none."""
        model, idle = np.split(means, 2)
        last = np.where(model >= idle, np.arange(1, steps + 1)[:, None], 0).max(axis=0)
        return np.where(last < steps, (last + 1) * period, np.inf)

    together = np.concatenate(squares)
    lost = np.isnan(together)
    if lost.any():
        # The mean of the others takes the place of a pose that was not measured.
        mean = np.nansum(together, axis=1) / np.maximum((~lost).sum(axis=1), 1)
        together = np.where(lost, mean[:, None], together)
    drawn = redrawn_means(together, evaluation.start)
    since = _finite(float(first(together.mean(axis=1, keepdims=True))[0]))
    interval = None
    if drawn is not None:
        low, high = np.quantile(first(drawn), [0.025, 0.975], method="nearest").tolist()
        interval = _finite(low), _finite(high)
    return BetterFrom(since, interval, steps * period)


def _finite(number: float) -> float | None:
    """Return a number, or None for infinity."""
    return number if np.isfinite(number) else None
