"""Fit of a model to a recording, in the measures of system identification.

Fit percentages of predictions and simulations (NRMSE), and information criteria from the Gaussian
likelihood of the one-step innovations (Ljung 1999, ch. 16.4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Result, plain
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import by_channel
from airpuck.evaluation.innovations import Innovations, free_run, innovations
from airpuck.model.model_file import Model

#: Length of restarted simulations [s].
RESTART = 2.0


@dataclass(frozen=True, eq=False)
class FitMeasures(Result):
    """Fit of one model to one trajectory."""

    JSON = "k=steps restart_s log_likelihood parameters samples aic bic"

    #: k of the k-step prediction [samples].
    steps: int
    #: Length of the restarted simulations [s].
    restart_s: ClassVar = RESTART
    #: Fit of x, y, γ, predicted k steps ahead by the filter's estimate [%].
    k_step: Float[np.ndarray, " 3"]
    #: Fit of simulations restarted every `restart_s` seconds [%].
    free_run: Float[np.ndarray, " 3"]
    #: Fit of one simulation over the whole trajectory [%].
    whole: Float[np.ndarray, " 3"]
    #: Log-likelihood of the innovations.
    log_likelihood: float
    #: Number of innovations, each with three channels.
    samples: int
    #: Number of fitted parameters: the model's determined ones, and the noise's.
    parameters: int

    @property
    def aic(self) -> float:
        """Akaike's criterion, 2 d − 2 log L; smaller is better, on the same recording only."""
        return 2 * self.parameters - 2 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Schwarz's criterion, d log N − 2 log L, with N poses."""
        return float(self.parameters * np.log(self.samples) - 2 * self.log_likelihood)

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``fit_percent``: ``k_step``, ``free_run``, ``whole``, each by channel: k samples
        ahead, simulated for `restart_s` at a time, simulated from start to end.
        """
        percent = {
            name: by_channel(getattr(self, name)) for name in ("k_step", "free_run", "whole")
        }
        return {"fit_percent": plain(percent), **super().to_json()}


def fit_percent(
    predicted: Float[np.ndarray, "N C"], measured: Float[np.ndarray, "N C"]
) -> Float[np.ndarray, " C"]:
    """Compute the normalised root mean square fit of each channel."""
    around = np.linalg.norm(measured - measured.mean(axis=0), axis=0)
    return 100 * (1 - np.linalg.norm(measured - predicted, axis=0) / around)


def fit_text(values: Float[np.ndarray, " C"]) -> list[str]:
    """Write fit percentages; values far below zero carry no further information."""
    return [f"{value:.1f}" if value >= 0 else "below 0" for value in values]


def measure_fit(
    model: Model,
    trajectory: Trajectory,
    *,
    filtered: Innovations | None = None,
    horizon: float = 0.2,
) -> FitMeasures:
    """Measure how well a model fits a trajectory.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        Measured poses and commands.
    filtered : Innovations, optional
        Innovations of the same model on the same trajectory, if known.
    horizon : float, default 0.2
        Time of the k-step prediction [s].

    Returns
    -------
    FitMeasures
        Fit percentages and information criteria.

    Raises
    ------
    InputError
        If the trajectory is of another craft, or too short.
    """
    filtered = filtered or innovations(model, trajectory)
    measured, samples = trajectory.state[:, :3], len(trajectory)
    steps = trajectory.steps(horizon)

    def simulate(apart: int) -> Float[np.ndarray, " 3"]:
        starts = filtered.starts(0, apart)
        if not len(starts):
            starts = np.flatnonzero(filtered.used)[-1:]
        simulated = free_run(model, trajectory, filtered, starts)
        judged = filtered.used & (np.arange(samples) > starts[0])
        return fit_percent(simulated[judged], measured[judged])

    def predict_ahead() -> Float[np.ndarray, " 3"]:
        first = [*filtered.starts(0, samples), np.flatnonzero(filtered.used)[-1]][0]
        starts = np.arange(first, samples - steps, steps + 1)
        starts = starts[filtered.used[starts] & filtered.used[starts + steps]]
        ends = starts + steps
        return fit_percent(free_run(model, trajectory, filtered, starts)[ends], measured[ends])

    return FitMeasures(
        steps=steps,
        k_step=predict_ahead(),
        free_run=simulate(trajectory.steps(RESTART, least=2)),
        whole=simulate(samples),
        log_likelihood=filtered.log_likelihood,
        samples=int(filtered.used.sum()),
        parameters=fitted_parameters(model) + sum(filtered.noise_parameters),
    )


def fitted_parameters(model: Model) -> int:
    """Count the parameters that were learned."""
    undetermined = 0 if model.uncertainty is None else len(model.uncertainty.undetermined)
    return int(model.free.sum()) - undetermined
