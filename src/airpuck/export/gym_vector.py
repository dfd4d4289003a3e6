"""Flights to a goal and races as a vector environment: all craft in one program."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from jaxtyping import Int

from airpuck.boundary.errors import InputError
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
from airpuck.twin.batch import TwinBatch


class CourseVectorEnv(gymnasium.vector.VectorEnv[Observation, np.ndarray, np.ndarray]):
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
        "autoreset_mode": AutoresetMode.NEXT_STEP,
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
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(space, num_envs)
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
        seen.command(moving, commands)
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
        self._seen.begin(rows, "pose", starts)
        self._over[rows] = False

    def _observation(self) -> Observation:
        return {**self._seen.observation(), **self._task.observation()}

    def _info(self, success: np.ndarray) -> dict[str, Any]:
        return {"is_success": success, "_is_success": np.ones(self.num_envs, bool)}
