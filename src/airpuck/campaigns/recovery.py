"""Is the truth found again? An excitation flight on the twin, identified and compared."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, ClassVar

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck.campaigns.item import Item, Row, Rung, Spread, TwinTable, varied
from airpuck.control.tuning import default_tuning
from airpuck.identification.fit import identify
from airpuck.model.model_file import Model, read_model
from airpuck.physics.thrust import thrust
from airpuck.preprocessing.pipeline import preprocess
from airpuck.twin.experiments import excite
from airpuck.twin.radio import as_received
from airpuck.twin.settings import default_twin_settings

#: Speeds over which thrust curves are compared.
SPEEDS = np.linspace(0.03, 1, 200)


class Recovery(Item):
    """One excitation flight, identified."""

    SOURCES: ClassVar = ("truth",)

    #: The twin's truth; its centre of mass is fixed to the body.
    truth: str = "paper:M3"
    #: By how much the truth differs from that, at random (`varied`).
    truth_spread: Spread = 0.0
    #: What is identified.
    model: Rung = "M3"
    #: Of the excitation.
    duration_s: Annotated[float, pydantic.Field(gt=0)] = 90.0
    amplitude: Annotated[float, pydantic.Field(gt=0, le=1)] = 1.0
    hold_s: Annotated[float, pydantic.Field(gt=0)] = 0.2
    #: Samples from one window to the next.
    stride: Annotated[int, pydantic.Field(ge=1)] = 7
    #: Whether windows that are predicted badly count less.
    robust: bool = False
    #: Table, sensors, radio, faults.
    twin: TwinTable = pydantic.Field(default_factory=default_twin_settings)

    def run(self) -> list[Row]:
        """Fly, identify, compare; see `Item.run`."""
        truth = varied(read_model(self.truth), self.truth_spread, self.seed)
        truth = replace(truth, frame="body", indexing="start")
        recording = excite(
            truth,
            self.duration_s,
            self.seed,
            amplitude=self.amplitude,
            hold=self.hold_s,
            settings=self.twin,
        )
        trajectory = preprocess(recording, truth.vehicle)
        fit = identify(
            trajectory, self.model, vehicle=truth.vehicle, stride=self.stride, robust=self.robust
        )
        delay = as_received(truth, self.twin, default_tuning().period_s).transport_delay
        return [
            {
                **recovery_errors(fit.model, truth),
                "delay_s": fit.model.transport_delay - delay,
                "loss": fit.loss,
                "iterations": float(fit.iterations),
                "converged": float(fit.converged),
            }
        ]


def thrust_error(model: Model, truth: Model) -> Float[np.ndarray, " n"]:
    """Compare thrust curves."""
    speeds = np.tile(SPEEDS, (len(truth.parameters.thrust), 1))
    found, true = (thrust(m.dynamics.thrust, speeds) for m in (model, truth))
    return np.sqrt(np.mean((found - true) ** 2, axis=1) / np.mean(true**2, axis=1))


def recovery_errors(model: Model, truth: Model) -> Row:
    """Compare an identified model with the truth."""
    found, true = model.parameters, truth.parameters
    return {
        "thrust": float(thrust_error(model, truth).max()),
        "motor_time_constant": float(found.motor_time_constant / true.motor_time_constant - 1),
        "inertia": float(found.inertia / true.inertia - 1),
        "angle_offset_rad": float(found.angle_offset - true.angle_offset),
        "center_of_mass_m": float(np.linalg.norm(found.center_of_mass - true.center_of_mass)),
    }
