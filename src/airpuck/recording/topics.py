"""Which topic of a bag holds which stream."""

from __future__ import annotations

import os
from typing import Annotated

import pydantic

from airpuck.boundary.files import Section, read_toml

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
        """Say whether a bag without this stream's topic is an error.

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
