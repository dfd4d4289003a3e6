"""Reading a recording in any supported form."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from airpuck.boundary.errors import InputError, explained
from airpuck.boundary.limits import within_means
from airpuck.craft.vehicle import unnamed_columns
from airpuck.recording.bag import METADATA, is_bag, read_bag, several_recordings
from airpuck.recording.csv_folder import is_csv_folder, is_table, read_csv
from airpuck.recording.mapping import RecordingMapping, Topics
from airpuck.recording.stream import Recording, Stream, of_cameras, rows_of
from airpuck.recording.ulog_file import ULOG, read_ulog

_FORMS = "a rosbag2 folder, an .mcap, .db3, .bag or .ulg file, a CSV file or a folder of CSV files"


def read_recording(
    path: str | os.PathLike[str],
    *,
    mapping: RecordingMapping | None = None,
    topics: Topics | None = None,
    needs: Sequence[str] = ("pose", "command"),
) -> Recording:
    """Read the raw recording, before any preprocessing.

    Parameters
    ----------
    path : path-like
        A rosbag2 folder (MCAP or SQLite), a bare .mcap or .db3 file, a ROS 1 bag, a PX4 log
        (.ulg), a CSV file, or a folder of CSV files: the authors', exports of Motive or Qualisys,
        or any that the mapping describes. A folder that contains a single such folder also works.
        If a folder contains a bag and CSV files, the bag is read, because the CSV files were made
        from it.
    mapping : RecordingMapping, optional
        Topics, files, columns, units and axes (`read_mapping`); the default is the authors'
        table.
    topics : Topics, optional
        Short for a mapping that only names topics.
    needs : sequence of str, optional
        Streams without which reading fails.

    Returns
    -------
    Recording
        At least the required streams, in SI units and our axes. Nothing is checked, sorted or
        unwrapped, but a bag's messages are in the order of the recorder's clock. A damaged .mcap
        or .bag gives every intact chunk, with a warning on how far it reaches. Blank rows of a
        mapped file or an export are left out, with a warning on their number.

    Raises
    ------
    InputError
        If there is no recording, more than one, or the recording cannot be read.

    Examples
    --------
    >>> airpuck.write_bag(recording, "bag/")
    >>> airpuck.read_recording("bag/")["pose"].columns
    ('x_m', 'y_m', 'yaw_rad')
    """
    with within_means(path):
        wanted = mapping or RecordingMapping(topics=topics or Topics())
        return _with_wheels(of_cameras(_read(Path(path), wanted, needs), wanted))


def _read(path: Path, mapping: RecordingMapping, needs: Sequence[str]) -> Recording:
    """Read a recording in one of the forms."""
    with explained(OSError, "cannot be read ({error})", file=path):
        found = _resolve(path, mapping) if path.is_dir() else path
        if not found.exists():
            raise InputError("there is no such file or folder", file=path)
        if not (found.is_dir() or found.is_file()):
            raise InputError(f"is not a regular file; use {_FORMS}", file=path)
        if is_bag(found):
            return read_bag(found, mapping, needs)
        if found.is_dir():
            return read_csv(found, mapping, needs, None)
        if found.suffix == ULOG:
            return read_ulog(found, mapping, needs)
        if is_table(found):
            return read_csv(found.parent, mapping, needs, found)
    if found.suffix in (".npz", ".pt"):
        raise InputError("is already preprocessed and contains no raw recording", file=path)
    raise InputError(f"is not a recording; use {_FORMS}", file=path)


def _with_wheels(recording: Recording) -> Recording:
    """Add the commands of reaction wheels from a topic of their own to the craft's commands.

    Each is held until the next. Wheels are at rest before their first command.
    """
    streams = dict(recording.streams)
    wheels, craft = streams.pop("wheels", None), streams.get("command")
    if not wheels or not craft:
        return replace(recording, streams=streams)
    craft, wheels = (rows_of(s, np.argsort(s.stamp_ns, kind="stable")) for s in (craft, wheels))
    stamps = np.union1d(craft.stamp_ns, wheels.stamp_ns)
    stamps = stamps[stamps >= craft.stamp_ns[0]]
    last, turned = (np.searchsorted(s.stamp_ns, stamps, side="right") - 1 for s in (craft, wheels))
    speed = np.where(turned[:, None] < 0, 0.0, wheels.values[np.maximum(turned, 0)])
    columns = (*craft.columns, *wheels.columns)
    if craft.columns == unnamed_columns(len(craft.columns)):
        columns = unnamed_columns(len(columns))
    streams["command"] = Stream(
        stamp_ns=stamps,
        received_ns=np.maximum(stamps, craft.received_ns[last]),
        values=np.hstack([craft.values[last], speed]),
        columns=columns,
    )
    return replace(recording, streams=streams)


def _resolve(folder: Path, mapping: RecordingMapping) -> Path:
    """Return the folder that contains the recording: this one, or its only subfolder that does."""

    def holds_one(place: Path) -> bool:
        return is_bag(place) or is_csv_folder(place, mapping)

    if holds_one(folder):
        return folder
    inside = sorted(entry for entry in folder.iterdir() if entry.is_dir())
    candidates = [entry for entry in inside if holds_one(entry)]
    if len(candidates) == 1:
        return candidates[0]
    if candidates:
        raise several_recordings(candidates, folder)
    if (folder / METADATA).is_file():
        raise InputError(
            "its storage file is missing: metadata.yaml is there, but no .mcap or .db3", file=folder
        )
    if any(is_table(entry) for entry in folder.iterdir()):
        return folder
    raise InputError(f"contains no recording; use {_FORMS}", file=folder)
