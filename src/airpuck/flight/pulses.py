"""Short pulses, one motor at a time: the pilot of a check before flight."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.control.law import Step
from airpuck.control.pilot import Pilot
from airpuck.control.reference import Numbers
from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle

#: Nothing is sent without a pose from the last 50 ms.
_STALE = 0.05
#: Distance to the rails at which the test ends [m].
_MARGIN = 0.05
#: After a pause this long between two steps the test restarts [s].
_PAUSE = 0.2


@dataclass(frozen=True)
class PulsePlan:
    """How strong and how long the pulses are."""

    #: Command of the motor whose turn it is; all others idle.
    level: float = 0.25
    #: Length of a pulse, and of the pause after it [s].
    length: float = 0.1
    rest: float = 0.3
    #: How often each motor has its turn.
    rounds: int = 2

    def __post_init__(self) -> None:
        numbers.AMPLITUDE.check(self.level, "level")
        if not (0.02 <= self.length <= 1 and 0.25 <= self.rest <= 10):
            raise InputError("a pulse takes 0.02 to 1 s, the pause after it 0.25 to 10 s")
        numbers.PULSE_ROUNDS.check(self.rounds, "rounds")


class PulseTest(Pilot):
    """Gives each motor short pulses while all others idle; a `Pilot`.

    It assumes no layout, thrust or frame, since any of them may be wrong. The craft stays on the
    table because the pulses are short, the propellers of a pair take turns and undo each other's
    motion, and the test ends near a rail or without poses.
    """

    def __init__(
        self, vehicle: Vehicle, plan: PulsePlan | None = None, table: Table | None = None
    ) -> None:
        self.vehicle, self.plan = vehicle, plan or PulsePlan()
        if self.plan.level <= (idle := vehicle.command_min):
            raise InputError(f"must be above the command of an idle motor, {idle:g}", field="level")
        paired = [index for pair in vehicle.pair_indices for index in pair]
        single = [k for k in range(vehicle.n_propellers) if k not in paired]
        self._order = [*paired, *single] * self.plan.rounds
        self.reach = np.array((table or Table()).reach(vehicle.radius_m))
        self._begun = self._stepped = -math.inf
        self.poses: list[tuple[float, Float[np.ndarray, " 3"]]] = []
        self.sent_commands: list[tuple[float, Float[np.ndarray, " n"]]] = []
        self.stopped = ""

    @property
    def duration(self) -> float:
        """How long the test takes, from the first pose on [s]."""
        return self.plan.rest + len(self._order) * (self.plan.length + self.plan.rest)

    @property
    def over(self) -> bool:
        """Whether every motor has had its turns."""
        return self._stepped - self._begun >= self.duration

    def pose(self, time: float, pose: Numbers) -> None:
        """Take note of a pose; see `Pilot`."""
        values = np.array(pose, dtype=float)
        if math.isfinite(time) and values.shape == (3,) and np.isfinite(values).all():
            self.poses.append((time, values))

    def sent(self, time: float, command: Numbers) -> None:
        """Take note of what was sent; see `Pilot`."""
        self.sent_commands.append((time, np.array(command, dtype=float)))

    def step(self, time: float) -> Step:
        """Return the command to send now; see `Pilot`."""
        idle = np.full(self.vehicle.n_propellers, self.vehicle.command_min)
        if not self.poses:
            return Step(idle, "no pose", np.zeros(3), None)
        if time - self._stepped > _PAUSE:
            self._begin(time)
        self._stepped = time
        stamp, pose = self.poses[-1]
        if not self.stopped:
            self.stopped = self._reason_to_stop(time - stamp, pose)
        if self.stopped:
            return Step(idle, "stale pose", np.zeros(3), None)
        # A nanosecond keeps rounding from moving a pulse by a period.
        elapsed = time - self._begun - self.plan.rest + 1e-9
        turn, phase = divmod(elapsed, self.plan.length + self.plan.rest)
        if 0 <= turn < len(self._order) and phase < self.plan.length - 2e-9:
            idle[self._order[int(turn)]] = self.plan.level
        return Step(idle, "open loop", np.zeros(3), None)

    def _begin(self, time: float) -> None:
        """Begin the test, at first or again, and forget what came long before."""
        self._begun, self.stopped = time, ""
        recent = [(stamp, pose) for stamp, pose in self.poses if stamp > time - _STALE]
        self.poses, self.sent_commands = recent or self.poses[-1:], []

    def _reason_to_stop(self, age: float, pose: Float[np.ndarray, " 3"]) -> str:
        """Return why the motors must not be driven; empty if they may."""
        if age > _STALE:
            return f"poses stopped coming {1e3 * age:.0f} ms ago"
        if (np.abs(pose[:2]) > self.reach - _MARGIN).any():
            x, y = pose[:2]
            return f"the craft is at a rail or off the table, x = {x:.3g} m, y = {y:.3g} m"
        return ""
