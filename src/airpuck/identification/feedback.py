"""What a fit's own errors do to the data that are prepared with it.

Packets are moved to when a model says that they arrived, and velocities are smoothed along it
(`airpuck.identification.refinement`). A model that is a little wrong prepares data that agree with
it a little too well: they hold less information than they seem to. As for any estimate in two
steps, the derivative of the scores with respect to what prepares the data belongs to the
information (Murphy and Topel, Journal of Business and Economic Statistics 3, 1985).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from airpuck.identification.delay_jitter import delay_jitter
from airpuck.identification.objective import PredictionLoss
from airpuck.identification.packet_delays import PacketDelays, delay_response
from airpuck.identification.refinement import modelled_acceleration, retimed, smoothed_along
from airpuck.model_file import Model
from airpuck.trajectory import Trajectory
from airpuck.windows import make_windows

#: Seconds of flight that say enough.
_ENOUGH = 120.0
#: Step of the difference quotients, in standard errors: so small that packets move by a small part
#: of a sample.
_STEP = 0.1


def preparation_feedback(
    loss: PredictionLoss,
    trajectories: Sequence[Trajectory],
    model: Model,
    delays: Sequence[PacketDelays],
    standard_errors: Float[np.ndarray, " P"],
) -> Float[np.ndarray, "P P"]:
    """Differentiate the gradient of a loss with respect to what its data were prepared with.

    Parameters
    ----------
    loss : PredictionLoss
        On prepared data.
    trajectories : sequence of Trajectory
        The recordings before that.
    model : Model
        The estimate θ.
    delays : sequence of PacketDelays
        Of each recording.
    standard_errors : array, shape (P,)
        Of the parameters, for the size of steps; nan for those that are left out.

    Returns
    -------
    array, shape (P, P)
        M = ∂/∂θ' ∂L(θ; data prepared with θ')/∂θ at θ' = θ, from windows that overlap by
        half, of two minutes at most; columns of parameters that are left out are zero.
    """
    windows = loss.windows
    length = windows.encoder_length + windows.prediction_length
    trajectories = _parts(trajectories, length)
    jitter = delay_jitter(delays)
    spread = jitter.standard_deviation_s if jitter else 0.0
    parameters, vector = model.parameters, model.parameters.to_vector()
    moved = np.flatnonzero(standard_errors > 0)
    steps = _STEP * standard_errors[moved]
    models = [
        replace(model, parameters=parameters.with_vector(vector + step * np.eye(len(vector))[j]))
        for j, step in zip(moved, steps, strict=True)
    ]
    prepared = [
        _prepared(trajectory, [model, *models], own, spread)
        for trajectory, own in zip(trajectories, delays, strict=True)
    ]
    gradients = []
    for variant in zip(*prepared, strict=True):
        some = make_windows(
            variant, windows.encoder_length, windows.prediction_length, max(1, length // 2)
        )
        sparse = replace(loss, windows=some, multiplicity=None, clusters=None)
        gradients.append(sparse.quadratic(parameters).gradient)
    feedback = np.zeros((len(vector), len(vector)))
    feedback[:, moved] = ((np.array(gradients[1:]) - gradients[0]) / steps[:, None]).T
    return feedback


def _parts(trajectories: Sequence[Trajectory], length: int) -> list[Trajectory]:
    """Cut the middle out of the longest stretches of recordings, where they are long."""
    total = sum(len(trajectory) * trajectory.sample_period for trajectory in trajectories)
    share, parts = min(1.0, _ENOUGH / total), []
    for trajectory in trajectories:
        if share < 1:
            first, last = max(trajectory.segments, key=lambda segment: segment[1] - segment[0])
            reach = max(share * len(trajectory), 2 * length) / 2
            middle, count = (first + last) / 2, len(trajectory)
            ends = max(first, middle - reach) / count, min(last, middle + reach) / count
            trajectory = trajectory.slice(*ends)
        parts.append(trajectory)
    return parts


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
