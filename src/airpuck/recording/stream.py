"""A recording: the raw streams that a lab logged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float, Int64, Shaped
from numpy.typing import ArrayLike

from airpuck.boundary.arguments import checked, checked_class
from airpuck.boundary.errors import InputError, about, explained, installed
from airpuck.craft.vehicle import unnamed_columns
from airpuck.recording.conversion import commands_of, poses_of, propellers_of, stamps_of
from airpuck.recording.mapping import RecordingMapping

#: Streams of poses: craft, puck, the human's mallet, and the mallet's target.
POSES = ("pose", "puck", "mallet", "mallet_target")
#: Columns of the streams with a fixed meaning. A command's columns are the propellers' names. A
#: game has the goals of both sides, the number of the event's kind, and the side concerned.
COLUMNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        **dict.fromkeys(POSES, ("x_m", "y_m", "yaw_rad")),
        "reference": ("x_m", "y_m", "yaw_rad", "vx_m_s", "vy_m_s", "spin_rad_s"),
        "estimate": ("x_m", "y_m", "yaw_rad", "vx_m_s", "vy_m_s", "spin_rad_s"),
        "imu": ("ax_m_s2", "ay_m_s2", "az_m_s2", "gx_rad_s", "gy_rad_s", "gz_rad_s"),
        "mouse": ("vx_m_s", "vy_m_s"),
        "game": ("left", "right", "event", "side", "value"),
    }
)
#: Streams of commands: to the craft, to its reaction wheels if they have a topic of their own, and
#: to its opponent.
COMMANDS = ("command", "wheels", "opponent_command")


@dataclass(frozen=True, eq=False, repr=False)
class Stream:
    """One topic as logged.

    Attributes
    ----------
    stamp_ns : array of int64, shape (N,)
        Time in each message's header [ns since the epoch]. If messages carry none, the recorder's
        time, with a warning.
    received_ns : array of int64, shape (N,)
        The recorder's time of arrival [ns since the epoch].
    values : array of float64, shape (N, k)
        The numbers, in SI units and our axes.
    columns : tuple of str
        Names of the k columns.
    rate_hz : float, optional
        The cameras' rate, if the mapping states it.
    exact : bool, default False
        Whether the mapping states that the stamps are the times of exposure.

    Examples
    --------
    >>> poses = recording["pose"]
    >>> isinstance(poses, airpuck.Stream), poses.columns
    (True, ('x_m', 'y_m', 'yaw_rad'))
    >>> [x for time, x, y, yaw in poses][:2] == poses.to_pandas()["x_m"][:2].tolist()
    True
    >>> poses.values.shape == (len(poses.stamp_ns), 3)
    True
    """

    stamp_ns: Int64[np.ndarray, " N"]
    received_ns: Int64[np.ndarray, " N"]
    values: Float[np.ndarray, "N k"]
    columns: tuple[str, ...]
    rate_hz: float | None = None
    exact: bool = False

    def __post_init__(self) -> None:
        if np.ndim(self.values) != 2 or np.asarray(self.values).dtype.kind not in "fiu":
            raise InputError(
                "must be numbers in two dimensions: a row for each time, a column for each name",
                field="values",
            )
        for name in ("stamp_ns", "received_ns"):
            stamps = np.asarray(getattr(self, name))
            if stamps.ndim != 1 or stamps.dtype.kind not in "iu":
                raise InputError("must be whole numbers, one for each row", field=name)
        n, k = np.shape(self.values)
        if len(self.columns) != k or len(self.stamp_ns) != n or len(self.received_ns) != n:
            raise InputError("stamps, values and columns of a stream do not fit together")
        if len(set(self.columns)) != k:
            raise InputError("two columns have the same name", field="columns")
        for name in ("values", "stamp_ns", "received_ns"):
            object.__setattr__(self, name, np.asarray(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def __iter__(self) -> Iterator[tuple[float, ...]]:
        return zip(self.time.tolist(), *self.values.T.tolist(), strict=True)

    def __repr__(self) -> str:
        lasting = np.ptp(self.time) if len(self) else 0.0
        return f"Stream({len(self)} of {', '.join(self.columns)} in {lasting:.1f} s)"

    @property
    def time(self) -> Float[np.ndarray, " N"]:
        """The stamps, of all streams alike [s since the epoch]."""
        return self.stamp_ns / 1e9

    def to_pandas(self) -> Any:
        """Return the stream as a table.

        Returns
        -------
        pandas.DataFrame
            A column for each name, by time.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        with installed("to_pandas needs pandas: pip install pandas"):
            import pandas

        index = pandas.to_datetime(self.stamp_ns).rename("time")
        return pandas.DataFrame(self.values, index, list(self.columns))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Stream):
            return NotImplemented
        return (
            self.columns == other.columns
            and np.array_equal(self.stamp_ns, other.stamp_ns)
            and np.array_equal(self.received_ns, other.received_ns)
            and np.array_equal(self.values, other.values, equal_nan=True)
        )

    __hash__ = None  # pyright: ignore[reportAssignmentType]


