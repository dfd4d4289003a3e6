"""Conversion of command-line values to arguments of the verbs."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.cli.output import warn

if TYPE_CHECKING:
    from airpuck.control.tuning import Tuning
    from airpuck.craft.vehicle import Vehicle
    from airpuck.data.trajectory import Trajectory
    from airpuck.model.model_file import Model
    from airpuck.recording.mapping import RecordingMapping


def load(
    recording: Path,
    vehicle: Vehicle | None,
    mapping: RecordingMapping | None,
    *,
    span: tuple[float, float] | None = None,
    delay: float | None = None,
    quiet: bool = True,
) -> Trajectory:
    """Load and preprocess a recording, or the part named by --span, and print warnings."""
    trajectory = airpuck.load_trajectory(recording, vehicle, mapping=mapping, delay=delay)
    warn(trajectory.warnings, quiet)
    return trajectory if span is None else trajectory.slice(*span)


def load_for(
    model: str,
    recording: Path,
    mapping: RecordingMapping | None,
    *,
    span: tuple[float, float] | None = None,
    quiet: bool = True,
) -> tuple[Model, Trajectory]:
    """Read a model, and load a recording of its craft."""
    judged = airpuck.read_model(model)
    return judged, load(recording, judged.vehicle, mapping, span=span, quiet=quiet)


@contextmanager
def about(file: str | Path, field: str | None = None) -> Iterator[None]:
    """Add the file, and the field as the file calls it, to an InputError."""
    try:
        yield
    except InputError as error:
        field = field or error.field
        raise InputError(error.problem, file=error.file or file, field=field) from error


def read_belief(name: str) -> Model:
    """Read a model for the controller, which inverts its thrust curves."""
    from airpuck.physics.thrust import InverseThrust

    model = airpuck.read_model(name)
    with about(name, "parameters.thrust_N"):
        InverseThrust(model.dynamics.thrust)
    return model


def read_given(
    model: str | None, vehicle: Vehicle | None, read: Callable[[str], Model] = read_belief
) -> Model | None:
    """Read a model if one is given; raise InputError if a vehicle is given, too."""
    if model is None:
        return None
    if vehicle is not None:
        raise InputError(
            "a model includes its vehicle; pass only one of the two", field="--vehicle"
        )
    return read(model)


def model_or_nominal(
    model: str | None, vehicle: Vehicle | None, read: Callable[[str], Model] = read_belief
) -> Model:
    """Read a model, or make the nominal one of a vehicle, by default the paper's."""
    from airpuck.model.model_file import nominal_model

    return read_given(model, vehicle, read) or nominal_model(vehicle or airpuck.default_vehicle())


def read_controls(path: Path | None, kind: str | None = None, *models: Model) -> Tuning:
    """Read a tuning file, by default the one for the craft, and check its weights.

    `kind` overrides the tuning's law; it must suit the models.
    """
    from airpuck.control.lqr import LQRSettings, lqr_gain
    from airpuck.control.tuning import default_tuning, tuning_for

    usual = tuning_for(models[0]) if models else default_tuning()
    tuning = usual if path is None else airpuck.read_tuning(path, *models[:1])
    if models and models[0].fit and models[0].cameras is None:
        words = "does not state the noise of its recordings; the controller assumes the packaged "
        warn([f"the model {models[0].name} {words}noise: identify it again"])
    tuning = tuning if kind is None else tuning.with_law(kind)
    if path is not None:
        with about(path):
            lqr_gain(tuning.of(LQRSettings).weights, tuning.period_s)
    check_law(path, tuning, *models)
    return tuning


def check_law(path: Path | None, tuning: Tuning, *models: Model) -> None:
    """Raise InputError if the law of a tuning file, or the user's own law, does not suit."""
    from airpuck.control.law import LawOptions, law_named

    make = law_named(tuning.law.kind)
    if not getattr(make, "looks_ahead", True):
        return
    with contextlib.nullcontext() if path is None else about(path):
        for model in models:
            make(model, tuning, LawOptions(compiled=False))


def published_flights(models: Sequence[str]) -> list[Path | None]:
    """Find the paper's flights with these models in $AIRPUCK_DATA; warn about missing ones."""
    from airpuck.recording.dataset import VARIABLE

    folder = os.environ.get(VARIABLE)
    flights: list[Path | None] = []
    for model in models:
        path = Path(folder or "") / "control_experiment" / f"data_{model.removeprefix('paper:')}"
        published = model.startswith("paper:") and bool(folder) and path.is_dir()
        flights.append(path if published else None)
    found = zip(models, flights, strict=True)
    missing = [m for m, flight in found if flight is None and m in ("paper:M0", "paper:M4")]
    if missing:
        reason = f"{folder} has no control_experiment" if folder else f"${VARIABLE} is not set"
        hint = f"set {VARIABLE} to the dataset (airpuck fetch downloads it and prints its folder)"
        warn([f"the real flight with {' and '.join(missing)} is missing: {reason}; {hint}"])
    return flights
