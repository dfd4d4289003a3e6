"""Gymnasium environments of the twin, single and as vectors: flights to a goal, and races.

Importing this module registers them: ``gymnasium.make("airpuck.export.gym:airpuck/SetPoint-v0")``.
docs/export.md describes observations, rewards and termination.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Int, UInt8
from PIL import Image, ImageDraw

from airpuck.boundary.errors import InputError, unknown
from airpuck.control.law import Pilot
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.craft.table import Table
from airpuck.data.measurement import Measurement, MeasurementKind
from airpuck.export.gym_task import (
    LONGEST,
    PERIOD,
    CourseTask,
    ModelSource,
    Observation,
    Seen,
    TwinSource,
    action_space,
    checked_action,
    given_poses,
    observation_space,
    read_world,
)
from airpuck.export.kinds import Subject
from airpuck.model.model_file import Model
from airpuck.twin.batch import TwinBatch
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import TwinSettings
from airpuck.twin.twin import Twin

import gymnasium  # isort: skip  # after gym_task, which says what to install
from gymnasium import spaces, vector  # isort: skip
from gymnasium.utils.seeding import np_random  # isort: skip

#: Pixels per metre, and room for the rails around the table [m].
_SCALE, _RAIL = 300, 0.03
#: Width of lines, and length of the mark that shows the yaw, in radii.
_OUTLINE, _MARK = 0.12, 0.9
_FLOOR, _RAILS, _LINE = (250, 250, 247), (70, 70, 70), (214, 214, 208)
#: Colours of a picture.
WHITE, BLACK, GREEN, BLUE, RED = (
    (255, 255, 255),
    (30, 30, 30),
    (0, 158, 115),
    (0, 114, 178),
    (213, 94, 0),
)


class DrawnDisc(NamedTuple):
    """A body or a goal to draw."""

    #: x, y [m], and the yaw [rad] if a mark shows it.
    pose: Any
    #: Radius [m].
    radius: float
    edge: tuple[int, int, int]
    #: None: an outline only.
    face: tuple[int, int, int] | None = WHITE


def picture(table: Table, discs: Iterable[DrawnDisc]) -> UInt8[np.ndarray, "height width 3"]:
    """Draw discs on a table, from back to front; y points up."""
    x, y = table.length_m / 2, table.width_m / 2
    size = [round(2 * _SCALE * (side + _RAIL)) for side in (x, y)]
    image = Image.new("RGB", (size[0], size[1]), _RAILS)
    pen = ImageDraw.Draw(image)

    def at(px: float, py: float) -> tuple[float, float]:
        return _SCALE * (px + x + _RAIL), _SCALE * (y + _RAIL - py)

    pen.rectangle([at(-x, y), at(x, -y)], _FLOOR)
    pen.line([at(0, y), at(0, -y)], _LINE, 2)
    for disc in discs:
        (px, py, *yaw), radius = disc.pose, disc.radius
        corners = [at(px - radius, py + radius), at(px + radius, py - radius)]
        pen.ellipse(corners, disc.face, disc.edge, round(_OUTLINE * radius * _SCALE))
        for angle in yaw:
            front = at(px + _MARK * radius * math.cos(angle), py + _MARK * radius * math.sin(angle))
            pen.line([at(px, py), front], disc.edge, round(_OUTLINE * radius * _SCALE))
    return np.array(image)


def drawn_puck(puck: Any, settings: TwinSettings) -> list[DrawnDisc]:
    """Return the puck as a disc, if there is one."""
    return (
        [] if puck is None else [DrawnDisc((puck.x, puck.y), settings.puck.radius_m, BLACK, BLACK)]
    )


def check_render_mode(mode: str | None, metadata: Mapping[str, Any]) -> None:
    """Raise InputError for an unknown render mode."""
    if mode is not None and mode not in metadata["render_modes"]:
        raise InputError(unknown(mode, metadata["render_modes"]), field="render_mode")


#: Stamps closer than this count as equal, since ages are rounded [s].
_SAME = 1e-9

#: Environments by name: class, vector environment if there is one, settings.
Environments = Mapping[str, tuple[str, str | None, dict[str, str]]]
_COURSES = "airpuck.export.gym:CourseEnv", "airpuck.export.gym:CourseVectorEnv"
ENVIRONMENTS: Environments = {
    "SetPoint": (*_COURSES, {}),
    "Race": (*_COURSES, {"course": "slalom"}),
}
#: Package that an export to this kind writes.
_PACKAGE = '''"""Environments of a craft, by this folder's name: "NAME:NAME/SetPoint-v0"."""

from pathlib import Path

from airpuck.export.gym import register