@checked_class
@dataclass(frozen=True, repr=False)
class Recording:
    """Named streams of one flight, and their origin.

    A recording does not reveal whether it was flown or simulated.

    Attributes
    ----------
    streams : mapping of str to Stream
        ``pose`` and ``command``, and if logged ``reference``, ``estimate``, ``imu``, ``mouse``,
        ``puck``, ``mallet``, ``mallet_target``, ``opponent_command``, ``game``; columns as in
        `COLUMNS`.
    source : str
        The file or folder.
    hashes : mapping of str to str
        SHA-256 of every file that was read, by name.
    warnings : tuple of str
        Minor problems in the files.
    about : mapping of str to str
        Facts that the recorder stored with a bag, such as the players of a game.

    Examples
    --------
    >>> isinstance(recording, airpuck.Recording)
    True
    >>> sorted(recording)
    ['command', 'imu', 'mouse', 'pose', 'reference']
    >>> recording["pose"].values.shape[1]  # x, y, yaw
    3
    """

    streams: Mapping[str, Stream]
    source: str
    hashes: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    about: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, stream in self.streams.items():
            if not isinstance(stream, Stream):
                problem = f"must be a Stream, not {type(stream).__name__}"
                raise InputError(problem, file=self.source, field=name)
            expected = COLUMNS.get(name)
            if expected is not None and len(stream.columns) != len(expected):
                problem = f"must have the columns {', '.join(expected)}"
                raise InputError(problem, file=self.source, field=name)

    @classmethod
    @partial(checked, finite=False)
    def from_arrays(
        cls,
        time: ArrayLike,
        poses: ArrayLike,
        command_time: ArrayLike,
        commands: ArrayLike,
        *,
        propellers: Sequence[str] = (),
        mapping: RecordingMapping | None = None,
        source: str = "arrays",
    ) -> Recording:
        """Make a recording from arrays, or from columns of a data frame.

        Parameters
        ----------
        time : array-like, shape (N,)
            Times of the poses: seconds, or NumPy's dates.
        poses : array-like, shape (N, 3) or (N, 7)
            x, y [m] and yaw [rad]; or x, y, z [m] and a quaternion x, y, z, w.
        command_time : array-like, shape (K,)
            Times of the commands, on the same clock.
        commands : array-like, shape (K, n)
            A command in [0, 1] for each propeller.
        propellers : sequence of str, optional
            The propeller that each column drives; by default in the order of the vehicle.
        mapping : RecordingMapping, optional
            Units, axes, scale and offset, if numbers are not SI; names in it do not matter.
        source : str, optional
            Name of the recording in messages.

        Returns
        -------
        Recording
            Poses and commands; rows without any number are left out, with a warning on their
            number.

        Raises
        ------
        InputError
            If arrays do not fit together or do not contain numbers.

        Examples
        --------
        >>> t = np.arange(0.0, 1.0, 0.01)
        >>> poses = np.column_stack([1000 * t, 0 * t, 90 * t])
        >>> mapping = RecordingMapping(pose=PoseMapping(units=("mm", "deg")))
        >>> recording = Recording.from_arrays(t, poses, t, np.ones((100, 4)), mapping=mapping)
        >>> recording["pose"].values[50].round(3).tolist()
        [0.5, 0.0, 0.785]
        """
        mapping = mapping or RecordingMapping()
        known = {"propellers": tuple(propellers)} if propellers else {}
        stamps, pose, lost = _table("poses", time, poses, source)
        command_stamps, command, gone = _table("commands", command_time, commands, source)
        for name, times in {"time": stamps, "command_time": command_stamps}.items():
            if (np.diff(times) < 0).any():
                raise InputError("must not decrease; sort the rows", file=source, field=name)
        if pose.shape[1] not in (3, 7):
            problem = f"has {pose.shape[1]} columns; use x, y, yaw or x, y, z and a quaternion"
            raise InputError(problem, file=source, field="poses")
        axes = 2 if pose.shape[1] == 3 else 3
        kind = "yaw" if axes == 2 else "quaternion"
        with about(source):
            values = poses_of(pose[:, :axes], pose[:, axes:], kind, mapping.pose)
            at = stamps_of(stamps, mapping.pose)
            seen = Stream(at, at, values, COLUMNS["pose"])
            own = mapping.command.model_copy(update=known)
            at = stamps_of(command_stamps, own)
            names = propellers_of(unnamed_columns(command.shape[1]), own)
            commanded = Stream(at, at, commands_of(command, own), names)
        whole = cls({"pose": seen, "command": commanded}, source, warnings=lost + gone)
        return of_cameras(whole, mapping)

    def __iter__(self) -> Iterator[str]:
        return iter(self.streams)

    def __repr__(self) -> str:
        streams = ", ".join(f"{name}: {len(stream)}" for name, stream in self.streams.items())
        return f"Recording({self.source!r}, {{{streams}}})"

    def __getitem__(self, name: str) -> Stream:
        """Return a stream by name."""
        stream = self.streams.get(name)
        if stream is None:
            raise InputError(
                f"has no {name} stream (it has {', '.join(self.streams) or 'none'})",
                file=self.source,
            )
        if len(stream) == 0:
            problem = f"the {name} stream is empty; record it, or name another topic in a mapping"
            raise InputError(problem, file=self.source)
        return stream


