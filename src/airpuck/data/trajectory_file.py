"""Reading files of `Trajectory.save`, or files that claim to be such."""

from __future__ import annotations

import io
import math
import os
from typing import Annotated, Any

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck.boundary.errors import InputError, explained
from airpuck.boundary.files import Section, checked, parse_json
from airpuck.boundary.limits import ABOUT_BYTES, ARCHIVE_BYTES, SPANS, Archive, within_means
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import FORMAT, Span, Trajectory

#: Members that are read; ``input`` follows from the others.
_ARRAYS = ("t", "state", "acceleration", "command_time", "command")
#: Size of an array's header [bytes]; NumPy writes 128.
_LONGEST_HEADER = 4096


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a file written by `Trajectory.save`.

    Parameters
    ----------
    path : path-like
        An .npz file.

    Returns
    -------
    Trajectory
        Equal to the saved trajectory.

    Raises
    ------
    InputError
        If the file is missing, damaged, or was not written by `Trajectory.save`.

    Examples
    --------
    >>> trajectory.save("flight.npz")
    >>> airpuck.read_trajectory("flight.npz").propellers == trajectory.propellers
    True
    """
    # A damaged archive can make zipfile and NumPy fail in any way.
    foreign = "is not a trajectory that `airpuck preprocess` wrote ({error})"
    with explained(Exception, foreign, file=path), within_means(path):
        try:
            arrays, about = _read_archive(path)
        except FileNotFoundError:
            raise InputError("there is no such file", file=path) from None
        except KeyError as error:
            missing = "is missing; write the file with `airpuck preprocess`"
            raise InputError(missing, file=path, field=error.args[0]) from error
    if about.get("format") != FORMAT:
        raise InputError(
            f"is not in the format that this version reads ({FORMAT!r}); preprocess the recording "
            "again",
            file=path,
        )
    rest = dict(checked(about, _About, file=path))
    try:
        return Trajectory(time=arrays.pop("t"), delay=rest.pop("delay_s"), **arrays, **rest)
    except InputError as error:
        # The file is at fault, not the recording that it was made from.
        problem = f"{error.problem}; preprocess the recording again"
        raise InputError(problem, file=path, field=error.field) from error


class _About(Section):
    """Metadata of a trajectory's file, besides its format; fields of later versions are ignored."""

    model_config = pydantic.ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    delay_s: float
    delay_known: bool
    propellers: tuple[str, ...]
    excluded: Annotated[tuple[Span, ...], pydantic.Field(max_length=SPANS)]
    source: str
    hashes: dict[str, str]
    warnings: tuple[str, ...]
    #: Earlier versions did not write it.
    vehicle: Vehicle | None = None


def _read_archive(
    path: str | os.PathLike[str],
) -> tuple[dict[str, Float[np.ndarray, "..."]], dict[str, Any]]:
    """Return the arrays of the file, and its metadata."""
    with Archive(path) as archive:
        text = str(_array(archive, "about", ABOUT_BYTES))
        arrays = {name: _array(archive, name) for name in _ARRAYS}
        if wrong := [name for name, array in arrays.items() if array.dtype.kind not in "fiu"]:
            raise InputError("must hold numbers", file=path, field=wrong[0])
        arrays = {name: array.astype(np.float64, copy=False) for name, array in arrays.items()}
        # Earlier versions left out what is around a lost frame.
        known = "lost.npy" in archive.names
        arrays["lost"] = _array(archive, "lost") if known else np.zeros(0)
        return arrays, parse_json(text, file=path)


def _array(archive: Archive, name: str, most: int = ARCHIVE_BYTES) -> np.ndarray:
    """Read an array; check that its size fits the zip member."""
    content = archive.read(f"{name}.npy", most)
    stream = io.BytesIO(memoryview(content)[:_LONGEST_HEADER])
    version = np.lib.format.read_magic(stream)
    if version != (1, 0):
        raise ValueError(f"{name} is of another version of NumPy's format")
    shape, by_column, dtype = np.lib.format.read_array_header_1_0(stream)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(content) - stream.tell():
        raise ValueError(f"{name} does not have the size in its header")
    flat = np.frombuffer(content, dtype, offset=stream.tell())
    return flat.reshape(shape, order="F" if by_column else "C")
