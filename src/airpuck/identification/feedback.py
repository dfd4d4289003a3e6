"""What a fit's own errors do to the data that are prepared with it.

Packets are moved to when a model says that they arrived, and velocities are smoothed along it
(`airpuck.identification.retiming`). A model that is a little wrong prepares data that agree with
it a little too well: they hold less information than they seem to. As for any estimate in two
steps, the derivative of the scores with respect to what prepares the data belongs to the
information (Murphy and Topel, Journal of Business and Economic Statistics 3, 1985).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

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

#: Seconds of flight that say enough.
_ENOUGH = 120.0
#: Windows that begin within a window's length: what each says is noisy.
_DENSE = 3
#: Eigenvalue of the information, over the largest, below which a direction has none.
_BLIND = 1e-8
#: Step of the difference quotients, in standard errors: so small that packets move by a small part
#: of a sample.
_STEP = 0.1


@dataclass(frozen=True, eq=False)
class Feedback:
    """How scores follow the data that were prepared with an estimate."""

    #: M = ∂/∂θ' ∂L(θ; data prepared with θ')/∂θ.
    mixed: Float[np.ndarray, "P P"]
    #: Gauss-Newton Hessian H of the same windows.
    hessian: Float[np.ndarray, "P P"]
    #: How often the data were prepared anew.
    rounds: int

    def growth(self, basis: Float[np.ndarray, "P R"]) -> Float[np.ndarray, "R R"]:
        """Return what becomes of an error that goes round.

        An estimate from data that were prepared with the error e is off by K e, K = -H⁻¹ M, on top
        of an error of its own.
        """
        # A motor may stand all the time in that part of the recordings: nothing goes round then.
        inverse = np.linalg.pinv(basis.T @ self.hessian @ basis, rcond=_BLIND, hermitian=True)
        once = -inverse @ (basis.T @ self.mixed @ basis)
        total = np.eye(len(once))
        for _ in range(self.rounds):
            total = np.eye(len(once)) + once @ total
        return total


def preparation_feedback(
    loss: PredictionLoss,
    trajectories: Sequence[Trajectory],
    model: Model,
    delays: Sequence[PacketDelays],
    standard_errors: Float[np.ndarray, " P"],
    rounds: int,
) -> Feedback:
    """Differentiate the gradient of a loss with respect to what its data were prepared with."""
    windows = loss.windows
    ahead, past = windows.prediction_length, windows.encoder_length
    spread = spread_of(delays)
    parameters, vector = model.parameters, model.parameters.to_vector()
    moved = np.flatnonzero(standard_errors > 0)
    steps = _STEP * standard_errors[moved]
    models = [
        replace(model, parameters=parameters.with_vector(vector + step * np.eye(len(vector))[j]))
        for j, step in zip(moved, steps, strict=True)
    ]
    prepared = [
        _prepared(part, [model, *models], _within(part, own), spread)
        for part, own in zip(_parts(trajectories, past + ahead), delays, strict=True)
    ]
    found = []
    for variant in zip(*prepared, strict=True):
        some = make_windows(variant, past, ahead, max(1, (past + ahead) // _DENSE))
        sparse = replace(loss, windows=some, multiplicity=None, clusters=None)
        found.append(sparse.quadratic(parameters))
    gradients = np.array([one.gradient for one in found])
    mixed = np.zeros((len(vector), len(vector)))
    mixed[:, moved] = ((gradients[1:] - gradients[0]) / steps[:, None]).T
    return Feedback(mixed, found[0].hessian, rounds)


def _within(part: Trajectory, delays: PacketDelays) -> PacketDelays:
    """Return the packets that arrived during a part of a recording: others have no answer there."""
    arrival = part.command_time[delays.packet] + part.delay
    inside = (part.time[0] <= arrival) & (arrival <= part.time[-1])
    return PacketDelays(
        delays.packet[inside], delays.deviation[inside], delays.standard_error[inside]
    )


def _parts(trajectories: Sequence[Trajectory], length: int) -> list[Trajectory]:
    """Cut the middle out of long recordings, or of their longest stretch if it has no window."""
    total = sum(len(trajectory) * trajectory.sample_period for trajectory in trajectories)
    share = _ENOUGH / total
    if share >= 1:
        return list(trajectories)
    parts = []
    for trajectory in trajectories:
        part = trajectory.slice((1 - share) / 2, (1 + share) / 2)
        if not len(part.window_starts(length)):
            first, last = max(trajectory.segments, key=lambda segment: segment[1] - segment[0])
            part = trajectory.slice(first / len(trajectory), last / len(trajectory))
        parts.append(part)
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
