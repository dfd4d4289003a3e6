"""Tests of whether two models' predictions of one recording differ significantly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Result
from airpuck.deviation.significance import holm
from airpuck.evaluation.evaluate import Evaluation, known_intervals
from airpuck.evaluation.statistical_tests import rmse_ratio

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
