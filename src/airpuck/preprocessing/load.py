"""Load a trajectory from whatever a user has."""

from __future__ import annotations

import os
from pathlib import Path

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory, read_trajectory
from airpuck.recording.stream import Topics


def load_trajectory(
    path: str | os.PathLike[str],
    vehicle: Vehicle | None = None,
    *,
    topics: Topics | None = None,
    delay: float | None = None,
) -> Trajectory:
    """Read a recording and preprocess it, or read what is preprocessed already.

    Parameters
    ----------
    path : path-like
        A bag folder, an .mcap, a folder of CSV files, the authors' data.pt (or the folder of one),
        or an .npz that `Trajectory.save` wrote.
    vehicle : Vehicle, optional
        The craft; by default the paper's.
    topics : Topics, optional
        Names of a bag's topics.
    delay : float, optional
        Transport delay of a raw recording [s]; by default it is found by correlation.

    Returns
    -------
    Trajectory
        The trajectory.

    Raises
    ------
    InputError
        If the file cannot be read or does not fit the vehicle.
    """
    path = Path(path)
    archive = path / "data.pt" if path.is_dir() else path
    preprocessed = path.suffix == ".npz" or (archive.suffix == ".pt" and archive.is_file())
    if preprocessed and (delay is not None or topics is not None):
        raise InputError(
            "is preprocessed already: its transport delay is settled and it has no topics",
            file=path,
            field="delay" if delay is not None else "topics",
        )
    if path.suffix == ".npz":
        return read_trajectory(path)
    if preprocessed:
        from airpuck.recording.torch_archive import read_authors_experiment

        return read_authors_experiment(archive)
    from airpuck.preprocessing.pipeline import preprocess
    from airpuck.recording.read import read_recording

    return preprocess(read_recording(path, topics=topics), vehicle, delay=delay)