def _table(
    name: str, time: ArrayLike, values: ArrayLike, source: str
) -> tuple[Shaped[np.ndarray, " N"], Float[np.ndarray, "N k"], tuple[str, ...]]:
    """Return matching times and numbers without rows of NaN, and the number of such rows."""
    with explained((TypeError, ValueError), "are not numbers", file=source, field=name):
        stamps, numbers = np.asarray(time), np.asarray(values, dtype=np.float64)
        if stamps.dtype.kind not in "iufMm":
            stamps = stamps.astype(np.float64)
    if numbers.ndim != 2 or stamps.shape != numbers.shape[:1]:
        raise InputError(
            f"have the shape {numbers.shape} and their times {stamps.shape}; there must be a row "
            "for each time",
            file=source,
            field=name,
        )
    kept = ~np.isnan(numbers).all(axis=1)
    return stamps[kept], numbers[kept], left_out(name, int((~kept).sum()))


def joined(parts: Sequence[Stream]) -> Stream:
    """Merge parts of a stream in order of arrival; their columns may differ in order only."""
    first = parts[0]
    if len(parts) == 1:
        return first
    values = []
    for part in parts:
        if sorted(part.columns) != sorted(first.columns):
            raise InputError(
                f"its definitions name other values: {', '.join(first.columns)}, and "
                f"{', '.join(part.columns)}; name them in a mapping"
            )
        values.append(part.values[:, [part.columns.index(name) for name in first.columns]])
    stamps = np.concatenate([part.stamp_ns for part in parts])
    received = np.concatenate([part.received_ns for part in parts])
    whole = Stream(stamps, received, np.concatenate(values), first.columns)
    return rows_of(whole, np.argsort(received, kind="stable"))


def of_cameras(recording: Recording, mapping: RecordingMapping) -> Recording:
    """Leave out poses that the cameras lost, and add what the mapping states of their stamps.

    Lost are poses without a whole position or, if any has a yaw, without one.
    """
    streams, warnings = dict(recording.streams), recording.warnings
    for name in (name for name in POSES if name in streams):
        poses, own = streams[name], mapping.of_poses(name)
        missing = np.isnan(poses.values)
        lost = missing[:, :2].any(axis=1) | (missing[:, 2] & ~missing[:, 2].all())
        seen = rows_of(poses, ~lost) if lost.any() else poses
        streams[name] = replace(seen, rate_hz=own.rate_hz, exact=own.stamps == "exact")
        warnings += left_out("poses" if name == "pose" else f"{name} poses", int(lost.sum()))
    return replace(recording, streams=streams, warnings=warnings)


def rows_of(stream: Stream, chosen: Shaped[np.ndarray, " M"]) -> Stream:
    """Return some rows: by a mask, or by numbers in a new order."""
    return replace(
        stream,
        stamp_ns=stream.stamp_ns[chosen],
        received_ns=stream.received_ns[chosen],
        values=stream.values[chosen],
    )


def left_out(name: str, missing: int) -> tuple[str, ...]:
    """Return a warning about blank rows: exports have blank cells where tracking is lost."""
    return (f"blank {name} left out: {missing}",) if missing else ()
