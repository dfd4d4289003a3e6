"""Fits and numbers behind the paper's side claims."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck import Loss, Preparation, evaluate, identify, named_rung
from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import CHANNELS, hold_for
from airpuck.evaluation.presentation import physical_thrust
from airpuck.identification.fit_result import Fit
from airpuck.identification.method import LevenbergMarquardt
from airpuck.identification.objective import PredictionLoss
from airpuck.model.model_file import Model
from airpuck.physics.thrust import lowest_slope, thrust_slope

ALL_DATA = Preparation(faults="keep")


@dataclass(frozen=True, eq=False)
class Trial:
    """A fit, evaluated on the validation recording."""

    #: Description of the varied setting.
    label: str
    fit: Fit
    #: Root mean square error of x, y [m] and yaw [rad] after 0.2 s, protocol "paper".
    rmse: Float[np.ndarray, " 3"]

    def to_json(self) -> dict[str, Any]:
        """Return the figures."""
        slope, speed = lowest_slope(physical_thrust(self.fit.model))
        return {
            "label": self.label,
            "model": self.fit.model.name,
            "loss": self.fit.loss,
            "iterations": self.fit.iterations,
            "converged": self.fit.converged,
            "rmse": dict(zip(CHANNELS, self.rmse.tolist(), strict=True)),
            "lowest_slope_N": slope.tolist(),
            "at_speed": speed.tolist(),
        }


def judge(label: str, fit: Fit, validation: Trajectory) -> Trial:
    """Evaluate a fit on the validation recording, by the paper's protocol."""
    print(f"{label}: loss {fit.loss:.3e} after {fit.iterations} iterations", flush=True)
    return Trial(label, fit, evaluate(fit.model, validation).rmse)


def try_degrees(
    training: Trajectory, validation: Trajectory, degrees: Sequence[int] = (1, 2, 3, 4, 5)
) -> list[Trial]:
    """Fit M3 with thrust polynomials of several degrees.

    The paper: "We tested different polynomials up to degree five but found a 3rd-order polynomial
    works best for our system."
    """
    return [
        judge(
            f"degree {d}",
            identify(training, named_rung("M3", degree=d), preparation=ALL_DATA),
            validation,
        )
        for d in degrees
    ]


def drop_monotonicity(
    training: Trajectory,
    validation: Trajectory,
    cases: Sequence[tuple[str, int]] = (
        *((name, 3) for name in ("M0", "M1", "M2", "M3", "M4")),
        ("M3", 5),
    ),
) -> list[Trial]:
    """Fit without the condition that thrust rises with motor speed.

    The paper: "the obtained thrust profiles exhibit a non-monotonic behavior without the
    regularization term".
    """
    method = LevenbergMarquardt(monotone=False)
    trials = []
    for name, degree in cases:
        rung = named_rung(name, degree=degree)
        fit = identify(training, rung, method=method, preparation=ALL_DATA)
        trials.append(judge(f"{name}, degree {degree}", fit, validation))
    return trials


def fit_whole_trajectory(
    training: Trajectory, validation: Trajectory, batched: Fit
) -> dict[str, Trial]:
    """Fit one prediction over the whole recording (eq. loss_full), from two starting points.

    The paper: predicting over the whole dataset "can be rather non-smooth and sensitive to local
    minima", hence its batches.
    """
    trials = {"batched": judge("batched", batched, validation)}
    for name, label, initial in (
        ("full_from_nominal", "from nominal values", None),
        ("full_from_batched", "from the batched optimum", batched.model.parameters),
    ):
        whole = Loss(whole=True)
        fit = identify(training, batched.model.name, initial=initial, loss=whole)
        trials[name] = judge(f"full trajectory, {label}", fit, validation)
    return trials


# Numbers ------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Landscape:
    """The loss along one parameter, for one length of prediction."""

    #: Length of a prediction [s].
    horizon: float
    #: Predictions in the loss.
    windows: int
    #: The parameter, relative to its value in the batched optimum.
    factor: Float[np.ndarray, " K"]
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


def sample_landscapes(
    training: Trajectory,
    model: Model,
    *,
    horizons: Sequence[int | None] = (50, 500, 5000, None),
    span: float = 0.12,
    points: int = 121,
) -> list[Landscape]:
    """Sample the loss along the inertia, with all other parameters fixed."""
    encoder = PaperEncoder(indexing=model.indexing)
    factor = np.linspace(1 - span, 1 + span, points)
    landscapes = []
    for horizon in horizons:
        windows = hold_for(model, make_windows(training, 20, horizon, horizon or 1))
        length = windows.prediction_length * training.sample_period
        print(f"loss landscape of predictions over {length:.1f} s", flush=True)
        loss = PredictionLoss(windows, model.vehicle, encoder, frame=model.frame)
        values = [
            loss.quadratic(replace(model.parameters, inertia=inertia)).loss
            for inertia in factor * model.parameters.inertia
        ]
        landscapes.append(Landscape(length, len(windows), factor, np.array(values)))
    return landscapes


def largest_thrusts(m3: Model, m4: Model) -> dict[str, Float[np.ndarray, " n"]]:
    """Compute the thrust at φ = 1 of M3, of M4 as learned, and of M4 at the physical scale [N].

    The paper: "the max thrust predicted by M4 is considerably larger than that of M3, suggesting
    that the configuration matrix Π is compensating". Nothing observable fixes the scale of M4's
    thrusts; `airpuck.evaluation.presentation` explains how it is fixed here.
    """
    return {
        "M3_N": physical_thrust(m3).sum(axis=1),
        "M4_as_learned_N": np.asarray(m4.parameters.thrust).sum(axis=1),
        "M4_scaled_N": physical_thrust(m4).sum(axis=1),
    }


def falling_share(coefficients: Float[np.ndarray, "n degree"]) -> Float[np.ndarray, " n"]:
    """Return the fraction of [0, 1] on which each thrust curve falls."""
    speed = np.tile(np.linspace(0, 1, 1001), (len(coefficients), 1))
    return np.mean(thrust_slope(coefficients, speed) < 0, axis=1)
