"""Short pulses, one motor at a time, before a flight: the pilot, and how the craft responds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.control.law import Pilot, Step
from airpuck.control.pose_gate import SHORTEST_PAUSE
from airpuck.control.reference import Numbers
from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle
from airpuck.data.sampling import runs
from airpuck.deviation.motor_regression import normal_equations, solved, twice_integrated
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_step
from airpuck.physics.thrust import thrust

#: Distance to the rails at which the test ends [m].
_MARGIN = 0.05
#: After a pause this long between two steps the test restarts [s].
_PAUSE = 0.2
#: Time span of poses used before a pulse begins and after it ends [s].
_BEFORE, _AFTER = 0.15, 0.25
#: Transport delays tried [s], and the longest step of integration [s].
DELAYS = np.arange(0.0, 0.15, 1e-3)
_STEP = 1e-3
#: Fewest poses on each side of a pulse for fitting a line.
_FEWEST = 20
#: A pulse shorter than this fraction of the usual length was cut off.
_CUT_OFF = 0.7
#: A pulse counts as disturbed if it fits this many times worse than the best of its motor.
_DISTURBED = 5.0


@dataclass(frozen=True)
class PulsePlan:
    """Amplitude and duration of the pulses."""

    #: Command of the motor under test; all others idle.
    level: float = 0.25
    #: Length of a pulse, and of the pause after it [s].
    length: float = 0.1
    rest: float = 0.3
    #: Number of pulses for each motor.
    rounds: int = 2

    def __post_init__(self) -> None:
        numbers.AMPLITUDE.check(self.level, "level")
        if not (0.02 <= self.length <= 1 and 0.25 <= self.rest <= 10):
            raise InputError("a pulse takes 0.02 to 1 s, the pause after it 0.25 to 10 s")
        numbers.PULSE_ROUNDS.check(self.rounds, "rounds")


class PulseTest(Pilot):
    """Gives each motor short pulses while all others idle; a `Pilot`.

    It assumes no layout, thrust or frame, since any of them may be wrong. The craft stays on the
    table because the pulses are short and the propellers of a pair alternate and undo each other's
    motion. The test ends near a rail or without poses. `motors` are tried in the order given;
    without them, all are, pairs first. `rested` are stamps and poses of a craft whose motors idled
    until now: this time counts as a pause before the first pulse.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        plan: PulsePlan | None = None,
        table: Table | None = None,
        motors: Sequence[int] | None = None,
        rested: Sequence[tuple[float, Float[np.ndarray, " 3"]]] = (),
    ) -> None:
        self.vehicle, self.plan = vehicle, plan or PulsePlan()
        if self.plan.level <= (idle := vehicle.command_min):
            raise InputError(f"must be above the command of an idle motor, {idle:g}", field="level")
        if not vehicle.actuators.possible(np.array([self.plan.level])).all():
            raise InputError("is too low to open a valve; use 1 for switches", field="level")
        if any(wheel.commanded == "speed" for wheel in vehicle.wheels):
            raise InputError(
                "a wheel whose speed is commanded gives no pulse of torque; use `airpuck check`",
                field="wheels.commanded",
            )
        paired = [index for pair in vehicle.opposed for index in pair]
        single = [k for k in range(vehicle.n_propellers) if k not in paired]
        order = [*paired, *_balanced(vehicle, single)]
        tried = order if motors is None else list(motors)
        self._order = tried * self.plan.rounds
        self.reach = np.array((table or Table()).reach(vehicle.radius_m))
        self._begun = self._stepped = -math.inf
        self.poses, self._rested = [*rested], self.plan.rest if rested else 0.0
        self.sent_commands: list[tuple[float, Float[np.ndarray, " n"]]] = []
        self.stopped = ""

    @property
    def duration(self) -> float:
        """Duration of the test, from the first pose on [s]."""
        return self.plan.rest + len(self._order) * (self.plan.length + self.plan.rest)

    @property
    def over(self) -> bool:
        """Whether every motor has had all its pulses."""
        return self._stepped - self._begun >= self.duration

    def pose(self, time: float, pose: Numbers) -> None:
        """Receive a pose; see `Pilot`."""
        values = np.array(pose, dtype=float)
        if math.isfinite(time) and values.shape == (3,) and np.isfinite(values).all():
            self.poses.append((time, values))

    def sent(self, time: float, command: Numbers) -> None:
        """Receive the command that was sent; see `Pilot`."""
        self.sent_commands.append((time, np.array(command, dtype=float)))

    def step(self, time: float) -> Step:
        """Return the command to send now; see `Pilot`."""
        idle = self.vehicle.idle
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
            channel = self.vehicle.actuation.channels[self._order[int(turn)]]
            idle[channel.column] = channel.sign * self.plan.level
        return Step(idle, "open loop", np.zeros(3), None)

    def _begin(self, time: float) -> None:
        """Begin the test, or restart it after a long pause."""
        earliest = time - max(self._rested, SHORTEST_PAUSE)
        recent = [(stamp, pose) for stamp, pose in self.poses if stamp > earliest]
        waited = time - recent[0][0] if recent else 0.0
        self._begun, self._rested, self.stopped = time - min(waited, self._rested), 0.0, ""
        self.poses, self.sent_commands = recent or self.poses[-1:], []

    def _reason_to_stop(self, age: float, pose: Float[np.ndarray, " 3"]) -> str:
        """Return why the motors must not be driven; empty if they may be."""
        if age > SHORTEST_PAUSE:
            return f"poses stopped coming {1e3 * age:.0f} ms ago"
        if (np.abs(pose[:2]) > self.reach - _MARGIN).any():
            x, y = pose[:2]
            return f"the craft is at a rail or off the table, x = {x:.3g} m, y = {y:.3g} m"
        return ""


