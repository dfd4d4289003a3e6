"""What makes a fit doubtful, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from airpuck.data.trajectory import Trajectory
from airpuck.model.model_file import Model
from airpuck.physics.thrust import lowest_slope

#: A motor whose command stays within this range says nothing about its thrust.
_HARDLY = 0.02


def idle_motors(trajectories: Sequence[Trajectory]) -> list[str]:
    """Name the motors of which the data can say nothing."""
    ranges = np.max([np.ptp(t.input[t.usable], axis=0) for t in trajectories], axis=0)
    return [
        f"the command of {name} hardly changes: these data do not determine its thrust"
        for name, extent in zip(trajectories[0].propellers, ranges, strict=True)
        if extent < _HARDLY
    ]


def doubts(model: Model, converged: bool, message: str) -> list[str]:
    """Say what to look at before trusting a model."""
    warnings = [] if converged else [f"the optimiser has not converged: {message}"]
    vector = model.parameters.to_vector()
    lower, upper = model.parameters.bounds()
    labels = model.parameters.labels(model.vehicle.propeller_names)
    at_bound = model.free & ((vector <= lower) | (vector >= upper))
    warnings += [f"{labels[entry]} is at its bound" for entry in np.flatnonzero(at_bound)]
    nominal = model.vehicle.nominal.inertia_kg_m2
    if not 0.05 < float(model.parameters.inertia) / nominal < 20:
        warnings.append(
            f"the inertia, {float(model.parameters.inertia):.3g} kg m², is far from the nominal "
            f"{nominal:.3g}: do the data excite the yaw?"
        )
    slopes, speeds = lowest_slope(model.parameters.thrust)
    for name, slope, speed in zip(model.vehicle.propeller_names, slopes, speeds, strict=True):
        if slope < 0:
            warnings.append(f"thrust of {name} falls at φ = {speed:.2f}: it cannot be inverted")
    return warnings
