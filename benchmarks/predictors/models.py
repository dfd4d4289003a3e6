"""Models of the craft's physics: airpuck's, and a plain fit by SciPy."""

from __future__ import annotations

from typing import Literal

import numpy as np

from airpuck import Loss, Model, Preparation, Trajectory, Vehicle, identify
from airpuck.data.windows import Windows, make_windows
from airpuck.estimate.encoder import PaperEncoder
from airpuck.evaluation.evaluate import hold_for, prediction_errors
from airpuck.model.model_file import published_model
from airpuck.model.rungs import named_rung

from ..peer import Peer
from . import Method, Predictor


def of_model(model: Model) -> Predictor:
    """Predict with a model file."""

    def predict(windows: Windows) -> np.ndarray:
        held = hold_for(model, windows)
        errors = prediction_errors(model.dynamics, held, PaperEncoder(model.indexing))[-1]
        return errors + windows.state[windows.present + windows.prediction_length, :3].T

    return Predictor(predict, int(model.free.sum()))


def published(name: str) -> Method:
    """Return a model with the paper's parameters, which learns nothing."""
    return lambda trajectory, vehicle: of_model(published_model(name))


def airpuck(
    rung: str | None, *, robust: bool = False, faults: Literal["exclude", "keep"] = "exclude"
) -> Method:
    """Return airpuck's fit of a rung; None chooses the structure."""

    def learn(trajectory: Trajectory, vehicle: Vehicle) -> Predictor:
        preparation = Preparation(faults=faults)
        loss = Loss(robust=robust)
        return of_model(
            identify(trajectory, rung, vehicle=vehicle, preparation=preparation, loss=loss).model
        )

    return learn


def scipy(*, robust: bool) -> Method:
    """Return a plain fit of M3 by `scipy.optimize.least_squares`."""

    def learn(trajectory: Trajectory, vehicle: Vehicle) -> Predictor:
        peer = _peer(make_windows([trajectory], 40, 50, 7), vehicle)
        theta = peer.fit(named_rung("M3").initial(vehicle).to_vector()).x
        if robust:
            scale = 1.4826 * float(np.median(np.abs(peer.residual(theta))))
            theta = peer.fit(theta, "soft_l1", scale).x

        def predict(windows: Windows) -> np.ndarray:
            end = windows.state[windows.present + windows.prediction_length, :3].T
            return _peer(windows, vehicle).errors(theta)[-1] + end

        return Predictor(predict, len(theta))

    return learn


def _peer(windows: Windows, vehicle: Vehicle) -> Peer:
    lengths = windows.encoder_length, windows.prediction_length
    return Peer(windows.time, windows.state, windows.input, windows.starts, *lengths, vehicle)
