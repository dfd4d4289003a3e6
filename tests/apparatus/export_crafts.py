"""Craft of every sort that an export meets."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from airpuck.craft.vehicle import Vehicle, read_vehicle
from airpuck.model.model_file import Model, nominal_model, published_model

EXAMPLES = Path(__file__).parents[2] / "examples"
#: The published models; M0 and M1 without motor lag.
PAPER = {name: published_model(name) for name in ("M0", "M1", "M2", "M3", "M4")}
#: One model for each effect.
EFFECTS: dict[str, Model] = {
    name: replace(PAPER["M3"], parameters=replace(PAPER["M3"].parameters, **{name: value}))
    for name, value in {
        "drag": np.array([0.1, 0.2, 0.3, 0.01]),
        "inflow": 0.1,
        "pair_interaction": 4.0,
        "voltage_sag": 0.2,
        "tilt": np.array([1e-3, -2e-3]),
        "idle_lag": 0.8,
    }.items()
}
#: The effect of the place on the table, which most exports cannot represent.
DISH = replace(
    PAPER["M4"], parameters=replace(PAPER["M4"].parameters, dish=np.array([2e-3, -1e-3, 3e-3]))
)
ALL_EFFECTS = replace(
    PAPER["M4"],
    parameters=replace(
        PAPER["M4"].parameters,
        **{name: getattr(model.parameters, name) for name, model in EFFECTS.items()},
    ),
)
FOUR = nominal_model(read_vehicle(EXAMPLES / "four_propellers/vehicle.toml"))
ON_OFF = nominal_model(read_vehicle(EXAMPLES / "free_flyers/atmos.toml"))
_FOUR = FOUR.vehicle.model_dump() | {"pairs": ()}
#: Four reversible propellers: eight ways to push, with a command each.
REVERSIBLE = nominal_model(
    Vehicle.model_validate(
        _FOUR | {"propellers": [one | {"reverse": 0.6} for one in _FOUR["propellers"]]}
    )
)
#: The craft that an export of the equations of motion holds.
HELD = {
    **PAPER,
    **EFFECTS,
    "all effects": ALL_EFFECTS,
    "four": FOUR,
    "on/off": ON_OFF,
    "reversible": REVERSIBLE,
}
_WHEEL = {"name": "wheel", "torque_Nm": 0.01, "inertia_kg_m2": 1e-5, "max_speed_rad_s": 600.0}
WHEELED = nominal_model(Vehicle.model_validate(_FOUR | {"wheels": [_WHEEL]}))


def random_states(model: Model, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return states and commands, one for each row."""
    random, n = np.random.default_rng(seed), model.vehicle.n_propellers
    lagging = model.dynamics.motor_time_constant > 0
    motion = random.normal(size=(count, 6)) * [0.5, 0.3, 3.0, 0.5, 0.5, 4.0]
    speeds = random.uniform(0, 1, (count, n if lagging else 0))
    return np.hstack([motion, speeds]), random.uniform(0, 1, (count, n))


def with_vector(model: Model, vector: np.ndarray) -> Model:
    """Return the model with other parameters."""
    return replace(model, parameters=model.parameters.with_vector(vector))
