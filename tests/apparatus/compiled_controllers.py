"""The exported controller as a pilot, and flights that compare it with Python's."""

import ctypes
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

import airpuck
from airpuck import Model, Pilot, SetPoint, Step, TimedPath, TrackingController, Tuning
from airpuck.control.mpc import Ongoing
from airpuck.control.predictive import PredictiveSettings
from airpuck.control.reference import preview
from airpuck.control.tuning import default_tuning
from airpuck.estimate.estimator import Estimate
from airpuck.physics.rigid_body import step

from .c_programs import build

ACCESS = Path(__file__).parent / "controller_access.c"
#: Statuses in the order of `airpuck_status`.
STATUSES = (
    "exact",
    "scaled",
    "nearest",
    "optimal",
    "softened",
    "iteration limit",
    "fallback",
    "failed",
    "no pose",
    "stale pose",
    "jumping pose",
    "bad input",
)


def library(
    model: Model, folder: Path, *options: str, tuning: Tuning | None = None, using: str = "gcc"
) -> Path:
    """Export and compile a controller as a shared library."""
    airpuck.export.write(model, "c", folder, tuning=tuning)
    sources = [*(p for p in folder.glob("airpuck*.c")), ACCESS]
    shared = ("-shared", "-fPIC", "-fvisibility=default")
    return build(folder / "controller.so", sources, *shared, *options, using=using)


class CompiledController(Pilot):
    """An exported controller in a shared library."""

    def __init__(self, shared: Path, model: Model, tuning: Tuning | None = None) -> None:
        self.model, self.tuning = model, tuning or default_tuning()
        self._library: Any = ctypes.CDLL(str(shared))
        self._library.access_size.restype = ctypes.c_size_t
        self._craft = ctypes.create_string_buffer(self._library.access_size())
        self._library.airpuck_init(self._craft)
        settings, delay = self.tuning.of(PredictiveSettings), model.transport_delay
        ahead = [delay + self.tuning.period_s]
        if self.tuning.law.kind == "mpc":
            steps = max(round(settings.horizon_s / settings.step_s), 1)
            ahead += [delay + settings.step_s * k for k in range(1, steps + 1)]
        self._ahead, self._n = np.array(ahead), model.vehicle.n_propellers
        #: Poses and commands pass through one array: making a pointer takes longer than a step.
        self._passed = np.zeros(max(self._n, 3))
        self._pointer = self._numbers(self._passed)

    @staticmethod
    def _numbers(values: Any) -> Any:
        array = np.ascontiguousarray(values, dtype=float)
        return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        self._passed[:3] = pose
        self._library.access_pose(self._craft, ctypes.c_double(time), self._pointer)

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        self._passed[: self._n] = command
        self._library.access_sent(self._craft, ctypes.c_double(time), self._pointer)

    def targets(self, time: float) -> np.ndarray:
        """Return the targets of a step, one in each row."""
        wanted = preview(self.reference, time, self._ahead)
        first = self.reference.at(time, float(self._ahead[0]))
        rows = np.hstack([wanted.states, wanted.accelerations])
        rows[0] = np.concatenate([first.state, first.acceleration])
        return rows

    def run(self, time: float, targets: np.ndarray, command: np.ndarray) -> int:
        """Call the library: set the command, return the number of the status."""
        given, now = self._numbers(targets), ctypes.c_double(time)
        status = self._library.access_step(self._craft, now, given, self._pointer)
        command[:] = self._passed[: self._n]
        return status

    def replay(self, targets: np.ndarray, events: Float[np.ndarray, "count numbers"]) -> int:
        """Repeat a flight in one call: see `access_replay`; return the number of steps."""
        given, flown = self._numbers(targets), self._numbers(events)
        return self._library.access_replay(self._craft, given, flown, len(events))

    def step(self, time: float) -> Step:
        command = np.zeros(self._n)
        status = self.run(time, self.targets(time), command)
        found = np.zeros(12 + self._n)
        self._library.access_estimate(self._craft, self._numbers(found))
        estimate = Estimate(time, found[3:9], found[12:], found[9:12])
        return Step(command, STATUSES[status], found[:3], estimate)

    @property
    def iterations(self) -> int:
        """Iterations of the last quadratic program."""
        return self._library.access_iterations(self._craft)

    def take_plan(self, plan: Ongoing) -> None:
        """Replace the latest plan of the predictive law."""
        since, answered, way = map(ctypes.c_double, (plan.since, plan.answered, float(plan.way)))
        commands = self._numbers(plan.plan)
        self._library.access_plan(self._craft, commands, since, answered, way)

    def limits(self) -> np.ndarray:
        """Return which limits of the last plan are active."""
        active = (ctypes.c_int * 2000)()
        return np.array(active[: self._library.access_limits(self._craft, active)], dtype=bool)


class Difference(NamedTuple):
    """Two controllers' results of one step."""

    command: float
    state: float
    statuses: tuple[str, str]


