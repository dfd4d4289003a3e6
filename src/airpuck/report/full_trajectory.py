"""The loss over the whole recording, and why the paper predicts over short windows instead."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import hold_for
from airpuck.identification.fit import identify
from airpuck.identification.fit_result import Fit
from airpuck.identification.objective import PredictionLoss
from airpuck.model.model_file import Model
from airpuck.report.trial import Trial, judge


@dataclass(frozen=True, eq=False)
class Landscape:
    """The loss along one parameter, for one length of prediction."""

    #: Length of a prediction [s].
    horizon: float
    #: Predictions in the loss.
    windows: int
    #: The parameter, relative to its value in the batched optimum.
    factor: Float[np.ndarray, " K"]
    #: The loss there.
    loss: Float[np.ndarray, " K"]

    @property
    def minima(self) -> Float[np.ndarray, " M"]:
        """Factors at the local minima inside the range; as many as the sampling resolves."""
        inside = self.loss[1:-1]
        return self.factor[1:-1][(inside < self.loss[:-2]) & (inside < self.loss[2:])]

    def to_json(self) -> dict[str, Any]:
        """Return the figures."""
        return {
            "horizon_s": self.horizon,
            "windows": self.windows,
            "local_minima": len(self.minima),
            "factor": self.factor.tolist(),
            "loss": self.loss.tolist(),
        }


@dataclass(frozen=True, eq=False)
class FullTrajectory:
    """What becomes of the loss when predictions span the whole recording (eq. loss_full)."""

    #: The loss along the inertia of M3, from the shortest to the longest prediction.
    landscapes: tuple[Landscape, ...]
    #: Learned with short predictions.
    batched: Trial
    #: Learned with the full-trajectory loss, from the nominal values and from `batched`.
    nominal: Trial
    refined: Trial

    def to_json(self) -> dict[str, Any]:
        """Return the figures."""
        return {
            "landscapes": [landscape.to_json() for landscape in self.landscapes],
            "batched": self.batched.to_json(),
            "full_from_nominal": self.nominal.to_json(),
            "full_from_batched": self.refined.to_json(),
        }


def sample_landscapes(
    training: Trajectory,
    model: Model,
    *,
    horizons: Sequence[int | None] = (50, 500, 5000, None),
    span: float = 0.12,
    points: int = 121,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[Landscape, ...]:
    """Sample the loss along the inertia, all other parameters as they are."""
    encoder = PaperEncoder(indexing=model.indexing)
    factor = np.linspace(1 - span, 1 + span, points)
    landscapes = []
    for horizon in horizons:
        windows = hold_for(model, make_windows(training, encoder.length, horizon, horizon or 1))
        length = windows.prediction_length * training.sample_period
        say(f"side claim: loss landscape of predictions over {length:.1f} s")
        loss = PredictionLoss(windows, model.vehicle, encoder, frame=model.frame)
        values = []
        for inertia in factor * model.parameters.inertia:
            values.append(loss.quadratic(replace(model.parameters, inertia=inertia)).loss)
        landscapes.append(Landscape(length, len(windows), factor, np.array(values)))
    return tuple(landscapes)


def predict_whole_trajectory(
    training: Trajectory,
    validation: Trajectory,
    batched: Fit,
    *,
    say: Callable[[str], None] = lambda _: None,
) -> FullTrajectory:
    """Compare the batched loss with the loss over the whole recording.

    The paper: predicting over the whole dataset "can be rather non-smooth and sensitive to local
    minima", hence its batches. Here the loss is sampled along the inertia, and minimised from two
    starting points.
    """
    model = batched.model
    trials = []
    for label, initial in (
        ("full trajectory, from nominal values", None),
        ("full trajectory, from the batched optimum", model.parameters),
    ):
        say(f"side claim: {label}")
        fit = identify(training, model.name, initial=initial, prediction_length=None)
        trials.append(judge(label, fit, validation))
    return FullTrajectory(
        landscapes=sample_landscapes(training, model, say=say),
        batched=judge("batched", batched, validation),
        nominal=trials[0],
        refined=trials[1],
    )
