"""Errors of a fit."""

from dataclasses import replace

import numpy as np

from airpuck.model.model_file import published_model

MODEL = replace(published_model("M3"), indexing="start")


def off(fit):
    """Relative error of inertia, lag and thrust at half speed."""
    found, true = fit.model.parameters, MODEL.parameters
    half = [0.5, 0.25, 0.125]
    return np.abs(
        [
            found.inertia / true.inertia - 1,
            found.motor_time_constant / true.motor_time_constant - 1,
            *(found.thrust @ half / (true.thrust @ half) - 1),
        ]
    ).max()
