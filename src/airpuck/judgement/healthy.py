"""Which faults set apart the starts that are not healthy: the same for every model under test."""

from __future__ import annotations

from contextlib import suppress

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Span, Trajectory
from airpuck.faults.find import find_faults
from airpuck.faults.strengths import usual_rung
from airpuck.identification.fit import identify
from airpuck.identification.settings import Loss
from airpuck.model.model_file import published_model


def reference_faults(trajectory: Trajectory, vehicle: Vehicle) -> tuple[Span, ...]:
    """Find the faults of a recording by a model that is not under test.

    It is the published M3 for the paper's craft, and for others a robust fit to the recording, as
    in `airpuck faults`. If the model under test chose its own windows, it could call its errors
    faults. Without faults, if the recording is too short for a fit.
    """
    published = published_model("M3")
    if vehicle.propellers == published.vehicle.propellers:
        return find_faults(trajectory, published)
    with suppress(InputError):
        rung = usual_rung(trajectory, vehicle)
        fit = identify(trajectory, rung, vehicle=vehicle, loss=Loss(robust=True))
        return find_faults(trajectory, fit.model)
    return ()
