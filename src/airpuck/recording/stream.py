"""A recording: the streams a lab logged, exactly as they were logged, and their topics."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Annotated

import numpy as np
import pydantic
from jaxtyping import Float, Int64

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Section, read_toml

SECOND_NS = 10**9
#: Columns of the streams whose meaning is fixed. A command's columns are the propellers' names.
COLUMNS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "pose": ("x_m", "y_m", "yaw_rad"),
        "reference": ("x_m", "y_m", "yaw_rad", "vx_m_s", "vy_m_s", "spin_rad_s"),
        "estimate": ("x_m", "y_m", "yaw_rad", "vx_m_s", "vy_m_s", "spin_rad_s"),
        "imu": ("ax_m_s2", "ay_m_s2", "az_m_s2", "gx_rad_s", "gy_rad_s", "gz_rad_s"),
        "mouse": ("vx_m_s", "vy_m_s"),
    }
)


@dataclass(frozen=True, eq=False, repr=False)
class Stream:
    """One topic as logged.

    Attributes
    ----------
    stamp_ns : array of int64, shape (N,)
        Time in each message's header [ns since the epoch]. Where messages carry none, the
        recorder's time.
    received_ns : array of int64, shape (N,)
        The recorder's time of arrival [ns since the epoch].
    values : array of float64, shape (N, k)
        The numbers, SI units.
    columns : tuple of str
        Names of the k columns.
    """

    stamp_ns: Int64[np.ndarray, " N"]
    received_ns: Int64[np.ndarray, " N"]
    values: Float[np.ndarray, "N k"]
    columns: tuple[str, ...]

    def __post_init__(self) -> None:
        n, k = self.values.shape
        if len(self.columns) != k or len(self.stamp_ns) != n or len(self.received_ns) != n:
            raise ValueError("stamps, values and columns of a stream do not fit together")

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def __repr__(self) -> str:
        return f"Stream({len(self)} of {', '.join(self.columns)})"

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


@dataclass(frozen=True, repr=False)
class Recording:
    """Named streams of one flight, and where they came from.

    A recording never knows whether it was flown or simulated.

    Attributes
    ----------
    streams : mapping of str to Stream
        ``pose`` and ``command``, and where logged ``reference``, ``estimate``, ``imu``, ``mouse``;
        columns as in `COLUMNS`.
    source : str
        The file or folder.
    hashes : mapping of str to str
        SHA-256 of every file that was read, by name.
    warnings : tuple of str
        What was wrong with the files but could be lived with.
    """

    streams: Mapping[str, Stream]
    source: str
    hashes: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

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
            raise InputError(f"the {name} stream is empty", file=self.source)
        return stream


TopicName = Annotated[str, pydantic.Field(pattern=r"^/[^\s]+$")]


class Topics(Section):
    """Topic names; the defaults are those of the authors' table.

    A stream whose topic is not in the bag is left out, unless it is a pose or a command, or the
    topic was named by the user: then it is an error.

    Attributes
    ----------
    pose : str
        Motion capture: ``geometry_msgs/msg/PoseStamped`` or another stamped pose.
    command : str
        Motor commands: a header, then one float64 for each motor.
    reference : str
        What the craft was asked to do.
    estimate : str
        The state estimated on line.
    imu, mouse : str
        On-board sensors.
    """

    pose: TopicName = "/optitrack/drone/pose"
    command: TopicName = "/drone/control"
    reference: TopicName = "/control/state_ref"
    estimate: TopicName = "/navigation/state"
    imu: TopicName = "/drone/imu"
    mouse: TopicName = "/drone/mouse"

    @pydantic.model_validator(mode="after")
    def _distinct(self) -> Topics:
        names = list(self.by_stream.values())
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"{name} is named for two streams")
        return self

    @property
    def by_stream(self) -> dict[str, str]:
        """Stream name -> topic name."""
        return self.model_dump()

    def required(self, stream: str) -> bool:
        """Return whether a bag must have this stream.

        Parameters
        ----------
        stream : str
            A stream's name.

        Returns
        -------
        bool
            True for poses, commands and every topic that was named explicitly.
        """
        return stream in ("pose", "command") or stream in self.model_fields_set


class _TopicsFile(Section):
    topics: Topics = Topics()


def read_topics(path: str | os.PathLike[str]) -> Topics:
    """Read topic names from the ``[topics]`` section of a TOML file."""
    return read_toml(path, _TopicsFile).topics
