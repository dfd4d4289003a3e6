"""A lab's names of topics, files, columns and units: one TOML file for bags and CSV files."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
import pydantic
from jaxtyping import Float, Int64

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Section, read_toml

#: Unit -> kind of quantity, and size in m, rad or s.
UNITS = {
    "m": ("length", 1.0),
    "cm": ("length", 1e-2),
    "mm": ("length", 1e-3),
    "rad": ("angle", 1.0),
    "deg": ("angle", np.pi / 180),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
}
Unit = Literal["m", "cm", "mm", "rad", "deg", "s", "ms", "us", "ns"]
#: Bits of a mask that a float64 holds exactly.
MASK_BITS = 53
#: Entry of an array or list: ``data[2]``.
ENTRY = re.compile(r"(.+)\[(\d{1,9})\]")
#: Name of axes -> our x, y, z in terms of these.
AXES = {"Z-up": ("x", "y", "z"), "Y-up": ("x", "-z", "y"), "NED": ("x", "-y", "-z")}


def _topic_name(name: str) -> str:
    """Check that a topic has a printable name, which need not begin with a slash."""
    if not name.strip() or name != name.strip() or not name.isprintable():
        raise ValueError(f"{name!r} is not the name of a topic, such as /mocap/pose")
    return name


TopicName = Annotated[str, pydantic.AfterValidator(_topic_name)]
#: Name of a column, or path of a field in a message.
Name = Annotated[str, pydantic.Field(min_length=1)]


class Topics(Section):
    """Topic names; the defaults are the authors' table.

    A stream whose topic is not in the bag is left out. It is an error if the stream is required
    (usually pose and command) or the user named its topic.

    Attributes
    ----------
    pose : str
        Motion capture: ``geometry_msgs/msg/PoseStamped`` or another pose.
    command : str
        Motor commands: optionally a header, then a number for each motor.
    wheels : str
        Commands of reaction wheels, if they are not among the motor commands.
    reference : str
        Reference of the craft.
    estimate : str
        The state estimated online.
    imu, mouse : str
        On-board sensors.
    puck, mallet : str
        Motion capture of the puck and of the human's mallet or another craft: poses, like the
        craft's.
    mallet_target : str
        Target of the mallet from a person at a page.
    opponent_command : str
        Motor commands of another craft that plays, like the craft's.
    game : str
        Score and events of a game.
    """

    pose: TopicName = "/optitrack/drone/pose"
    command: TopicName = "/drone/control"
    wheels: TopicName = "/drone/wheels"
    reference: TopicName = "/control/state_ref"
    estimate: TopicName = "/navigation/state"
    imu: TopicName = "/drone/imu"
    mouse: TopicName = "/drone/mouse"
    puck: TopicName = "/optitrack/puck/pose"
    mallet: TopicName = "/optitrack/mallet/pose"
    mallet_target: TopicName = "/mallet/target"
    opponent_command: TopicName = "/opponent/control"
    game: TopicName = "/game/event"

    @pydantic.model_validator(mode="after")
    def _distinct(self) -> Topics:
        # One topic may hold several bodies; `RecordingMapping` checks their names.
        names = [v for k, v in self.by_stream.items() if k != "puck" or v != self.pose]
        if twice := [name for name, count in Counter(names).items() if count > 1]:
            raise ValueError(f"{twice[0]} is named for two streams")
        return self

    @property
    def by_stream(self) -> dict[str, str]:
        """Stream name -> topic name."""
        return self.model_dump()

    def within(self, namespace: str) -> Topics:
        """Return the same topics in a namespace.

        Parameters
        ----------
        namespace : str
            For example the name of a craft.

        Returns
        -------
        Topics
            Each begins with the namespace.
        """
        return Topics(**{k: f"/{namespace}{name}" for k, name in self.by_stream.items()})

    def required(self, stream: str, needs: Sequence[str] = ("pose", "command")) -> bool:
        """Return whether a bag must contain this stream.

        Parameters
        ----------
        stream : str
            A stream's name.
        needs : sequence of str, optional
            Streams that are required whatever topics are named.

        Returns
        -------
        bool
            True for these, and for every topic that was named explicitly.
        """
        return stream in needs or stream in self.model_fields_set


class Orientation(NamedTuple):
    """The notation of an orientation, and its columns or fields."""

    #: ``yaw``, ``quaternion``, ``matrix``, ``vector`` (axis times angle, only in exports), or the
    #: order of Euler angles as in SciPy (``XYZ``).
    kind: str
    #: For a quaternion x, y, z, w; for a matrix row by row.
    columns: tuple[str, ...]


_ORIENTATION = (
    'is "column" (yaw), {x = "column", y = …, z = …, w = …} (quaternion), nine columns (rotation '
    'matrix, row by row) or {XYZ = [three columns]} (Euler angles, "XYZ" about moving, "xyz" about '
    "fixed axes)"
)


def _orientation(given: Any) -> Orientation:
    """Parse the TOML form of an orientation."""

    def names(found: Any, count: int) -> tuple[str, ...] | None:
        fits = isinstance(found, list | tuple) and len(found) == count
        return tuple(found) if fits and all(isinstance(x, str) and x for x in found) else None

    kind, columns = "", None
    if isinstance(given, str):
        kind, columns = "yaw", names([given], 1)
    elif isinstance(given, list | tuple):
        kind, columns = "matrix", names(given, 9)
    elif isinstance(given, dict) and given.keys() == set("xyzw"):
        kind, columns = "quaternion", names([given[axis] for axis in "xyzw"], 4)
    elif isinstance(given, dict) and len(given) == 1:
        kind, found = next(iter(given.items()))
        if sorted(kind.lower()) == ["x", "y", "z"] and (kind.isupper() or kind.islower()):
            columns = names(found, 3)
    if columns is None:
        raise ValueError(_ORIENTATION)
    return Orientation(kind, columns)


class _Times(Section):
    """Common settings of poses and commands."""

    file: str = ""
    time: str = ""
    interval: str = ""
    start_s: float = 0.0
    units: tuple[Unit, ...] = ()

    @pydantic.model_validator(mode="after")
    def _one_clock(self) -> _Times:
        if self.time and self.interval:
            raise ValueError("time and interval exclude each other")
        return self

    @pydantic.field_validator("units")
    @classmethod
    def _one_of_each(cls, units: tuple[Unit, ...]) -> tuple[Unit, ...]:
        kinds = [UNITS[unit][0] for unit in units]
        for kind in kinds:
            if kinds.count(kind) > 1:
                raise ValueError(f"names two units of {kind}")
        return units

    def size(self, kind: str) -> float:
        """Return the size of the unit of length, angle or time; by default 1 (m, rad, s)."""
        return next((UNITS[unit][1] for unit in self.units if UNITS[unit][0] == kind), 1.0)


class PoseMapping(_Times):
    """Location, units and axes of poses.

    Names are columns of a CSV file, or fields of a bag's messages (``pose.pose.position.x``).
    Omitted names have defaults: the fields of ROS's pose messages, the columns of the authors' CSV
    files, or the header of a Motive or Qualisys export.

    Attributes
    ----------
    file : str
        CSV file, relative to the recording's folder.
    time : str
        Time; by default the header's stamp.
    interval : str
        For CSV files without times: column of the time since the previous row.
    start_s : float
        Offset added to times [s], for a clock that counts from the start of a take.
    units : tuple of str
        One each of ``m``, ``cm``, ``mm``; ``rad``, ``deg``; ``s``, ``ms``, ``us``, ``ns``. By
        default m, rad and s.
    position : tuple of str
        Two or three coordinates.
    orientation : Orientation, optional
        In TOML a column (yaw), ``{x = …, y = …, z = …, w = …}`` (quaternion), nine columns
        (rotation matrix, row by row) or ``{XYZ = […]}`` (Euler angles in SciPy's notation).
    axes : str or tuple of str
        ``"Z-up"``, ``"Y-up"`` (short for ``["x", "-z", "y"]``), ``"NED"`` (north, east, down,
        with a craft's axes forward, right, down: ``["x", "-y", "-z"]``), or our x, y, z in terms of
        the file's axes. The craft's own axes are renamed in the same way. The yaw is measured about
        the file's vertical axis, and has the sign of our z: ``["x", "-y", "z"]`` reverses y alone.
    origin_m : tuple of float
        Centre of the table in these coordinates, along our x and y [m].
    body : str
        Rigid body, if a table, a topic or an export contains several.
    rate_hz : float, optional
        The cameras' rate. Poses are then placed at this rate, however much their stamps vary; by
        default only if they were stamped on arrival, in bursts.
    stamps : str
        ``exact`` if stamps are times of exposure and must not be changed; empty: airpuck decides.

    Examples
    --------
    >>> poses = airpuck.PoseMapping(units=("mm", "deg"), axes="Y-up")
    >>> poses.axes
    ('x', '-z', 'y')
    """

    position: tuple[Name, ...] = ()
    orientation: Annotated[Orientation | None, pydantic.PlainValidator(_orientation)] = None
    axes: str | tuple[str, ...] = AXES["Z-up"]
    origin_m: tuple[float, float] = (0.0, 0.0)
    body: str = ""
    rate_hz: Annotated[float, pydantic.Field(gt=0, le=10_000)] | None = None
    stamps: Literal["", "exact"] = ""

    @pydantic.model_validator(mode="after")
    def _one_time(self) -> PoseMapping:
        if self.rate_hz and self.stamps:
            raise ValueError("rate_hz and stamps exclude each other")
        return self

    @pydantic.field_validator("position")
    @classmethod
    def _two_or_three(cls, position: tuple[str, ...]) -> tuple[str, ...]:
        if position and len(position) not in (2, 3):
            raise ValueError(f"needs two or three coordinates, not {len(position)}")
        return position

    @pydantic.field_validator("axes", mode="plain")
    @classmethod
    def _three_axes(cls, axes: Any) -> tuple[str, ...]:
        found = AXES.get(axes, axes) if isinstance(axes, str) else axes
        listed = found if isinstance(found, list | tuple) else ()
        if sorted(str(axis).removeprefix("-") for axis in listed) != ["x", "y", "z"]:
            raise ValueError(
                'is "Z-up", "Y-up", "NED", or our x, y and z in terms of the file\'s axes, as in '
                '["x", "-z", "y"]'
            )
        return tuple(listed)

    @property
    def permutation(self) -> tuple[Int64[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """The file's axes that our x, y, z correspond to, with their signs."""
        index = np.array(["xyz".index(axis[-1]) for axis in self.axes])
        return index, np.array([-1.0 if axis.startswith("-") else 1.0 for axis in self.axes])


_Mapping = TypeVar("_Mapping", bound=_Times)


def completed(mapping: _Mapping, usual: Mapping[str, Any]) -> _Mapping:
    """Fill in omitted settings of a mapping, each unit separately."""
    given = {name: getattr(mapping, name) for name in mapping.model_fields_set}
    kinds = {UNITS[unit][0] for unit in mapping.units}
    rest = tuple(unit for unit in usual.get("units", ()) if UNITS[unit][0] not in kinds)
    return mapping.model_copy(update={**usual, **given, "units": mapping.units + rest})


class CommandMapping(_Times):
    """Location of commands, their propellers, and conversion to fractions of full command.

    Attributes
    ----------
    file, time, interval, start_s, units
        As for poses; only the unit of time matters.
    values : tuple of str
        A column or field for each propeller, or a single one with all of them: an array of a
        message, a list in a cell (``"[1, 0, 1]"``), or, with `bits`, a bit mask. ``name[2]`` is an
        entry of an array or list. By default all columns that are not times; in a message, all
        numbers after its header.
    propellers : tuple of str
        The propeller that each value drives, by its name in the vehicle file. By default the names
        of the columns or fields; values without names are in the order of the vehicle file.
    scale, offset : float
        Command = scale · value + offset, which should be in [0, 1].
    neutral, span : float, optional
        The same for pulse widths: command = (value - neutral) / span, all in the value's unit.
    disarmed : float, optional
        A value that means stopped, such as the pulse that PX4 sends while disarmed.
    bits : tuple of int, optional
        The value is a bit mask of switches: the bit of each propeller, 0 for the least significant.
        If each hexadecimal digit is a switch, ``0x1010`` has the bits 12, 8, 4, 0 from left to
        right. Other bits are ignored.

    Examples
    --------
    >>> servo = airpuck.CommandMapping(neutral=1000.0, span=1000.0)  # pulses of 1 to 2 ms
    >>> t = np.arange(0.0, 1.0, 0.01)
    >>> pulses = np.full((100, 6), 1250.0)
    >>> mapping = airpuck.RecordingMapping(command=servo)
    >>> recording = airpuck.Recording.from_arrays(t, np.zeros((100, 3)), t, pulses, mapping=mapping)
    >>> recording["command"].values[0].tolist()
    [0.25, 0.25, 0.25, 0.25, 0.25, 0.25]
    """

    values: tuple[Name, ...] = ()
    propellers: tuple[Name, ...] = ()
    scale: float = 1.0
    offset: float = 0.0
    neutral: float | None = None
    span: float | None = None
    disarmed: float | None = None
    bits: tuple[Annotated[int, pydantic.Field(ge=0, lt=MASK_BITS)], ...] = ()

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> CommandMapping:
        for name in ("scale", "span"):
            if getattr(self, name) == 0:
                raise ValueError(f"{name}: must not be 0")
        pulses = {"neutral", "span"} & self.model_fields_set
        conversions = [{"scale", "offset"} & self.model_fields_set, pulses, self.bits]
        if sum(map(bool, conversions)) > 1:
            raise ValueError("scale and offset, neutral and span, and bits exclude each other")
        if len(pulses) == 1:
            raise ValueError("neutral and span: use both")
        if self.bits and len(self.values) > 1:
            raise ValueError("bits: a bit mask is one value; values names several")
        for names in (self.values, self.propellers, self.bits):
            if twice := [name for name in names if names.count(name) > 1]:
                raise ValueError(f"{twice[0]} is named twice")
        return self


class RecordingMapping(Section):
    """A lab's names of topics, files, columns and units.

    Attributes
    ----------
    topics : Topics
        Topics in a bag. For the authors' CSV files they determine the file names.
    pose : PoseMapping
        Poses.
    puck : PoseMapping
        Poses of the puck, if they are mapped differently. Without an orientation, positions alone.
    command : CommandMapping
        Commands.
    wheels : CommandMapping
        Commands of reaction wheels, if they have a topic of their own.

    Examples
    --------
    >>> mapping = airpuck.RecordingMapping(pose=airpuck.PoseMapping(units=("mm", "deg")))
    >>> mapping.pose.units
    ('mm', 'deg')
    """

    topics: Topics = Topics()
    pose: PoseMapping = PoseMapping()
    puck: PoseMapping = PoseMapping()
    command: CommandMapping = CommandMapping()
    wheels: CommandMapping = CommandMapping()

    @pydantic.model_validator(mode="after")
    def _two_bodies(self) -> RecordingMapping:
        if self.topics.pose == self.topics.puck and self.pose.body == self.puck.body:
            raise ValueError(
                f"topics: {self.topics.pose} is named for two streams; name a body for each, as in "
                'pose = {body = "craft"} and puck = {body = "puck"}'
            )
        return self

    @property
    def sections(self) -> dict[str, PoseMapping | CommandMapping]:
        """Stream name -> its section."""
        return {name: getattr(self, name) for name in ("pose", "puck", "command", "wheels")}

    def of_poses(self, stream: str) -> PoseMapping:
        """Return the section that applies to poses of a stream.

        Parameters
        ----------
        stream : str
            Name of the stream.

        Returns
        -------
        PoseMapping
            `puck` for the puck if the file has that section; otherwise `pose`.
        """
        if stream == "puck" and "puck" in self.model_fields_set:
            return self.puck
        # Another body has the units and axes of the craft, but not its name.
        named = stream != "pose" and self.pose.body
        return self.pose.model_copy(update={"body": ""}) if named else self.pose

    def of_commands(self, stream: str) -> CommandMapping:
        """Return the section that applies to commands of a stream.

        Parameters
        ----------
        stream : str
            Name of the stream.

        Returns
        -------
        CommandMapping
            `wheels` for reaction wheels with a topic of their own; otherwise `command`.
        """
        return self.wheels if stream == "wheels" else self.command


def read_mapping(path: str | os.PathLike[str]) -> RecordingMapping:
    """Read a mapping file.

    Parameters
    ----------
    path : path-like
        A TOML file with any of the tables ``[topics]``, ``[pose]``, ``[puck]``, ``[command]``,
        ``[wheels]``; see ``docs/mapping.md``.

    Returns
    -------
    RecordingMapping
        The mapping.

    Raises
    ------
    InputError
        If the file cannot be read or a field is wrong.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("lab.toml").write_text('pose.units = ["mm", "deg"]')
    >>> airpuck.read_mapping("lab.toml").pose.units
    ('mm', 'deg')
    """
    return read_toml(path, RecordingMapping)


def refuse_csv_settings(mapping: RecordingMapping, path: str | os.PathLike[str], form: str) -> None:
    """Raise InputError for settings of CSV files that come with another form of recording."""
    for stream, section in mapping.sections.items():
        if section.interval:
            problem = f"is {form}, whose messages have times; use interval only for CSV files"
            raise InputError(problem, file=path, field=f"{stream}.interval")
        if section.file:
            remedy = f'name a topic: topics = {{{stream} = "/..."}}'
            problem = f"is {form}, which has no such file; {remedy}"
            raise InputError(problem, file=path, field=f"{stream}.file")
