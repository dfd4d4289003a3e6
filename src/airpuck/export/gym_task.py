"""Shared parts of the environments: spaces, a controller's knowledge, courses with rewards."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary import numbers
from airpuck.boundary.arguments import chosen
from airpuck.boundary.errors import InputError, installed, unknown
from airpuck.craft.table import AirHockey
from airpuck.data.measurement import Measurement, MeasurementKind
from airpuck.export.kinds import refuse_actuators
from airpuck.model.model_file import Model, read_model
from airpuck.physics.rigid_body import wrapped
from airpuck.twin.experiments import COURSES, arrived, passes
from airpuck.twin.settings import TwinSettings, default_twin_settings, read_twin_settings
from airpuck.twin.twin import check_pose

with installed("environments need Gymnasium: pip install 'airpuck[gym]'"):
    from gymnasium import spaces

#: Time between commands, and the usual time limit of an episode [s].
PERIOD, LONGEST = 0.01, 10.0
#: Number of past commands in an observation: delay (21 ms) and lag (28 ms) still hide their effect.
_REMEMBERED = 5
#: Distance of starts and goals from the rails, in addition to the craft's radius [m].
_MARGIN = 0.05
#: Largest measured distance beyond the table's edge, as of a puck in the goal mouth [m].
_BEYOND = 0.1
#: Poses further apart in time give no rates: the body was out of sight [s].
_HIDDEN = 0.1
#: Seeds of twins and games lie below this.
SEEDS = 2**31

#: The rows of a batch of one.
_ALL = np.ones(1, bool)

#: Arrays by name, as docs/export.md describes them.
Observation = dict[str, np.ndarray]
#: A model, or what `airpuck.read_model` reads.
ModelSource = Model | str | os.PathLike[str]
#: Settings of the twin, or their file; by default the paper's.
TwinSource = TwinSettings | str | os.PathLike[str] | None


def read_world(model: ModelSource, twin: TwinSource) -> tuple[Model, TwinSettings]:
    """Return a model and the settings of its twin, from files or objects."""
    if not isinstance(model, Model):
        model = read_model(model)
    if twin is None:
        twin = default_twin_settings()
    elif not isinstance(twin, TwinSettings):
        twin = read_twin_settings(twin)
    return model, twin.without_on_board()


def checked_action(action: Any, shape: tuple[int, ...]) -> Float[np.ndarray, "*n"]:
    """Return motor commands, clipped as by the radio; raise InputError if they are not numbers."""
    try:
        command = np.array(action, dtype=float)
    except (TypeError, ValueError):
        command = np.full(0, np.nan)
    if command.shape != shape or not np.isfinite(command).all():
        size = " × ".join(map(str, shape))
        raise InputError(f"needs {size} finite numbers, one for each motor", field="action")
    return np.clip(command, 0.0, 1.0)


def given_poses(options: Mapping[str, Any] | None, size: int) -> dict[str, np.ndarray]:
    """Return the poses ``start`` and ``goal`` in the options of a reset, one for each craft."""
    found, known = {}, ["start", "goal"]
    for name, pose in dict(options or {}).items():
        if name not in known:
            raise InputError(unknown(name, known), field="options")
        try:
            found[name] = np.broadcast_to(np.array(pose, float), (size, 3))
        except (TypeError, ValueError):
            raise InputError("needs x, y [m] and yaw [rad]", field=name) from None
    return found


def action_space(model: Model) -> spaces.Box:
    """Return the space of motor commands."""
    refuse_actuators(model, "gym", ["on_off"])
    return spaces.Box(0.0, 1.0, (model.vehicle.n_propellers,), np.float64)


def observation_space(
    model: Model, equipment: AirHockey, bodies: Sequence[MeasurementKind], **more: spaces.Box
) -> spaces.Dict:
    """Return the space of the measured poses of some bodies, and of additional entries."""
    table = equipment.table
    high = np.array([table.length_m / 2 + _BEYOND, table.width_m / 2 + _BEYOND, math.pi])
    entries = {
        "time": real(0.0, math.inf, 1),
        "sent": real(0.0, 1.0, _REMEMBERED, model.vehicle.n_propellers),
    }
    for name in bodies:
        entries[name] = spaces.Box(-high, high, dtype=np.float64)
        entries[f"{name}_rate"] = real(-math.inf, math.inf, 3)
        entries[f"{name}_age"] = real(-math.inf, math.inf, 1)
    return spaces.Dict({**entries, **more})


def real(low: float, high: float, *shape: int) -> spaces.Box:
    """Return a box of numbers with the same limits."""
    return spaces.Box(low, high, shape, np.float64)


class Seen:
    """Knowledge of one controller, or of a batch: poses, rates, its own commands.

    Arrays have the batch as first axis.
    """

    def __init__(
        self, size: int, space: spaces.Dict, bodies: Sequence[MeasurementKind], clock_offset: float
    ) -> None:
        n = space["sent"].shape
        assert n is not None
        self._steps, self.sent = np.zeros(size, int), np.zeros((size, *n))
        self._high = {name: space[name].high for name in bodies}  # pyright: ignore
        self._stamp = {name: np.full(size, clock_offset) for name in bodies}
        self._clock_offset = clock_offset
        self.pose = {name: np.zeros((size, 3)) for name in bodies}
        self.rate = {name: np.zeros((size, 3)) for name in bodies}

    @property
    def time(self) -> Float[np.ndarray, " B"]:
        """Time since the beginning of each episode [s]."""
        return self._steps * PERIOD

    def begin(
        self,
        body: MeasurementKind,
        pose: Float[np.ndarray, "R 3"],
        rate: Float[np.ndarray, "R 3"] | float = 0.0,
        rows: Int[np.ndarray, " R"] | Bool[np.ndarray, " B"] = _ALL,
    ) -> None:
        """Begin with the exact initial pose of a body."""
        self._steps[rows], self.sent[rows] = 0, 0.0
        self._stamp[body][rows] = self._clock_offset
        self.pose[body][rows], self.rate[body][rows] = self._inside(body, pose), rate

    def command(self, sent: Float[np.ndarray, "B n"], rows: Bool[np.ndarray, " B"] = _ALL) -> None:
        """Store sent commands, and advance by a period."""
        latest = np.concatenate([sent[:, None], self.sent[:, :-1]], axis=1)
        self.sent = np.where(rows[:, None, None], latest, self.sent)
        self._steps += rows

    def see(
        self,
        rows: Bool[np.ndarray, " B"],
        body: MeasurementKind,
        stamp: Float[np.ndarray, " B"],
        pose: Float[np.ndarray, "B 3"],
    ) -> None:
        """Store measured poses; their differences give rates."""
        passed = stamp - self._stamp[body]
        new = rows & (passed > 0)
        pose, last = self._inside(body, pose), self.pose[body]
        moved = np.column_stack([pose[:, :2] - last[:, :2], wrapped(np, pose[:, 2] - last[:, 2])])
        rate = moved / np.where(new, passed, 1.0)[:, None]
        rate[passed > _HIDDEN] = 0.0
        self.rate[body] = np.where(new[:, None], rate, self.rate[body])
        self.pose[body] = np.where(new[:, None], pose, last)
        self._stamp[body] = np.where(new, stamp, self._stamp[body])

    def measured(self, measurements: Sequence[Measurement]) -> None:
        """Store the latest measurement of each body, for a batch of one."""
        latest: dict[MeasurementKind, Measurement] = {
            m.kind: m for m in measurements if m.kind in self.pose
        }
        for kind, m in latest.items():
            self.see(_ALL, kind, np.array([m.stamp]), m.values[None])

    def _inside(
        self, body: MeasurementKind, pose: Float[np.ndarray, "R 3"]
    ) -> Float[np.ndarray, "R 3"]:
        """Return poses with wrapped yaw, within the limits of their space."""
        high = self._high[body]
        return np.clip(np.column_stack([pose[:, :2], wrapped(np, pose[:, 2])]), -high, high)

    def observation(self) -> Observation:
        """Return the observations of the batch."""
        found: Observation = {"time": self.time[:, None], "sent": self.sent.copy()}
        for body, pose in self.pose.items():
            found[body], found[f"{body}_rate"] = pose.copy(), self.rate[body].copy()
            found[f"{body}_age"] = (self.time - self._stamp[body])[:, None]
        return found


class CourseTask:
    """Starts, points and goals of a batch of craft, and the progress of each.

    The reward is the decrease of the remaining length, minus the time [s]: a metre is worth a
    second. The remaining length is the path over the next points to the goal, plus the remaining
    rotation times the craft's radius [m]. It is a potential (Ng, Harada and Russell, 1999): its
    decreases have the same sum for all flights that reach the goal, so the fastest is the best.
    """

    def __init__(
        self,
        model: Model,
        settings: TwinSettings,
        course: str | None = None,
        limit_s: float = LONGEST,
        size: int = 1,
    ) -> None:
        numbers.GAME_TIME.check(limit_s, "limit_s")
        self.limit = limit_s
        self._fixed = None if course is None else chosen(course, COURSES, "course")
        self._radius, self._table = model.vehicle.radius_m, settings.table
        self._spread = np.append(np.array(self._table.reach(self._radius)) - _MARGIN, math.pi)
        if min(self._spread) <= 0:
            raise InputError("is too small for the craft to move", field="table")
        count = len(self._fixed[2]) if self._fixed else 0
        self.points, self.goal = np.zeros((size, count + 1, 2)), np.zeros((size, 3))
        #: Number of points passed; remaining length after each point, and the current one [m].
        self._passed, self._rows = np.zeros(size, int), np.arange(size)
        self._after, self._left = np.zeros((size, count + 1)), np.zeros(size)

    def draw(
        self, row: int, rng: np.random.Generator, given: Mapping[str, np.ndarray]
    ) -> tuple[Float[np.ndarray, " 3"], int]:
        """Begin an episode of one craft; return its start, and the twin's seed."""
        start, goal, via = self._fixed or (*rng.uniform(-1, 1, (2, 3)) * self._spread, ())
        start = np.array(given["start"][row] if "start" in given else start)
        goal = np.array(given["goal"][row] if "goal" in given else goal)
        for name, pose in (("start", start), ("goal", goal)):
            check_pose(pose, self._table, self._radius, name)
        self.goal[row], self.points[row] = goal, [*via, goal[:2]]
        legs = np.hypot(*np.diff(self.points[row], axis=0).T)
        self._after[row] = np.append(np.cumsum(legs[::-1])[::-1], 0.0)
        self._passed[row] = 0
        self._left[row] = self._remaining(np.tile(start, (len(self._rows), 1)))[row]
        return start, int(rng.integers(SEEDS))

    def judge(
        self, pose: Float[np.ndarray, "B 3"], rate: Float[np.ndarray, "B 3"]
    ) -> tuple[Float[np.ndarray, " B"], Bool[np.ndarray, " B"]]:
        """Return rewards of a period, and whether craft passed all points and are at the goal."""
        last = self.points.shape[1] - 1
        for _ in range(last):
            self._passed += (self._passed < last) & passes(pose, self.following)
        left = self._remaining(pose)
        reward, self._left = self._left - left - PERIOD, left
        at_rest = np.concatenate([self.goal, np.zeros_like(self.goal)], axis=1)
        there = arrived(np.concatenate([pose, rate], axis=1), at_rest)
        return reward, (self._passed == last) & there

    def observation(self) -> Observation:
        """Return goals and next points."""
        return {"goal": self.goal.copy(), "next": self.following.copy()}

    def space(self) -> dict[str, spaces.Box]:
        """Return the space of goals and next points."""
        high = np.array([self._table.length_m / 2, self._table.width_m / 2, math.inf])
        box = {"goal": high, "next": high[:2]}
        return {name: spaces.Box(-size, size, dtype=np.float64) for name, size in box.items()}

    @property
    def following(self) -> Float[np.ndarray, "B 2"]:
        """The next points, finally the goals."""
        return self.points[self._rows, self._passed]

    def _remaining(self, pose: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, " B"]:
        away = np.hypot(*(pose[:, :2] - self.following).T) + self._after[self._rows, self._passed]
        return away + self._radius * np.abs(wrapped(np, pose[:, 2] - self.goal[:, 2]))