@dataclass
class Comparison:
    """Differences between two controllers over a flight."""

    steps: list[Difference] = field(default_factory=list)

    def worst(self, name: str) -> float:
        """Return the largest difference in steps with equal statuses."""
        alike = [s for s in self.steps if s.statuses[0] == s.statuses[1]]
        return max((getattr(s, name) for s in alike), default=0.0)

    @property
    def same(self) -> float:
        """Fraction of steps with equal statuses."""
        return float(np.mean([s.statuses[0] == s.statuses[1] for s in self.steps]))

    @property
    def seen(self) -> Counter[str]:
        """Python's statuses."""
        return Counter(s.statuses[0] for s in self.steps)


class Table:
    """A craft that flies under random commands; its camera and its radio misbehave."""

    def __init__(self, model: Model, period: float, seed: int) -> None:
        self.model, self.period = model, period
        self.random = np.random.default_rng(seed)
        n = model.vehicle.n_propellers
        self.state = np.concatenate([np.zeros(6), np.full(n, model.vehicle.command_min)])
        self.now, self.frame = 0.0, 0

    def poses(self) -> list[tuple[float, np.ndarray]]:
        """Return stamps and poses received in the next period."""
        random, received = self.random, []
        while self.frame / 240 <= self.now + self.period:
            stamp, pose = self.frame / 240, self.state[:3] + random.normal(size=3) * [5e-5] * 3
            self.frame += 1
            fault = 0.4 * random.random()
            if fault < 0.004:
                pose = pose + random.normal(size=3) * [1.0, 1.0, 3.0]
            elif fault < 0.008:
                pose[random.integers(3)] = random.choice([math.nan, math.inf, -math.inf])
            elif fault < 0.012:
                stamp = random.choice([math.nan, math.inf, -math.inf, stamp - 0.01, stamp - 0.2])
            elif fault < 0.014:
                stamp += 0.03
            elif fault < 0.018:
                self.frame += random.integers(10, 40)
            elif fault < 0.3:
                pose[2] += 2 * math.pi * random.integers(-2, 3)
            # A float holds these too, so both precisions get the same poses.
            received.append((float(stamp), pose.astype(np.float32).astype(float)))
        return received

    def commands(self, command: np.ndarray) -> list[tuple[float, np.ndarray]]:
        """Return what is reported as sent: usually the command."""
        random, now = self.random, self.now
        fault = random.random()
        if fault < 0.01:
            return []
        if fault < 0.02:
            return [(float(random.choice([math.nan, math.inf, now + 0.2, now - 0.03])), command)]
        if fault < 0.03:
            return [(now, np.full_like(command, math.nan))]
        if fault < 0.04:
            return [(now - 0.004, command), (now, random.uniform(0, 1, len(command)))]
        return [(now, command)]

    def fly(self, command: np.ndarray) -> None:
        """Advance by one period."""
        self.now += self.period
        self.state = step(np, self.model.dynamics, self.state, command, self.period)
        if abs(self.state[:2]).max() > 1.2 or abs(self.state[5]) > 60:
            self.state[:6] = 0.0


def reference(random: np.random.Generator, now: float) -> Any:
    """Draw a reference: near, far, turned, or a path."""
    if random.random() < 0.3:
        poses = random.normal(size=(3, 3)) * [0.5, 0.3, 1.0]
        return TimedPath(now + np.array([0.0, 0.7, 1.5]), poses)
    scale = random.choice([0.01, 0.3, 3.0])
    return SetPoint(*(random.normal(size=3) * [scale, scale, 2.0]).tolist())


def compare(
    python: TrackingController,
    c: CompiledController,
    steps: int,
    seed: int = 0,
    after: Callable[[], object] = lambda: None,
) -> Comparison:
    """Fly both controllers side by side, on the same poses and commands."""
    table, found = Table(python.model, python.tuning.period_s, seed), Comparison()
    for k in range(steps):
        if k % 40 == 0:
            python.reference = c.reference = reference(table.random, table.now)
        for stamp, pose in table.poses():
            python.pose(stamp, pose)
            c.pose(stamp, pose)
        now = table.now + table.period
        if isinstance(python.state, Ongoing):
            # Each plan depends on the one before, so differences would grow from step to step.
            c.take_plan(python.state)
        ours, theirs = python.step(now), c.step(now)
        found.steps.append(_difference(ours, theirs))
        after()
        table.fly(ours.command)
        for time, command in table.commands(ours.command):
            python.sent(time, command)
            c.sent(time, command)
    return found


def _difference(ours: Step, theirs: Step) -> Difference:
    state = 0.0
    if ours.estimate is not None and theirs.estimate is not None:
        pairs = zip(_estimated(ours.estimate), _estimated(theirs.estimate), strict=True)
        apart = np.concatenate([a - b for a, b in pairs])
        apart[2] = math.remainder(apart[2], math.tau)
        state = float(np.abs(apart).max())
    command = float(np.abs(ours.command - theirs.command).max())
    return Difference(command, state, (ours.status, theirs.status))


def _estimated(estimate: Estimate) -> tuple[np.ndarray, ...]:
    return estimate.state, estimate.motor_speed, estimate.disturbance
