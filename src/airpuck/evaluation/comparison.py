"""Predictions compared: with a craft that coasts at constant velocity, and between models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Result
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.significance import holm
from airpuck.evaluation.evaluate import Evaluation, EveryStart, known_intervals
from airpuck.evaluation.statistical_tests import redrawn_means, rmse_ratio


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


#: Chance of any false alarm among all pairs and channels.
LEVEL = 0.05


@dataclass(frozen=True, eq=False)
class ModelDifference(Result):
    """Errors of a second model relative to a first, on the same predictions."""

    JSON = (
        "first second rmse_ratio=ratio:x_m,y_m,yaw_rad p_value:x_m,y_m,yaw_rad "
        "differs:x_m,y_m,yaw_rad verdict"
    )

    #: Names of the models.
    first: str
    second: str
    #: Ratio of the RMSE of x, y, γ: the second model's to the first's.
    ratio: Float[np.ndarray, " 3"]
    #: 95 % intervals of the ratios, pointwise; NaN if the recording is too short.
    interval: Float[np.ndarray, "2 3"]
    #: P-values of equality, adjusted for the number of pairs and channels (Holm); NaN likewise.
    p_value: Float[np.ndarray, " 3"]

    @property
    def differs(self) -> list[bool]:
        """Whether x, y, γ differ, with a chance of 5 % for any false alarm among all pairs."""
        return (self.p_value < LEVEL).tolist()

    @property
    def verdict(self) -> str:
        """One sentence."""
        if np.isnan(self.p_value).any():
            return f"{self.second} against {self.first}: too few seconds to tell them apart"
        said = []
        for name, ratio, bounds, differs in zip(
            ("x", "y", "yaw"), self.ratio, self.interval.T, self.differs, strict=True
        ):
            if not differs:
                low, high = sorted(bounds, key=lambda end: abs(end - 1))
                said.append(f"{name}: no difference shown ({_change(low)} to {_change(high)})")
                continue
            low, high = sorted(100 * np.abs(bounds - 1))
            said.append(f"{name} {_change(ratio)} ({low:.1f} to {high:.1f} %)")
        if not any(self.differs):
            return f"{self.second} against {self.first}: no difference shown"
        return f"{self.second} against {self.first}: {', '.join(said)}"

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``interval_95`` of each ratio.
        """
        return super().to_json() | {"interval_95": known_intervals(self.interval)}


def _change(ratio: float) -> str:
    """Write how much smaller or larger an error is."""
    return f"{100 * abs(ratio - 1):.1f} % {'better' if ratio < 1 else 'worse'}"


def model_differences(
    names: Sequence[str], evaluations: Sequence[Evaluation]
) -> list[ModelDifference]:
    """Compare the errors of every pair of models at the horizon, from every start.

    Parameters
    ----------
    names : sequence of str
        Names of the models.
    evaluations : sequence of Evaluation
        Evaluations on the same recording, with the same protocol and encoder, as from `compare`.

    Returns
    -------
    list of ModelDifference
        One for each pair.
    """
    found = []
    for (name, one), (other_name, other) in combinations(zip(names, evaluations, strict=True), 2):
        first, second = one.every_start, other.every_start
        found.append(
            ModelDifference(name, other_name, *rmse_ratio(first.errors, second.errors, first.start))
        )
    if not found or np.isnan(found[0].p_value).any():
        return found
    adjusted = holm(np.concatenate([one.p_value for one in found])).reshape(-1, 3)
    return [replace(one, p_value=p) for one, p in zip(found, adjusted, strict=True)]
