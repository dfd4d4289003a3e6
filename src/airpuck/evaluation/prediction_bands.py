"""Where the craft should be, and how sure a model is of it: predictions with 95 % bands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import CHANNELS
from airpuck.evaluation.goodness import RESTART, SETTLE
from airpuck.evaluation.innovations import Innovations, innovations
from airpuck.evaluation.prediction_covariance import predict_with_errors
from airpuck.model.model_file import Model

#: 97.5 % quantile of the normal distribution: half of a 95 % band, in standard deviations.
BAND = 1.959963984540054
#: What is shown of a recording: the paper's horizon, and a simulation [s].
HORIZONS = (0.2, RESTART)


@dataclass(frozen=True, eq=False)
class PredictionBands:
    """Predictions of W windows over T samples, with 95 % bands.

    Attributes
    ----------
    model : str
        Name of the rung.
    start : array, shape (W,)
        When each prediction starts [s].
    time : array, shape (T, W)
        Times predicted [s].
    predicted, measured : array, shape (T, 3, W)
        x, y [m], γ [rad].
    by_parameters : array, shape (T, 3, W), or None
        Half the band from what is not known of the parameters: quantile of Student's t times the
        standard error. None where the model has no uncertainty; nan where the prediction depends on
        what the data did not determine.
    total : array, shape (T, 3, W)
        Half the band that measured poses should keep to: that, and 1.96 standard deviations of what
        the model does not explain, of the state at the start, and of the measured pose, as root of
        the sum of squares.
    """

    model: str
    start: Float[np.ndarray, " W"]
    time: Float[np.ndarray, "T W"]
    predicted: Float[np.ndarray, "T 3 W"]
    measured: Float[np.ndarray, "T 3 W"]
    by_parameters: Float[np.ndarray, "T 3 W"] | None
    total: Float[np.ndarray, "T 3 W"]

    @property
    def horizon(self) -> float:
        """Longest time predicted, mean of the windows [s]."""
        return float(np.mean(self.time[-1] - self.start))

    @property
    def covered(self) -> Bool[np.ndarray, "T 3 W"]:
        """Where the measured pose is within the total band."""
        return np.abs(self.measured - self.predicted) <= self.total

    @property
    def coverage(self) -> Float[np.ndarray, " 3"]:
        """Share of the windows whose pose at the horizon is within its total band [%].

        Of those whose band is known.
        """
        known = np.isfinite(self.total[-1]).sum(axis=1)
        share = np.full(3, np.nan)
        return np.divide(100.0 * self.covered[-1].sum(axis=1), known, out=share, where=known > 0)

    def to_json(self) -> dict[str, Any]:
        """Return the figures at the horizon.

        Returns
        -------
        dict
            ``horizon_s, windows, coverage_percent``, and medians over the windows of half the
            bands: ``half_band``, and ``half_band_parameters`` or None.
        """

        def named(values: Float[np.ndarray, " 3"]) -> dict[str, float]:
            return dict(zip(CHANNELS, values.tolist(), strict=True))

        by_parameters = self.by_parameters
        return {
            "horizon_s": self.horizon,
            "windows": len(self.start),
            "coverage_percent": named(self.coverage),
            "half_band": named(np.median(self.total[-1], axis=1)),
            "half_band_parameters": None
            if by_parameters is None
            else named(np.median(by_parameters[-1], axis=1)),
        }


def prediction_bands(
    model: Model,
    trajectory: Trajectory,
    *,
    horizon: float = 0.2,
    starts: Int[np.ndarray, " W"] | None = None,
    known: Innovations | None = None,
) -> PredictionBands:
    """Predict windows of a trajectory with 95 % bands.

    Predictions start from the estimates of the filter behind the one-step innovations, which hears
    every pose up to the start and none after it, and go on with the commands. Errors are propagated
    linearly: where the band of yaw is wider than about a radian, those of x and y tell an order of
    magnitude only.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        Measured poses, and commands.
    horizon : float, default 0.2
        How far to predict [s].
    starts : array of int, shape (W,), optional
        Samples to start from; by default one after the other without overlap, wherever poses were
        heard for a quarter of a second before, and all poses to be predicted are usable.
    known : Innovations, optional
        Of the same model, if they are there already; with the noise of another recording, for
        example.

    Returns
    -------
    PredictionBands
        Predictions and bands.

    Raises
    ------
    InputError
        If the trajectory is of another craft, or no window fits.
    """
    if known is None:
        known = innovations(model, trajectory)
    steps = max(1, round(horizon / trajectory.sample_period))
    if starts is None:
        starts = _starts(known, trajectory.sample_period, horizon)
    if len(starts) == 0 or starts.min() < 0 or starts.max() + steps >= len(trajectory):
        raise InputError(
            f"has no usable stretch that is long enough to predict {horizon:g} s",
            file=trajectory.source,
        )
    uncertainty = model.uncertainty
    entries = np.zeros(len(model.free), dtype=bool) if uncertainty is None else uncertainty.moved
    predicted, variance, sensitivity = predict_with_errors(
        model, trajectory, known, starts, steps, entries
    )
    variance = variance + np.square(known.noise.pose)[:, None]
    squares, by_parameters = BAND**2 * variance, None
    if uncertainty is not None:
        gradient = np.zeros((len(entries), predicted.size))
        gradient[entries] = sensitivity.reshape(predicted.size, -1).T
        error = uncertainty.errors_along(gradient).reshape(predicted.shape)
        by_parameters = uncertainty.quantile * error
        squares = squares + by_parameters**2
    ahead = starts + np.arange(1, steps + 1)[:, None]
    return PredictionBands(
        model=model.name,
        start=trajectory.time[starts],
        time=trajectory.time[ahead],
        predicted=predicted,
        measured=np.moveaxis(trajectory.state[ahead, :3], 2, 1),
        by_parameters=by_parameters,
        total=np.sqrt(squares),
    )


def bands_of_all_horizons(
    model: Model, trajectory: Trajectory, known: Innovations
) -> tuple[PredictionBands, ...]:
    """Predict over each of `HORIZONS` for which the recording has a stretch that is long enough."""
    found = []
    for horizon in HORIZONS:
        starts = _starts(known, trajectory.sample_period, horizon)
        if len(starts):
            given = {"horizon": horizon, "starts": starts, "known": known}
            found.append(prediction_bands(model, trajectory, **given))
    return tuple(found)


def _starts(known: Innovations, period: float, horizon: float) -> Int[np.ndarray, " W"]:
    """Return where predictions start that do not overlap and touch nothing unusable."""
    settle, steps = max(2, round(SETTLE / period)), max(1, round(horizon / period))
    length = settle + steps
    runs = np.convolve(known.used, np.ones(length))[length - 1 : len(known.used)] >= length
    free, starts = 0, []
    for first in np.flatnonzero(runs).tolist():
        if first + settle - 1 >= free:
            starts.append(first + settle - 1)
            free = starts[-1] + steps
    return np.array(starts, dtype=int)