HERE = Path(__file__).resolve().parent
CRAFT = {"model": str(HERE / "model.toml"), "twin": str(HERE / "twin.toml")}
register(HERE.name, **CRAFT)
'''


def register(
    namespace: str = "airpuck", environments: Environments = ENVIRONMENTS, **settings: Any
) -> None:
    """Register environments as NAMESPACE/NAME-v0, with settings such as model and twin."""
    for name, (single, several, own) in environments.items():
        gymnasium.register(
            f"{namespace}/{name}-v0",
            entry_point=single,
            vector_entry_point=several,
            kwargs={**settings, **own},
        )


class PilotPolicy:
    """A pilot as a policy for one episode: it sees only the observations."""

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._stamps: dict[str, float] = {}

    def __call__(self, observation: Observation) -> np.ndarray:
        """Return the action."""
        pilot, now = self._pilot, float(observation["time"][0])
        for kind in ("pose", *pilot.watches):
            if kind in observation:
                stamp = now - float(observation[f"{kind}_age"][0])
                if stamp > self._stamps.get(kind, -math.inf) + _SAME:
                    self._stamps[kind] = stamp
                    pilot.measured(Measurement(kind, stamp, observation[kind]))
        if "goal" in observation:
            x, y = observation["next"].tolist()
            pilot.reference = SetPoint(x, y, float(observation["goal"][2]))
        command = pilot.step(now).command
        pilot.sent(now, command)
        return command


class TwinEnv(gymnasium.Env[Observation, Any]):
    """Base of the environments of one craft: a twin, stepped by one control period."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 100}  # pyright: ignore

    def _build(
        self,
        model: Model,
        settings: TwinSettings,
        bodies: Sequence[MeasurementKind],
        render_mode: str | None,
        **more: spaces.Box,
    ) -> None:
        check_render_mode(render_mode, self.metadata)
        self.model, self.settings, self.render_mode = model, settings, render_mode
        self._twin: Twin | None = None
        self.action_space = action_space(model)
        space: Any = observation_space(model, settings, bodies, **more)
        self.observation_space = space
        self._seen = Seen(1, space, bodies, settings.motion_capture.clock_offset_s)

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a picture of the true poses, if the render mode is ``rgb_array``.

        Returns
        -------
        array, shape (height, width, 3), or None
            8-bit colours; the table from above.

        Raises
        ------
        gymnasium.error.ResetNeeded
            Before the first reset.
        """
        if self.render_mode is None:
            return None
        if self._twin is None:
            raise gymnasium.error.ResetNeeded("call reset() before render()")
        puck = self._twin.world.puck
        discs = self._targets() + drawn_puck(puck and puck.state, self.settings)
        craft = DrawnDisc(self._twin.state[:3], self.model.vehicle.radius_m, BLACK)
        return picture(self.settings.table, [*discs, craft])

    def _targets(self) -> list[DrawnDisc]:
        """Return the goals to draw."""
        return []

    def _fly(self, action: Any) -> Twin:
        """Send a command, and advance by a control period."""
        if self._twin is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        command = checked_action(action, (self.model.vehicle.n_propellers,))
        self._twin.send(command)
        self._seen.command(command[None])
        self._seen.measured(self._twin.wait_until(float(self._seen.time[0])))
        return self._twin


class CourseEnv(TwinEnv):
    """Fly from rest to a goal, past the points of a course.

    Parameters
    ----------
    model : Model or path-like, default "paper:M3"
        The craft.
    twin : TwinSettings or path-like, optional
        Table, sensors, radio, effects; by default the paper's.
    course : str, optional
        A course of `airpuck race`; by default random starts and goals, without points.
    limit_s : float, default 10
        Time after which an episode is truncated [s].
    render_mode : str, optional
        ``rgb_array``: `render` returns pictures.

    Raises
    ------
    InputError
        If the course or the render mode is unknown, or the table too small.
    """

    def __init__(
        self,
        model: ModelSource = "paper:M3",
        twin: TwinSource = None,
        course: str | None = None,
        limit_s: float = LONGEST,
        render_mode: str | None = None,
    ) -> None:
        craft, settings = read_world(model, twin)
        self._task = CourseTask(craft, settings, course, limit_s)
        self._plant = build_plant(craft, settings)
        self._build(craft, settings, ("pose",), render_mode, **self._task.space())

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; the options ``start`` and ``goal`` replace the random poses."""
        super().reset(seed=seed)
        start, number = self._task.draw(0, self.np_random, given_poses(options, 1))
        self._twin = Twin(
            self.model,
            self.settings,
            seed=number,
            pose=(float(start[0]), float(start[1]), float(start[2])),
            plant=self._plant,
            logs=False,
        )
        self._seen.begin("pose", start[None])
        return self._observation(), {"is_success": False}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Send motor commands, and advance by a control period."""
        self._fly(action)
        seen = self._seen
        reward, (there,) = self._task.judge(seen.pose["pose"], seen.rate["pose"])
        late = bool(seen.time[0] >= self._task.limit)
        success = {"is_success": bool(there)}
        return self._observation(), float(reward[0]), bool(there), late and not there, success

    def _targets(self) -> list[DrawnDisc]:
        radius = self.model.vehicle.radius_m
        following = DrawnDisc(self._task.following[0], radius / 5, GREEN, GREEN)
        return [DrawnDisc(self._task.goal[0], radius, GREEN, None), following]

    def baseline(self) -> PilotPolicy:
        """Return a policy for one episode: the tracking controller, with the next point as goal."""
        rest = SetPoint(0.0, 0.0, 0.0)
        return PilotPolicy(TrackingController(self.model, rest, table=self.settings.table))

    def _observation(self) -> Observation:
        found = {**self._seen.observation(), **self._task.observation()}
        return {name: values[0] for name, values in found.items()}


class CourseVectorEnv(vector.VectorEnv[Observation, np.ndarray, np.ndarray]):
    """Many `CourseEnv` at once.

    With seed s, row i draws the same random numbers as a single environment with seed s + i. Only
    the noise and latency of its poses differ. The parameters are as for `CourseEnv`.

    Raises
    ------
    InputError
        If a `TwinBatch` cannot represent the craft or a fault.
    """

    metadata: ClassVar[dict[str, Any]] = {  # pyright: ignore
        "render_modes": [],
        "autoreset_mode": vector.AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        model: ModelSource = "paper:M3",
        twin: TwinSource = None,
        course: str | None = None,
        limit_s: float = LONGEST,
    ) -> None:
        if num_envs < 1:
            raise InputError("must be at least 1", field="num_envs")
        craft, settings = read_world(model, twin)
        self.num_envs = num_envs
        self._task = CourseTask(craft, settings, course, limit_s, num_envs)
        self.single_action_space = action_space(craft)
        space = observation_space(craft, settings, ("pose",), **self._task.space())
        self.single_observation_space = space
        self.action_space = vector.utils.batch_space(self.single_action_space, num_envs)
        self.observation_space = vector.utils.batch_space(space, num_envs)
        self._seen = Seen(num_envs, space, ("pose",), settings.motion_capture.clock_offset_s)
        self._batch = TwinBatch(
            craft, num_envs, limit_s, settings=settings, period=PERIOD, rng=self.np_random
        )
        self._generators: list[np.random.Generator] = []
        self._over = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin all episodes; options: ``start`` and ``goal``, one pose for all or one for each."""
        super().reset(seed=seed)
        if seed is not None or not self._generators:
            first = int(self.np_random.integers(2**31)) if seed is None else seed
            self._generators = [np_random(first + row)[0] for row in range(self.num_envs)]
            self._batch.rng = self.np_random
        self._begin(np.arange(self.num_envs), given_poses(options, self.num_envs))
        return self._observation(), self._info(np.zeros(self.num_envs, bool))

    def step(
        self, actions: Any
    ) -> tuple[Observation, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Send motor commands, and advance by a control period; finished episodes restart."""
        if not self._generators:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        commands = checked_action(actions, self.action_space.shape or ())
        moving, seen = ~self._over, self._seen
        if self._over.any():
            self._begin(np.flatnonzero(self._over), {})
        self._batch.step(commands, moving)
        seen.command(commands, moving)
        arrived, stamp, pose = self._batch.measured()
        seen.see(moving & arrived, "pose", stamp, pose)
        reward, there = self._task.judge(seen.pose["pose"], seen.rate["pose"])
        there &= moving
        late = (seen.time >= self._task.limit) & ~there
        self._over = there | late
        return self._observation(), np.where(moving, reward, 0.0), there, late, self._info(there)

    def _begin(self, rows: Int[np.ndarray, " R"], given: dict[str, np.ndarray]) -> None:
        """Begin the episodes of some rows."""
        drawn = [self._task.draw(row, self._generators[row], given) for row in rows.tolist()]
        starts = np.array([start for start, _ in drawn])
        self._batch.reset(rows, starts, [seed for _, seed in drawn])
        self._seen.begin("pose", starts, rows=rows)
        self._over[rows] = False

    def _observation(self) -> Observation:
        return {**self._seen.observation(), **self._task.observation()}

    def _info(self, success: np.ndarray) -> dict[str, Any]:
        return {"is_success": success, "_is_success": np.ones(self.num_envs, bool)}


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write model, twin settings and a package that registers the environments of this craft."""
    CourseTask(subject.model, subject.twin)  # check that there is room
    return write_environments(subject, folder, _PACKAGE, ENVIRONMENTS)


def write_environments(
    subject: Subject, folder: Path, package: str, environments: Environments
) -> dict[str, Any]:
    """Write model, twin settings and the code of a package; return facts for the user."""
    action_space(subject.model)  # check the actuators
    subject.model.save(folder / "model.toml")
    subject.twin.save(folder / "twin.toml")
    (folder / "__init__.py").write_text(package, encoding="utf-8")
    return {
        "environments": ", ".join(f"{name}-v0" for name in environments),
        "on-board sensors": "not in the observations",
    }


register()
