"""The transport delay as a parameter: whether a fit frees it, where it starts, what it says.

Preprocessing finds the delay by correlation, in whole samples and for a nominal motor lag. A fit
goes on from there, jointly with the lag: the two shift the response alike, but only the lag rounds
it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.identification.levenberg_marquardt import LevenbergMarquardt
from airpuck.identification.method import Method
from airpuck.model.model_file import Model
from airpuck.model.rungs import Rung

#: Whether to learn the delay.
DelayChoice = Literal["fit", "fixed"]
#: A recording whose own delay is this far from the fitted one has other clocks, or another radio.
_FAR_SAMPLES = 3.0


def learns_delay(
    choice: DelayChoice | None, rung: Rung, method: Method, trajectories: Sequence[Trajectory]
) -> bool:
    """Say whether a fit learns the transport delay."""
    can = isinstance(method, LevenbergMarquardt)
    if choice is None:
        return rung.lag and can and all(t.delay_known for t in trajectories)
    if choice == "fit" and not can:
        raise InputError("fit is of Levenberg-Marquardt only", field="delay")
    return choice == "fit"


def mean_delay(trajectories: Sequence[Trajectory], vehicle: Vehicle) -> float:
    """Return the transport delay that preprocessing found."""
    known = [trajectory.delay for trajectory in trajectories if trajectory.delay_known]
    return float(np.mean(known)) if known else vehicle.nominal.transport_delay_s


def delay_warnings(model: Model, trajectories: Sequence[Trajectory]) -> list[str]:
    """Say which recordings seem to have another delay than the one that was learned."""
    if not model.delay_learned:
        return []
    return [
        f"{t.source}: preprocessing found a delay of {1e3 * t.delay:.1f} ms, the fit "
        f"{1e3 * model.transport_delay:.1f} ms for all recordings; check clocks and nominal lag"
        for t in trajectories
        if t.delay_known and abs(t.delay - model.transport_delay) > _FAR_SAMPLES * t.sample_period
    ]
