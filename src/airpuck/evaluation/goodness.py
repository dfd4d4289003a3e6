"""How well a model fits a recording, in the measures of system identification.

Fit percentages of predictions and simulations (NRMSE), and information criteria from the Gaussian
likelihood of the one-step innovations (Ljung 1999, ch. 16.4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import CHANNELS
from airpuck.evaluation.innovations import Innovations, free_run, innovations
from airpuck.model.model_file import Model

#: Length of the simulations that start anew [s]; poses before each, to know the speed from [s].
RESTART, SETTLE = 2.0, 0.25


@dataclass(frozen=True, eq=False)
class Goodness:
    """Fit of one model to one trajectory."""

    #: k of the k-step prediction [samples].
    steps: int
    #: Fit of x, y, γ, predicted k steps ahead by the filter's estimate [%].
    k_step: Float[np.ndarray, " 3"]
    #: Fit of simulations that start anew every `restart` seconds [%].
    free_run: Float[np.ndarray, " 3"]
    #: Fit of one simulation over the whole trajectory [%].
    whole: Float[np.ndarray, " 3"]
    #: Length of the restarted simulations [s].
    restart: float
    #: Of the innovations.
    log_likelihood: float
    #: Innovations of three channels each.
    samples: int
    #: Parameters that were fitted: those of the model that the data determine, and of the noise.
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
        """Return the figures."""

        def named(values: Float[np.ndarray, " 3"]) -> dict[str, float]:
            return dict(zip(CHANNELS, values.tolist(), strict=True))

        return {
            "fit_percent": {
                "k_step": named(self.k_step),
                "free_run": named(self.free_run),
                "whole": named(self.whole),
            },
            "k": self.steps,
            "restart_s": self.restart,
            "log_likelihood": self.log_likelihood,
            "parameters": self.parameters,
            "samples": self.samples,
            "aic": self.aic,
            "bic": self.bic,
        }


def fit_percent(
    predicted: Float[np.ndarray, "N C"], measured: Float[np.ndarray, "N C"]
) -> Float[np.ndarray, " C"]:
    """Compute the normalised root mean square fit of each channel."""
    around = np.linalg.norm(measured - measured.mean(axis=0), axis=0)
    return 100 * (1 - np.linalg.norm(measured - predicted, axis=0) / around)


def goodness(
    model: Model,
    trajectory: Trajectory,
    *,
    known: Innovations | None = None,
    horizon: float = 0.2,
    restart: float = RESTART,
) -> Goodness:
    """Measure how well a model fits a trajectory.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        Measured poses and commands.
    known : Innovations, optional
        Of the same model on the same trajectory, if they are there already.
    horizon : float, default 0.2
        Time of the k-step prediction [s].
    restart : float, default 2
        Length of the restarted simulations [s].

    Returns
    -------
    Goodness
        Fit percentages and information criteria.

    Raises
    ------
    InputError
        If the trajectory is of another craft, or too short.
    """
    known = known or innovations(model, trajectory)
    steps = max(1, round(horizon / trajectory.sample_period))

    def simulate(length: int | None) -> Float[np.ndarray, " 3"]:
        starts = simulation_starts(known, trajectory.sample_period, length)
        simulated = free_run(model, trajectory, known, starts)
        judged = known.used & (np.arange(len(trajectory)) > starts[0])
        return fit_percent(simulated[judged], trajectory.state[judged, :3])

    def predict_ahead() -> Float[np.ndarray, " 3"]:
        first = int(simulation_starts(known, trajectory.sample_period, None)[0])
        starts = np.arange(first, len(trajectory) - steps, steps + 1)
        starts = starts[known.used[starts] & known.used[starts + steps]]
        predicted, ends = free_run(model, trajectory, known, starts), starts + steps
        return fit_percent(predicted[ends], trajectory.state[ends, :3])

    return Goodness(
        steps=steps,
        k_step=predict_ahead(),
        free_run=simulate(max(2, round(restart / trajectory.sample_period))),
        whole=simulate(None),
        restart=restart,
        log_likelihood=known.log_likelihood,
        samples=int(known.used.sum()),
        parameters=fitted_parameters(model) + sum(known.noise_parameters),
    )


def fitted_parameters(model: Model) -> int:
    """Count the parameters that were learned."""
    undetermined = 0 if model.uncertainty is None else len(model.uncertainty.undetermined)
    return int(model.free.sum()) - undetermined


def simulation_starts(
    known: Innovations, period: float, length: int | None
) -> Int[np.ndarray, " M"]:
    """Choose where simulations start."""
    settle = max(2, round(SETTLE / period))
    quiet = np.convolve(known.used, np.ones(settle))[: len(known.used)] >= settle
    able = np.flatnonzero(quiet)
    if not len(able):
        able = np.flatnonzero(known.used)[-1:]
    if length is None:
        return able[:1]
    starts = [int(able[0])]
    while (later := able[able >= starts[-1] + length]).size:
        starts.append(int(later[0]))
    return np.array(starts)
