"""One fit of a side claim, and how well it predicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import CHANNELS, evaluate
from airpuck.evaluation.gauge import physical_thrust
from airpuck.identification.fit_result import Fit
from airpuck.physics.thrust import lowest_slope


@dataclass(frozen=True, eq=False)
class Trial:
    """One fit of a side claim, judged on the validation experiment."""

    #: What was varied.
    label: str
    #: The fit.
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
    """Evaluate a fit on the validation experiment, by the paper's protocol."""
    return Trial(label, fit, evaluate(fit.model, validation).rmse)
