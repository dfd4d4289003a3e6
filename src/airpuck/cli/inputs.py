"""From what was typed to what the verbs take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from airpuck.control.tuning import Tuning
    from airpuck.craft.vehicle import Vehicle
    from airpuck.data.trajectory import Trajectory
    from airpuck.evaluation.evaluate import Protocol
    from airpuck.model.model_file import Model
    from airpuck.recording.stream import Recording


def read_craft(path: Path | None) -> Vehicle | None:
    """Read the vehicle file, if one is given."""
    if path is None:
        return None
    from airpuck.craft.vehicle import read_vehicle

    return read_vehicle(path)


def load(
    recording: Path, vehicle: Vehicle | None, topics: Path | None, delay: float | None = None
) -> Trajectory:
    """Load and preprocess a recording."""
    from airpuck.preprocessing.pipeline import load_trajectory
    from airpuck.recording.stream import read_topics

    names = None if topics is None else read_topics(topics)
    return load_trajectory(recording, vehicle, topics=names, delay=delay)


def cut(trajectory: Trajectory, span: tuple[float, float] | None) -> Trajectory:
    """Keep the part that --span names."""
    return trajectory if span is None else trajectory.slice(*span)


@contextmanager
def about(file: str | Path, field: str | None = None) -> Iterator[None]:
    """Name the file, and the field as the file calls it, in what is refused."""
    from airpuck.boundary.errors import InputError

    try:
        yield
    except InputError as error:
        raise InputError(
            error.problem, file=error.file or file, field=field or error.field
        ) from error


def read_belief(name: str) -> Model:
    """Read a model for the controller, which inverts its thrust curves."""
    from airpuck.model.model_file import read_model
    from airpuck.physics.thrust import InverseThrust

    model = read_model(name)
    with about(name, "parameters.thrust_N"):
        InverseThrust(model.dynamics.thrust)
    return model


def read_controls(path: Path | None) -> Tuning | None:
    """Read the tuning file, if one is given, and see that it gives a regulator."""
    if path is None:
        return None
    from airpuck.control.lqr import regulator
    from airpuck.control.tuning import read_tuning

    tuning = read_tuning(path)
    with about(path):
        regulator(tuning.weights, tuning.period_s)
    return tuning


def choose(option: str, value: str, choices: tuple[str, ...]) -> None:
    """Refuse a value that is not among the choices."""
    from airpuck.boundary.errors import InputError

    if value not in choices:
        raise InputError(f"{value!r} is none of {', '.join(choices)}", field=option)


def choose_protocol(protocol: str, encoder: str) -> Protocol:
    """Return the protocol that is named; refuse names that are none."""
    from airpuck.evaluation.evaluate import ENCODERS, PROTOCOLS

    choose("--protocol", protocol, tuple(PROTOCOLS))
    choose("--encoder", encoder, ENCODERS)
    return PROTOCOLS[protocol]


def read_flight(recording: Path, topics: Path | None) -> Recording:
    """Read a recording as it was logged."""
    from airpuck.recording.read import read_recording
    from airpuck.recording.stream import read_topics

    return read_recording(recording, topics=None if topics is None else read_topics(topics))


def known_flights(models: list[str]) -> list[Path | None]:
    """Find the paper's flights with these models in $AIRPUCK_DATA, if that is set."""
    import os

    from airpuck.recording.dataset import VARIABLE

    folder = os.environ.get(VARIABLE)
    flights = []
    for model in models:
        path = Path(folder or "") / "control_experiment" / f"data_{model.removeprefix('paper:')}"
        published = model.startswith("paper:") and bool(folder) and path.is_dir()
        flights.append(path if published else None)
    return flights


def missing_flights(models: Sequence[str], flights: Sequence[Path | None]) -> list[str]:
    """Say which of the paper's flights `known_flights` did not find, and why."""
    import os

    from airpuck.recording.dataset import VARIABLE

    missing = [
        model
        for model, flight in zip(models, flights, strict=True)
        if flight is None and model in ("paper:M0", "paper:M4")
    ]
    if not missing:
        return []
    folder = os.environ.get(VARIABLE)
    why = f"{folder} has no control_experiment of theirs" if folder else f"${VARIABLE} is not set"
    return [
        f"no real flight stands beside {' and '.join(missing)}: {why}; set {VARIABLE} to the "
        "dataset (airpuck fetch downloads it and prints its folder)"
    ]
