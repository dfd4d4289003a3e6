"""Craft, their models, and made-up results of fits."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from airpuck import Fit, Loss, Model, Trajectory, Vehicle
from airpuck.craft.vehicle import default_vehicle
from airpuck.identification.method import Iteration
from airpuck.identification.problem import prediction_loss
from airpuck.model.rungs import named_rung


def four_propellers() -> Vehicle:
    """One pair side by side, two propellers alone, no common radius."""
    return Vehicle.model_validate(
        {
            "name": "quad",
            "mass_kg": 0.2,
            "radius_m": 0.09,
            "command_min": 0.02,
            "pairs": [["front", "back"]],
            "propellers": [
                {"name": "front", "position_m": (0.06, 0.0), "direction_deg": 90},
                {"name": "left", "position_m": (0.0, 0.05), "direction_deg": 180},
                {"name": "back", "position_m": (-0.06, 0.0), "direction_deg": 270},
                {"name": "right", "position_m": (0.01, -0.06), "direction_deg": 0},
            ],
            "nominal": {"thrust_N": (0.03, 1.0, -0.4), "inertia_kg_m2": 5e-4},
        }
    )


VEHICLES = {"six": default_vehicle, "four": four_propellers}


def model_of(vehicle: Vehicle, name: str, factor: float = 1.0) -> Model:
    """A model of a rung at its nominal values, with thrusts scaled."""
    parameters = named_rung(name).initial(vehicle)
    parameters = replace(parameters, thrust=factor * parameters.thrust)
    fit = {"encoder_length": 20, "prediction_length": 50, "stride": 7, "weights": [1, 1, 0.1]}
    return Model(name, vehicle, parameters, named_rung(name).mask(parameters), fit=fit)


def scaled(model: Model, factor: float | Sequence[float] | np.ndarray) -> Model:
    """The model with stronger or weaker thrusts, all alike or each by a factor of its own."""
    thrust = np.reshape(factor, (-1, 1)) * np.asarray(model.parameters.thrust)
    return replace(model, parameters=replace(model.parameters, thrust=thrust))


def fit_of(model: Model, training: Trajectory | None = None) -> Fit:
    """Make up the result of a fit."""
    history = tuple(Iteration(k, 1e-4 * (1 + 2.0**-k)) for k in range(4))
    loss = None if training is None else prediction_loss(Loss(), [training], model.vehicle)
    found = history[-1].loss
    return Fit(model, found, history, True, "converged", 100, 0.1, (), objective=loss)


def random_scales(n: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(0.5, 2.0, n)
