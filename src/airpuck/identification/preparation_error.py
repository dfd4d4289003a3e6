"""How an error of the parameters grows through the data that are prepared with them.

Packets are moved to when a model says that they arrived, and velocities are smoothed along it
(`airpuck.identification.retiming`). A model that is a little wrong prepares data that agree with
it a little too well: they hold less information than they seem to. As for any estimate in two
steps, the derivative of the scores with respect to what prepares the data belongs to the
information (Murphy and Topel, Journal of Business and Economic Statistics 3, 1985). Without it,
95 % intervals hold the truth in 92 % of all cases (docs/results.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import make_windows
from airpuck.identification.objective import PredictionLoss
from airpuck.identification.packet_delays import PacketDelays, delay_response
from airpuck.identification.retiming import (
    modelled_acceleration,
    retimed,
    smoothed_along,
    spread_of,
)
from airpuck.model.model_file import Model

#: Windows that begin within one window's length; few suffice, since their scores are alike.
_DENSITY = 3
#: Eigenvalue of the information, relative to the largest, below which a direction has none.
_UNINFORMED = 1e-8
#: Step of the difference quotients, in standard errors: small enough that packets move by a small
#: part of a sample.
_STEP = 0.1


def error_growth(
    mixed: Float[np.ndarray, "P P"],
    hessian: Float[np.ndarray, "P P"],
    basis: Float[np.ndarray, "P R"],
    rounds: int,
) -> Float[np.ndarray, "P P"]:
    """Return the factor 1 + K + K² + … of errors in data that were prepared so many times.

    An estimate from data that were prepared with the error e is off by K e, K = -H⁻¹ M, beside an
    error of its own. Columns of `basis` are the directions in which it can vary.
    """
    inverse = np.linalg.pinv(basis.T @ hessian @ basis, rcond=_UNINFORMED, hermitian=True)
    once = -basis @ inverse @ basis.T @ mixed
    total = np.eye(len(once))
    for _ in range(rounds):
        total = np.eye(len(once)) + once @ total
    return total


def score_derivatives(
    loss: PredictionLoss,
    trajectories: Sequence[Trajectory],
    model: Model,
    packets: Sequence[PacketDelays],
    standard_errors: Float[np.ndarray, " P"],
) -> tuple[Float[np.ndarray, "P P"], Float[np.ndarray, "P P"]]:
    """Return M and H: how the gradient follows the parameters that prepare its data, and θ itself.

    M = ∂/∂θ' ∂L(θ; data prepared with θ')/∂θ by difference quotients, on a part of the windows; H
    is the Gauss-Newton Hessian on the same.
    """
    parameters, vector = model.parameters, model.parameters.to_vector()
    moved = np.flatnonzero(standard_errors > 0)
    steps = _STEP * standard_errors[moved]
    models = [
        replace(model, parameters=parameters.with_vector(vector + step * np.eye(len(vector))[j]))
        for j, step in zip(moved, steps, strict=True)
    ]
    spread = spread_of(packets)
    prepared = [
        _prepared(trajectory, [model, *models], delays, spread)
        for trajectory, delays in zip(trajectories, packets, strict=True)
    ]
    past, ahead = loss.windows.encoder_length, loss.windows.prediction_length
    found = []
    for variant in zip(*prepared, strict=True):
        windows = make_windows(variant, past, ahead, max(1, (past + ahead) // _DENSITY))
        sparse = replace(loss, windows=windows, multiplicity=None, clusters=None)
        found.append(sparse.quadratic(parameters))
    gradients = np.array([quadratic.gradient for quadratic in found])
    mixed = np.zeros((len(vector), len(vector)))
    mixed[:, moved] = ((gradients[1:] - gradients[0]) / steps[:, None]).T
    return mixed, found[0].hessian


def _prepared(
    trajectory: Trajectory, models: Sequence[Model], delays: PacketDelays, jitter: float
) -> list[Trajectory]:
    """Prepare a recording with the first model, and to first order with those close to it."""
    arrived = retimed(trajectory, delays, jitter)
    modelled = np.array([modelled_acceleration(arrived, model) for model in models])
    later = delay_response(trajectory, models[0], delays, modelled - modelled[0])
    return [
        smoothed_along(
            retimed(trajectory, replace(delays, deviation=delays.deviation + late), jitter), model
        )
        for model, late in zip(models, later, strict=True)
    ]
