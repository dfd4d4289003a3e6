"""A recurrent neural network of the accelerations in the craft's frame, learned by jax-sysid."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from airpuck import InputError, Trajectory, Vehicle
from airpuck.data.windows import Windows, make_windows

from . import Predictor
from .subspace import STEP, moved, sequences

#: Hidden states, and units of the two hidden layers.
_STATES, _UNITS = 10, 12
#: The Python that has jax-sysid, which needs an older JAX: `pip install jax-sysid==1.1.0`.
PYTHON = "JAX_SYSID_PYTHON"


def jax_sysid(trajectory: Trajectory, vehicle: Vehicle) -> Predictor:
    """Learn a nonlinear state-space model: linear parts, and networks of one hidden layer.

    Inputs, outputs and integration are those of the subspace model. As the states follow from the
    commands alone, a prediction runs through those of the past first.
    """
    if PYTHON not in os.environ:
        raise InputError(f"set {PYTHON} to a Python with jax-sysid==1.1.0, or choose --methods")
    y, u = (part[:, 0] for part in sequences(make_windows([trajectory], 2, 2 * STEP, STEP), 0, 1))
    mean_y, mean_u, scale_y, scale_u = y.mean(axis=0), u.mean(axis=0), y.std(axis=0), u.std(axis=0)
    with TemporaryDirectory() as folder:
        data, model = Path(folder, "data.npz"), Path(folder, "model.npz")
        np.savez(
            data,
            y=(y - mean_y) / scale_y,
            u=(u - mean_u) / scale_u,
            states=_STATES,
            units=_UNITS,
        )
        script = Path(__file__).with_name("recurrent_fit.py")
        call = [os.environ[PYTHON], str(script), str(data), str(model)]
        subprocess.run(call, check=True, stdout=subprocess.DEVNULL)
        weights = list(np.load(model).values())
    a, b, w1, w2, w3, b1, c, d, w4, b3, w5, b4 = weights

    def predict(windows: Windows) -> np.ndarray:
        past, ahead = (windows.encoder_length - 1) // STEP, windows.prediction_length // STEP
        _, u = sequences(windows, windows.encoder_length - 1 - past * STEP, past + ahead)
        x, outputs = np.zeros((len(u), _STATES)), []
        for now in np.moveaxis((u - mean_u) / scale_u, 1, 0):
            hidden = np.tanh(x @ w4.T + b3)
            outputs.append((x @ c.T + now @ d.T + hidden @ w5.T + b4) * scale_y + mean_y)
            x = x @ a.T + now @ b.T + np.tanh(x @ w1.T + now @ w2.T + b1) @ w3.T
        return moved(windows, outputs[past:])

    return Predictor(predict, sum(part.size for part in weights))