def _balanced(vehicle: Vehicle, motors: list[int]) -> list[int]:
    """Order propellers without a partner so that each undoes the motion by those before it."""
    pushes, moved, order = vehicle.directions, np.zeros(2), list[int]()
    while len(order) < len(motors):
        left = [k for k in motors if k not in order]
        order.append(min(left, key=lambda k: float(np.linalg.norm(moved + pushes[k]))))
        moved = moved + pushes[order[-1]]
    return order


@dataclass(frozen=True, eq=False)
class PulseResponse:
    """The effect of one pulse."""

    #: Index of the propeller.
    motor: int
    #: Body accelerations per unit of modelled thrust, like a column of Π [1/kg, 1/kg, 1/(kg m)].
    effect: Float[np.ndarray, " 3"]
    #: Delay from the command's stamp to the motion, from the best fit [s].
    delay: float
    #: Root mean square of the residuals, in standard deviations of the poses' noise.
    misfit: float
    #: Sum of their squares for each delay that was tried.
    costs: Float[np.ndarray, " D"]
    #: Inverse of the effect's covariance, from the poses' noise.
    information: Float[np.ndarray, "3 3"]


def pulse_responses(
    model: Model,
    time: Float[np.ndarray, " N"],
    pose: Float[np.ndarray, "N 3"],
    command_time: Float[np.ndarray, " K"],
    command: Float[np.ndarray, "K n"],
    delays: Float[np.ndarray, " pulses"] | None = None,
) -> list[PulseResponse]:
    """Measure the effect of each pulse of a recorded test.

    Around a pulse, which begins at rest, position and yaw are

        p(t) = p₀ + v₀ t + a₀ t²/2 + ∬ R(γ) g F(t - d),
        γ(t) = γ₀ + ω₀ t + ω₀' t²/2 + ∬ g_γ F(t - d),

    where F is the thrust that the model expects of the motor, a₀ and ω₀' are constant accelerations
    (idling propellers, a tilted table), and g is the unknown effect. For a delay d this is a linear
    regression; d is the delay with the smallest residual. The poses are neither smoothed nor
    differentiated. A slow motor still pushes after its pulse, so the remaining effect of the
    previous pulse is subtracted first, for each delay.
    """
    pulses = find_pulses(command_time, command, model.vehicle.command_min)
    # Slow cameras need longer for the same number of poses.
    enough = (_FEWEST + 1) * float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    before, after = max(_BEFORE, enough), max(_AFTER, enough)
    usual = np.median([end - begin for _, begin, end in pulses]) if pulses else 0.0
    responses, last = [], None
    for motor, begin, end in pulses:
        near = (time > begin - before) & (time < end + after)
        early, late = time[near] < begin, time[near] > end
        level = float(command[np.searchsorted(command_time, begin), motor])
        pulse, earlier, last = _Pulse(motor, begin, end, level), last, None
        if end - begin < _CUT_OFF * usual or min(early.sum(), late.sum()) < _FEWEST:
            continue
        tried = DELAYS if delays is None else delays[len(responses) :][:1]
        found, effects = _response(model, pulse, time[near], pose[near], tried, earlier)
        responses.append(found)
        last = pulse, effects
    return responses


def sound_pulses(
    responses: Sequence[PulseResponse], radius: float, started: float
) -> dict[int, list[PulseResponse]]:
    """Return each motor's responses, without those that were disturbed or had a failed start.

    Moments count by their acceleration at the radius of gyration [m]. A motor that has not started
    gives less than the fraction `started` of its largest effect. If none is left, all count.
    """
    found: dict[int, list[PulseResponse]] = {}
    for one in responses:
        found.setdefault(one.motor, []).append(one)
    for motor, own in found.items():
        size = np.linalg.norm([one.effect * [1.0, 1.0, radius] for one in own], axis=1)
        misfit = np.array([one.misfit for one in own])
        good = (misfit <= _DISTURBED * misfit.min()) & (size > started * size.max())
        found[motor] = list(compress(own, good)) or own
    return found


