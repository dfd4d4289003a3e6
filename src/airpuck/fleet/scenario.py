"""Scenarios of a fleet: who flies from where to where, and what goes wrong."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck.boundary.errors import InputError, about, unknown
from airpuck.boundary.files import Fraction, NonNegative, Positive, Section, read_toml
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.fleet.agreement import Agreement
from airpuck.fleet.path import Reach, Route, reach_of
from airpuck.fleet.search import Journey, Taken, opening
from airpuck.model.model_file import Model, read_model
from airpuck.twin.settings import TwinSettings, default_twin_settings, read_twin_settings

#: x, y [m], yaw [rad].
Pose = tuple[float, float, float]
#: Command at which the paper's motors keep turning; as in `studies/motor_starts.py`.
_TURNING = 0.08
#: Largest number of craft; more would not find room on a table.
_MOST_CRAFT = 20


class FleetCraft(Section):
    """A craft of a scenario.

    Attributes
    ----------
    name : str
        Its name, and the namespace of its topics.
    model : str
        Model by which it is controlled, a file or ``paper:M3``.
    truth : str or None
        Model that the twin flies; by default the same.
    start : tuple of float
        Initial pose [m, m, rad].
    goal : tuple of float or None
        Pose to go to; without goals it takes a pose of the formation.
    goals : tuple of (time, x, y, yaw)
        Poses to go to, each from its time on [s, m, m, rad].
    """

    name: Annotated[str, pydantic.Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
    model: str = "paper:M3"
    truth: str | None = None
    start: Pose
    goal: Pose | None = None
    goals: tuple[tuple[float, float, float, float], ...] = ()


class Obstacle(Section):
    """A disc that does not move [m]."""

    x_m: float
    y_m: float
    radius_m: Positive


class Network(Section):
    """Messages between the craft: the share that is lost, and shortest and longest delay [s]."""

    loss: Fraction = 0.0
    delay_s: tuple[NonNegative, NonNegative] = (0.01, 0.02)


class Death(Section):
    """A craft whose motors and radio stop at a time [s]."""

    craft: str
    time_s: NonNegative


class Scenario(Section):
    """Several craft on one table.

    Attributes
    ----------
    craft : tuple of FleetCraft
        The craft; models may differ.
    formation : tuple of Pose
        Poses for the craft without goals, assigned so that squared distances have the least sum.
    obstacles : tuple of Obstacle
        Discs to avoid.
    network : Network
        The twin's messages between craft.
    deaths : tuple of Death
        Craft that die in flight.
    twin : str or None
        Settings file of the twin: table, cameras, radio.
    speed_m_s : float
        Largest speed.
    duration_s : float
        Longest flight.

    Examples
    --------
    >>> from airpuck.fleet.scenario import FleetCraft
    >>> alone = FleetCraft(name="h0", start=(0.0, 0.0, 0.0), goal=(0.1, 0.0, 0.0))
    >>> airpuck.Scenario(craft=(alone,), duration_s=5.0).speed_m_s
    1.2
    """

    craft: Annotated[tuple[FleetCraft, ...], pydantic.Field(min_length=1, max_length=_MOST_CRAFT)]
    formation: tuple[Pose, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()
    network: Network = Network()
    deaths: tuple[Death, ...] = ()
    twin: str | None = None
    speed_m_s: Positive = 1.2
    duration_s: Positive = 20.0


def _turning(tuning: Tuning, model: Model) -> Tuning:
    """Keep motors turning: after a start that fails, a craft leaves its path by centimetres."""
    actuation, most = model.vehicle.actuation, model.vehicle.command_max
    one_way = actuation.kinds == ("propeller",) and most > _TURNING
    return tuning.model_copy(update={"least_command": _TURNING}) if one_way else tuning


class Member:
    """A craft of a fleet with all that it needs to fly.

    Attributes
    ----------
    name : str
        Its name.
    model, truth : Model
        What its controller believes, and what the twin flies.
    tuning : Tuning
        Of its controller.
    reach : Reach
        What it can do on a path.
    start : Route
        Its path at the beginning: at rest.
    times, goals : array
        When each goal applies [s], and the poses [m, m, rad].
    """

    def __init__(self, craft: FleetCraft, model: Model, truth: Model, speed: float) -> None:
        self.name, self.model, self.truth = craft.name, model, truth
        self.tuning: Tuning = _turning(tuning_for(model), model)
        self.reach: Reach = reach_of(model, self.tuning, speed)
        self.start = Route.at_rest(0.0, craft.start)
        goals = craft.goals or [(0.0, *(craft.goal or craft.start))]
        self.times = np.array([time for time, *_ in goals])
        self.send_to(np.array([pose for _, *pose in goals], dtype=float))

    def send_to(self, goals: Float[np.ndarray, "N 3"]) -> None:
        """Set the goals; the craft turns to each the shorter way round."""
        yaws = np.unwrap([self.start.pose[2], *goals[:, 2]])[1:]
        self.goals = np.column_stack([goals[:, :2], yaws])

    def goal(self, now: float) -> Float[np.ndarray, " 3"]:
        """Return the goal at a time."""
        return self.goals[max(int(self.times.searchsorted(now, side="right")) - 1, 0)]


class Fleet:
    """A scenario, checked, with its models.

    Parameters
    ----------
    scenario : Scenario
        What to fly.
    folder : path-like
        Folder of the files that it names.

    Raises
    ------
    InputError
        If two craft have the same name, starts or goals overlap or are off the table, or a
        formation does not have a pose for each craft without goals.

    Examples
    --------
    >>> fleet = airpuck.read_fleet("into_square")
    >>> isinstance(fleet, airpuck.Fleet), fleet.names
    (True, ('h0', 'h1', 'h2', 'h3'))
    """

    def __init__(self, scenario: Scenario, folder: str | os.PathLike[str] = ".") -> None:
        self.scenario = scenario
        here = Path(folder)
        own = scenario.twin
        self.settings: TwinSettings = (
            default_twin_settings() if own is None else read_twin_settings(here / own)
        ).without_on_board()
        named = [name for one in scenario.craft for name in (one.model, one.truth) if name]
        models = {name: _read(name, here) for name in dict.fromkeys(named)}
        self.members = tuple(
            Member(one, models[one.model], models[one.truth or one.model], scenario.speed_m_s)
            for one in scenario.craft
        )
        self.names = tuple(one.name for one in self.members)
        #: Obstacles, with their radii as distances.
        self.obstacles = tuple(
            Taken(Route.at_rest(0.0, (one.x_m, one.y_m, 0.0)), one.radius_m)
            for one in scenario.obstacles
        )
        self._check_names()
        self._assign()
        self._check_places()

    def agreement(self, name: str, start: float | None = 0.0) -> Agreement:
        """Return the part of one craft in the agreement.

        Parameters
        ----------
        name : str
            The craft.
        start : float or None, default 0
            When the opening begins [s]; None: not yet, all rest at their starts.

        Returns
        -------
        Agreement
            On its path of the opening, with the others on theirs.
        """
        paths = [one.start for one in self.members]
        if start is not None:
            paths = [path.later(start) for path in self.opening]
        parts = {one.name: (one.reach, path) for one, path in zip(self.members, paths, strict=True)}
        return Agreement(name, *parts.pop(self.member(name).name), parts)

    @cached_property
    def opening(self) -> list[Route]:
        """Paths of all craft at the beginning; see `airpuck.fleet.search`."""
        journeys = [Journey(one.reach, one.start, one.goal(0.0)) for one in self.members]
        return opening(journeys, self.obstacles, self.settings.table)

    def member(self, name: str) -> Member:
        """Return a craft.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        Member
            The craft with all that it needs to fly.

        Raises
        ------
        InputError
            If no craft has this name.
        """
        found = next((one for one in self.members if one.name == name), None)
        if found is None:
            raise InputError(unknown(name, self.names), field="craft")
        return found

    def _check_names(self) -> None:
        """Raise InputError if two craft have one name, or an unknown one dies."""
        twice = [name for name in self.names if self.names.count(name) > 1]
        if twice:
            raise InputError(f"{twice[0]!r} is the name of two craft", field="craft.name")
        for death in self.scenario.deaths:
            if death.craft not in self.names:
                raise InputError(unknown(death.craft, self.names), field="deaths.craft")

    def _assign(self) -> None:
        """Give the poses of the formation to the craft without goals."""
        from scipy.optimize import linear_sum_assignment

        poses = np.array(self.scenario.formation).reshape(-1, 3)
        pairs = zip(self.members, self.scenario.craft, strict=True)
        free = [one for one, craft in pairs if craft.goal is None and not craft.goals]
        if not len(poses):
            return
        if len(poses) != len(free):
            problem = f"has {len(poses)} poses for {len(free)} craft without a goal"
            raise InputError(problem, field="formation")
        starts = np.array([one.start.pose for one in free])
        squares = np.sum((starts[:, None, :2] - poses[:, :2]) ** 2, axis=2)
        for row, column in zip(*linear_sum_assignment(squares), strict=True):
            free[row].send_to(poses[column][None])

    def _check_places(self) -> None:
        """Raise InputError if craft would overlap, at their starts or at their goals."""
        times = sorted({float(t) for one in self.members for t in one.times})
        self._check_apart("start", [one.start.pose for one in self.members])
        for time in times:
            self._check_apart("goal", [one.goal(time) for one in self.members])

    def _check_apart(self, field: str, poses: Sequence[Float[np.ndarray, " 3"]]) -> None:
        """Raise InputError for poses off the table, too close to each other, or on an obstacle."""
        rooms = [(o.x_m, o.y_m, o.radius_m, "an obstacle") for o in self.scenario.obstacles]
        for one, pose in zip(self.members, poses, strict=True):
            x, y = self.settings.table.reach(one.reach.room)
            if abs(pose[0]) > x or abs(pose[1]) > y:
                problem = (
                    f"({pose[0]:g}, {pose[1]:g}) of {one.name} is too close to a rail; x must lie "
                    f"within ±{x:.3g} m, y within ±{y:.3g} m"
                )
                raise InputError(problem, field=field)
            for ox, oy, room, name in rooms:
                least, gap = one.reach.room + room, math.dist(pose[:2], (ox, oy))
                if gap < least:
                    problem = (
                        f"of {one.name} is {gap:.3g} m from that of {name}; at least {least:.3g} m "
                        "are needed"
                    )
                    raise InputError(problem, field=field)
            rooms.append((*pose[:2], one.reach.room, one.name))


def _read(name: str, folder: Path) -> Model:
    """Read a model that a scenario names relative to its own folder."""
    beside = folder / name
    return read_model(str(beside) if beside.exists() else name)


def packaged_scenarios() -> tuple[str, ...]:
    """Return the names of the packaged scenarios."""
    folder = resources.files("airpuck") / "packaged" / "fleet"
    return tuple(sorted(one.name.removesuffix(".toml") for one in folder.iterdir()))


def read_fleet(source: str | os.PathLike[str]) -> Fleet:
    """Read a scenario: a TOML file, or the name of a packaged one.

    Parameters
    ----------
    source : path-like
        The file or name.

    Returns
    -------
    Fleet
        The scenario with its models.

    Raises
    ------
    InputError
        If it cannot be read, or craft would overlap.

    Examples
    --------
    >>> airpuck.read_fleet("obstacles").scenario.obstacles[0].radius_m
    0.07
    """
    name = os.fspath(source)
    known = packaged_scenarios()
    if name in known:
        with resources.as_file(resources.files("airpuck") / "packaged" / "fleet") as folder:
            return Fleet(read_toml(folder / f"{name}.toml", Scenario), folder)
    path = Path(name)
    if not path.suffix and not path.exists():
        raise InputError(unknown(name, [*known, "FILE.toml"]), field="SCENARIO")
    with about(name):
        return Fleet(read_toml(path, Scenario), path.parent)
