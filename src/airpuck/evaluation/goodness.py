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
    """Fit of one model to one trajectory.

    Attributes
    ----------
    steps : int
        k of the k-step prediction [samples].
    k_step : array, shape (3,)
        Fit of x, y, γ, predicted k steps ahead by the filter's estimate [%].
    free_run : array, shape (3,)
        Fit of simulations that start anew every `restart` seconds [%].
    whole : array, shape (3,)
        Fit of one simulation over the whole trajectory [%].
    restart : float
        Length of the restarted simulations [s].
    log_likelihood : float
        Of the innovations.
    samples : int
        Innovations of three channels each.
    parameters : int
        Parameters that were fitted: those of the model that the data determine, and of the noise.
    """

    steps: int
    k_step: Float[np.ndarray, " 3"]
    free_run: Float[np.ndarray, " 3"]
    whole: Float[np.ndarray, " 3"]
    restart: float
    log_likelihood: float
    samples: int
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
        """Return the figures.

        Returns
        -------
        dict
            ``fit_percent`` with ``k_step``, ``free_run`` and ``whole`` by channel, ``k``,
            ``restart_s``, ``log_likelihood, parameters, samples, aic, bic``.
        """

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
    """Compute the normalised root mean square fit of each channel.

    Parameters
    ----------
    predicted, measured : array, shape (N, C)
        The signals.

    Returns
    -------
    array, shape (C,)
        100 (1 − ‖y − ŷ‖ / ‖y − mean y‖) [%]: 100 for a perfect model, 0 for one that knows no more
        than the mean, and less for a worse one.
    """
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
    """Count the parameters that were learned.

    Parameters
    ----------
    model : Model
        The model.

    Returns
    -------
    int
        Free ones less the directions that the data did not determine, such as the six scales of M4.
    """
    undetermined = 0 if model.uncertainty is None else len(model.uncertainty.undetermined)
    return int(model.free.sum()) - undetermined


def simulation_starts(
    known: Innovations, period: float, length: int | None
) -> Int[np.ndarray, " M"]:
    """Choose where simulations start.

    Parameters
    ----------
    known : Innovations
        Say what is usable.
    period : float
        Sample period [s].
    length : int, optional
        Samples from one start to the next; by default there is one start only.

    Returns
    -------
    array of int, shape (M,)
        Samples by which the filter has heard poses for a quarter of a second without a break.
    """
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