def find_pulses(
    command_time: Float[np.ndarray, " K"], command: Float[np.ndarray, "K n"], idle: float
) -> list[tuple[int, float, float]]:
    """Find the stretches in which one motor runs and all others idle."""
    running = command > idle + 1e-6
    alone = running.sum(axis=1) == 1
    found = [
        (motor, float(command_time[first]), float(command_time[last]))
        for motor, own in enumerate(running.T)
        for first, last in runs(own & alone)
        if last < len(alone)
    ]
    return sorted(found, key=lambda pulse: pulse[1])


@dataclass(frozen=True)
class _Pulse:
    """A pulse of one motor, with the times of its commands."""

    motor: int
    begin: float
    end: float
    level: float


def _response(
    model: Model,
    pulse: _Pulse,
    time: Float[np.ndarray, " M"],
    pose: Float[np.ndarray, "M 3"],
    delays: Float[np.ndarray, " D"],
    last: tuple[_Pulse, Float[np.ndarray, "D 3"]] | None,
) -> tuple[PulseResponse, Float[np.ndarray, "D 3"]]:
    """Regress the poses around a pulse on its possible effects, for all delays at once.

    `last` is the pulse before, with its effects.
    """
    elapsed = time - pulse.begin
    always = np.stack([np.ones_like(elapsed), elapsed, elapsed**2 / 2], axis=1)
    basis = np.linalg.qr(always)[0]
    before = always[elapsed < 0], pose[elapsed < 0]
    variance = np.var(before[1] - before[0] @ np.linalg.lstsq(*before, rcond=None)[0], axis=0)
    variance[:2] = variance[:2].mean()
    noise = np.sqrt(np.maximum(variance, np.finfo(float).tiny))

    def beyond(values: np.ndarray) -> np.ndarray:
        """Project out the constant accelerations; return values in units of the noise."""
        left = values - np.tensordot(basis, np.tensordot(basis.T, values, 1), 1)
        left = np.moveaxis(left / noise.reshape(3, *(1,) * (values.ndim - 2)), -1, 0)
        return left.reshape(len(left), -1, *left.shape[3:])

    seen = np.repeat(pose[..., None], len(delays), axis=-1)
    if last is not None:
        moved = _motion(model, last[0], time, pose[:, 2], delays)
        seen = seen - np.einsum("micd,dc->mid", moved, last[1])
    rows, aim = beyond(_motion(model, pulse, time, pose[:, 2], delays)), beyond(seen)
    information, score, square = normal_equations(rows, aim)
    effects, _ = solved(information, score, np.zeros((3, 3)))
    cost = square - (effects * score).sum(axis=1)
    best = int(cost.argmin())
    misfit = float(np.sqrt(max(cost[best], 0.0) / aim.shape[1]))
    given = pulse.motor, effects[best], float(delays[best]), misfit, cost, information[best]
    return PulseResponse(*given), effects


def _motion(
    model: Model,
    pulse: _Pulse,
    time: Float[np.ndarray, " M"],
    yaw: Float[np.ndarray, " M"],
    delays: Float[np.ndarray, " D"],
) -> Float[np.ndarray, "M 3 3 D"]:
    """Return x, y and yaw per unit of each component of a pulse's effect, for each delay."""
    grid = np.union1d(np.arange(time[0], time[-1], _STEP), time)
    turned = np.interp(grid, time, yaw)[:, None]
    force = _force(model, pulse, grid[:, None] - pulse.begin - delays)
    shapes = np.stack([np.cos(turned) * force, np.sin(turned) * force, force], axis=1)
    moved = twice_integrated(shapes, np.diff(grid)[:, None])[np.searchsorted(grid, time)]
    along, across, turning = np.moveaxis(moved, 1, 0)
    none = np.zeros_like(along)
    # The rows of x, y and γ, for the forces along and across and the moment.
    columns = [[along, -across, none], [across, along, none], [none, none, turning]]
    return np.moveaxis(np.array(columns), 2, 0)


def _force(
    model: Model, pulse: _Pulse, elapsed: Float[np.ndarray, "G D"]
) -> Float[np.ndarray, "G D"]:
    """Return the modelled thrust of a motor beyond its idling thrust [N]."""
    motor, level, length = pulse.motor, pulse.level, pulse.end - pulse.begin
    lags, idle = np.ravel(model.dynamics.lag), model.vehicle.command_min
    lag = float(np.broadcast_to(lags, model.vehicle.n_propellers)[motor])
    peak = motor_step(np, idle, level, np.clip(elapsed, 0.0, length), lag)
    speed = motor_step(np, peak, idle, np.maximum(elapsed - length, 0.0), lag)
    # Motors without lag follow at once, even in the first instant before the pulse.
    speed = np.where(elapsed < 0, idle, np.where(elapsed <= length, peak, speed))
    curve = np.asarray(model.dynamics.thrust)[motor : motor + 1]
    return thrust(curve, speed[None])[0] - thrust(curve, np.array([[[idle]]]))[0]
