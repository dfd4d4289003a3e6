"""The predictive law's quadratic program: the physics, linearised along a plan of commands.

Pure functions over an array namespace. See docs/control.md, "Predictive control".

`Condensed` solves the program (`Stages`) in two parts. `form` is a pure function that lays out the
matrices; it is compiled together with the stages before it. `solve` returns the change of the plan
and whether a limit had to be exceeded, or None. Limits are soft, with an exact penalty: the cost is
proportional to the excess.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Num

from airpuck.compute.arrays import scan, slopes
from airpuck.control.authority import pushes
from airpuck.control.predictive import PredictiveSettings
from airpuck.craft.vehicle import Vehicle
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import Dynamics, acceleration, step, wrapped
from airpuck.physics.thrust import thrust_curvature

#: Bounds of the effectiveness used in the prediction. A dead motor keeps a little, so that the
#: controller notices when it recovers; no estimate may make the law timid.
_EFFECTIVENESS = (0.02, 1.5)
#: Fraction of the thrust assumed for braking before a fence.
_BRAKING = 0.5
#: Braking assumed where dead motors leave no thrust in some direction [m/s²].
_LEAST_BRAKING = 0.1
#: Distance to a fence per yaw rate, and its maximum [m s/rad, m].
TURNING, MOST_ROOM = 8e-4, 0.015
#: Yaw errors between which a plan keeps its direction of rotation: a little less than half a turn
#: either way [rad].
UNDECIDED = np.pi - 0.5
#: Below this speed, or this distance from a disc's centre, the direction is undefined [m/s, m].
_NOWHERE = 1e-9
#: Cost of a squared change of a command, apart from its effect. The linearisation holds only near
#: the plan: without this cost, plans of a craft that turns fast jump between two ways to brake.
_DAMPING = 0.5
#: DAQP's codes for the kinds of limits.
_HARD, _SOFT = 0, 8
#: The default, 1e-6, leaves commands up to 1e-4 from the solution.
_FEASIBLE = 1e-9
#: DAQP's exit flags for a solution within all limits, and for one beyond soft limits.
_OPTIMAL, _SOFTENED = 1, 2


@dataclass(frozen=True)
class Blocks:
    """Division of the horizon into steps, and of the steps into blocks with one command each."""

    #: Duration of a step [s].
    step: float
    #: Number of steps in each block.
    lengths: tuple[int, ...]

    @classmethod
    def of(cls, law: PredictiveSettings) -> Blocks:
        """Divide the horizon according to the settings; the last block may be shorter."""
        count = max(round(law.horizon_s / law.step_s), 1)
        given = law.block
        ends = np.cumsum([*given, *given[-1:] * count]).clip(max=count)
        return cls(law.step_s, tuple(np.diff(np.unique(ends), prepend=0).tolist()))

    @property
    def owner(self) -> Int[np.ndarray, " N"]:
        """The block of each step."""
        return np.repeat(np.arange(len(self.lengths)), self.lengths)

    @property
    def times(self) -> Float[np.ndarray, " N"]:
        """End times of the steps after the first command begins to act [s]."""
        return self.step * np.arange(1, sum(self.lengths) + 1)

    def shifted(self, plan: Float[np.ndarray, "B n"], elapsed: float) -> Float[np.ndarray, "B n"]:
        """Return a plan shifted in time: the mean of the old commands over each block.

        The last command is held.
        """
        return _shift(self, elapsed) @ plan


# Consecutive control times differ by one of a few values, all equal to a period up to rounding.
@lru_cache(maxsize=256)
def _shift(blocks: Blocks, elapsed: float) -> Float[np.ndarray, "B B"]:
    """Return the matrix that shifts a plan in time; see `Blocks.shifted`."""
    plan = np.eye(len(blocks.lengths))
    edges = blocks.step * np.concatenate([[0], np.cumsum(blocks.lengths)])
    beyond = np.append(edges, edges[-1] + max(elapsed, blocks.step))
    lasting = np.diff(beyond)[:, None] * np.concatenate([plan, plan[-1:]])
    total = np.concatenate([np.zeros_like(plan[:1]), np.cumsum(lasting, axis=0)])
    reached = [np.interp(edges + elapsed, beyond, column) for column in total.T]
    return np.diff(reached, axis=1).T / np.diff(edges)[:, None]


class Ahead(NamedTuple):
    """The reference at the ends of the steps."""

    #: x, y, γ and their rates.
    states: Float[np.ndarray, "N 6"]
    #: Accelerations to feed forward.
    accelerations: Float[np.ndarray, "N 3"]
    #: Weights of squared errors of the states.
    weights: Float[np.ndarray, "N 6"]
    #: Weight of the error at the end of the horizon; it replaces the last row of `weights`.
    terminal: Float[np.ndarray, "6 6"]


class Stages(NamedTuple):
    """A linear-quadratic problem in the changes of a plan: δu in each step, δz after it.

    min Σ |e + δz|²_weights + |a + felt δz|²_effort + |δφ|²_bend + |u + δu|²_used
    s.t. δz⁺ = [δp; 0] + onward (δz without position, δu),  lower ≤ G δz ≤ upper (soft).
    """

    #: States and accelerations along the plan, at the ends of the steps.
    states: Num[Any, "N s"]
    accelerations: Num[Any, "N 3"]
    #: Derivative of a state with respect to the previous state (without its position) and the
    #: command; a motor's speed depends on its own speed and command alone.
    onward: Num[Any, "N s p"]
    #: Derivative of the accelerations with respect to the state at that time (without its
    #: position).
    felt: Num[Any, "N 3 q"]
    #: Errors e of states and a of accelerations; weights of e.
    error: Num[Any, "N 6"]
    excess: Num[Any, "N 3"]
    weights: Num[Any, "N 6"]
    terminal: Num[Any, "6 6"]
    #: Weights of squared changes of motor speeds, from the curvature of the thrust curves.
    bend: Num[Any, "N n"]
    #: Remaining yaw, in the chosen direction of rotation.
    way: Num[Any, ""]
    #: The commands.
    plan: Num[Any, "B n"]
    #: Limits of linear functions of x, y, γ and their rates.
    limited: Num[Any, "N c 6"]
    lower: Num[Any, "N c"]
    upper: Num[Any, "N c"]


def stages(
    model: Model, blocks: Blocks, law: PredictiveSettings, reject_disturbance: bool
) -> Callable[..., Stages]:
    """Return prediction and linearisation as one function.

    (xp, state, motor speeds, disturbance, effectiveness, plan (B, n), the four arrays of `Ahead`,
    fence (2, 2), rows (K, 5)) → stages; see `airpuck.control.limits.KeepOut.row`.
    """
    dynamics, limits, owner = model.dynamics, law.limits, blocks.owner
    most, effort = model.vehicle.command_max, blocks.step * law.weights.efforts

    def posed(
        xp: Any,
        state: Num[Any, " 6"],
        speed: Num[Any, " n"],
        disturbance: Num[Any, " 3"],
        effectiveness: Num[Any, " n"],
        way: Num[Any, ""],
        plan: Num[Any, "B n"],
        wanted: Num[Any, "N 6"],
        feedforward: Num[Any, "N 3"],
        weights: Num[Any, "N 6"],
        terminal: Num[Any, "6 6"],
        fence: Num[Any, "2 2"],
        rows: Num[Any, "K 5"],
    ) -> Stages:
        effectiveness = xp.clip(effectiveness, *_EFFECTIVENESS)
        believed = replace(dynamics, thrust=dynamics.thrust * effectiveness[:, None])
        start, pushed = xp.concatenate([state, speed]), reject_disturbance * disturbance
        along = linearised(xp, believed, blocks.step, start, plan[owner], pushed)
        states, accelerations = along[:2]
        # Ignore whole turns; near half a turn, keep the chosen direction of rotation.
        left = state[2] - wanted[0, 2]
        apart = wrapped(xp, left)
        turned_over = (apart * way < 0) & (xp.abs(way) > UNDECIDED) & (xp.abs(apart) > UNDECIDED)
        apart = apart + 2 * np.pi * xp.sign(way) * turned_over
        error = states[:, :6] - wanted - (left - apart) * (np.arange(6) == 2)
        brake = braking(xp, believed, most)
        limited = _limits(xp, limits, brake, states[:, :6], fence, rows)
        asked = error, accelerations - feedforward, weights, terminal
        bend = _bend(xp, believed, effort, blocks.step, along, asked)
        return Stages(*along, *asked, bend, apart, plan, *limited)

    return posed


def _bend(
    xp: Any, dynamics: Dynamics, effort: Num[Any, " 3"], h: float, along: Any, asked: Any
) -> Num[Any, "N n"]:
    """Return the convex part of the Hessian that the curvature of the thrust curves adds.

    At full speed a motor's thrust curve is flat, so slowing it down seems to cost nothing. Without
    this term the next plan would slow it down.
    """
    states, _, onward, felt = along
    error, excess, weights, terminal = asked
    pushed, moving = effort * excess, felt.shape[2]
    ends = xp.concatenate([weights[:-1] * error[:-1], (terminal @ error[-1])[None]])
    by_push = xp.sum(felt * pushed[:, :, None], axis=1)
    slope = xp.pad(ends, ((0, 0), (0, moving - 4))) + xp.pad(by_push, ((0, 0), (2, 0)))

    def back(costate: Any, given: tuple[Any, Any]) -> tuple[Any, Any]:
        slope, onward = given
        by_motion = xp.sum(onward[:, :moving] * costate[:, None], axis=0)
        costate = slope + xp.concatenate([costate[:2], by_motion])
        return costate, costate

    # Cost gradient at each end of a step: its own, plus its effect on later steps, if any.
    after = xp.concatenate([onward[1:], xp.zeros_like(onward[:1])])
    _, costates = scan(xp, back, xp.zeros(states.shape[1]), (slope[::-1], after[::-1]))
    costates = xp.pad(costates[::-1], ((0, 1), (0, 0)))
    # A motor speed at the end of a step acts for half of that step and half of the next.
    mean = (costates[:-1] + costates[1:]) / 2
    price = h * mean[:, 3:6] + h * h / 2 * mean[:, :3] + pushed
    cos, sin = xp.cos(states[:, 2:3]), xp.sin(states[:, 2:3])
    forward, left, angular = np.asarray(dynamics.configuration)
    by_thrust = price[:, :1] * (cos * forward - sin * left)
    by_thrust = by_thrust + price[:, 1:2] * (sin * forward + cos * left) + price[:, 2:] * angular
    return xp.maximum(by_thrust * thrust_curvature(dynamics.thrust, states[:, 6:].T).T, 0.0)


def linearised(
    xp: Any,
    dynamics: Dynamics,
    duration: float,
    start: Num[Any, " s"],
    commands: Num[Any, "N n"],
    pushed: Num[Any, " 3"],
) -> tuple[Num[Any, "N s"], Num[Any, "N 3"], Num[Any, "N s p"], Num[Any, "N 3 q"]]:
    """Predict the craft under commands and a constant acceleration; see `Stages`."""
    h = duration
    push = xp.concatenate([h * h / 2 * pushed, h * pushed, xp.zeros(commands.shape[1])])

    def advance(state: Any, command: Any) -> tuple[Any, Any]:
        following = step(xp, dynamics, state, command[0], h) + push
        return following, following

    _, states = scan(xp, advance, start, (commands,))
    before = xp.concatenate([start[None], states[:-1]]).T
    size = before.shape[0]

    def onward(point: Any) -> Any:
        held = xp.concatenate([0 * point[:2], point[: size - 2]])
        return step(xp, dynamics, held, point[size - 2 :], h)

    def felt(point: Any) -> Any:
        return xp.stack(acceleration(xp, dynamics, point[:4], point[4:]))

    moving = xp.concatenate([before[2:], commands.T])
    by_state = xp.moveaxis(slopes(xp, onward, moving), (0, 1, 2), (2, 1, 0))
    after = states.T[2:]
    by_motion = xp.moveaxis(slopes(xp, felt, after), (0, 1, 2), (2, 1, 0))
    return states, felt(after).T + pushed, by_state, by_motion


def braking(xp: Any, dynamics: Dynamics, most: float) -> Num[Any, ""]:
    """Return an acceleration that a craft can reach in every direction [m/s²].

    A fraction of the acceleration that the working propellers reach in their weakest direction: the
    craft also turns and allocates, and packets get lost.
    """
    return xp.maximum(_BRAKING * xp.min(pushes(xp, dynamics, most)), _LEAST_BRAKING)


def _limits(
    xp: Any,
    limits: Any,
    brake: Num[Any, ""],
    states: Num[Any, "N 6"],
    fence: Num[Any, "2 2"],
    others: Num[Any, "K 5"],
) -> tuple[Num[Any, "N c 6"], Num[Any, "N c"], Num[Any, "N c"]]:
    """Write the limits as bounded linear functions of changes of the states."""
    count, one, free = len(states), np.eye(6), xp.zeros((len(states), 1))
    # Limit a craft that moves towards the fence only at a later time, and require that it can still
    # brake: at speed v, a position |v|/2a later lies v²/2a further on.
    later = limits.headway_s + xp.abs(states[:, 3:5]) / (2 * brake)
    # A craft that turns pushes in an unintended direction when a packet is late or lost.
    room = xp.minimum(TURNING * xp.abs(states[:, 5:]), MOST_ROOM)
    room = xp.minimum(room, (fence[1] - fence[0]) / 2)
    low, high = (fence[0] + room).T, (fence[1] - room).T
    bounded = [(one[i] + later[:, i, None] * one[3 + i], low[i], high[i]) for i in (0, 1)]
    if (most := limits.speed_m_s) is not None:
        along = _direction(xp, states[:, 3:5])
        bounded.append((xp.concatenate([free, free, free, along, free], axis=1), -np.inf, most))
    if (most := limits.spin_rad_s) is not None:
        bounded.append((one[5], -most, most))
    for other in others:
        given = xp.abs(other[2]) + xp.abs(other[3]) > 0
        away = xp.where(given, other[2:4], _direction(xp, states[:, :2] - other[:2]))
        row = xp.concatenate([away, xp.zeros((count, 4))], axis=1)
        bounded.append((row, away @ other[:2] + other[4], np.inf))

    def each(values: Any, *shape: int) -> Any:
        return xp.stack([xp.broadcast_to(value, (count, *shape)) for value in values], axis=1)

    rows, lows, highs = zip(*bounded, strict=True)
    limited = each(rows, 6)
    now = xp.sum(limited * states[:, None], axis=-1)
    return limited, each(lows) - now, each(highs) - now


def _direction(xp: Any, vectors: Num[Any, "N 2"]) -> Num[Any, "N 2"]:
    """Normalise vectors; a vector without a direction becomes zero."""
    length = xp.sqrt(xp.sum(vectors**2, axis=1, keepdims=True))
    return xp.where(length > _NOWHERE, vectors / xp.maximum(length, _NOWHERE), 0.0)


@dataclass(frozen=True, eq=False)
class Answer:
    """A solution."""

    #: Change of the plan.
    change: Float[np.ndarray, "B n"]
    #: Resulting changes of x, y, γ and their rates at the ends of the steps.
    moved: Float[np.ndarray, "N 6"]
    #: Active limits: of the commands, block by block; then of the states, step by step.
    binding: Bool[np.ndarray, " r"]
    #: Whether a limit of the states is exceeded.
    exceeded: bool


class Sizes:
    """Sizes and weights of the program."""

    def __init__(self, vehicle: Vehicle, blocks: Blocks, law: PredictiveSettings) -> None:
        w, n = law.weights, vehicle.n_propellers
        self.n, self.m = n, n * len(blocks.lengths)
        self.most = law.iterations
        self.penalty = law.limits.penalty
        #: Weights of accelerations, of commands, and of their changes.
        self.effort = w.efforts * blocks.step
        self.used = np.repeat(w.command * blocks.step * np.array(blocks.lengths), n)
        self.changed = self.used + _DAMPING
        self.least, self.greatest = vehicle.command_min, vehicle.command_max

    def __getstate__(self) -> dict[str, Any]:
        """Return everything except the solver's memory: the key of a compiled `form`."""
        return {k: v for k, v in vars(self).items() if k not in ("_model", "_senses", "_astray")}


class Condensed(Sizes):
    """DAQP on the commands alone, started from the last active set."""

    def __init__(
        self, vehicle: Vehicle, blocks: Blocks, law: PredictiveSettings, hard: Sequence[bool]
    ) -> None:
        super().__init__(vehicle, blocks, law)
        import daqp

        n, rows = self.n, len(hard) * len(blocks.owner)
        #: Whether a command is of the block of a step; whether two commands are of one motor.
        self._chosen = np.repeat(np.eye(len(blocks.lengths))[blocks.owner], n, axis=1)
        self._same = self._by_motor(np, np.tile(np.eye(n), (len(blocks.lengths), 1)))
        senses = np.tile(np.where(hard, _HARD, _SOFT), len(blocks.owner))
        self._senses = np.concatenate([np.full(self.m, _HARD), senses]).astype(np.intc)
        # Any feasible numbers will do here: DAQP allocates its memory for their sizes.
        empty = np.eye(self.m), np.zeros(self.m), np.zeros((rows, self.m))
        one = np.ones(self.m + rows)
        self._model = daqp.Model()
        self._model.setup(*empty, one, -one, self._senses)
        self._model.settings = {"iter_limit": self.most, "primal_tol": _FEASIBLE}
        self._astray = False
        # A violation s costs w s + w s²/2. DAQP's own setting for all rows applies to scaled rows.
        linear, curved = self.penalty * one, one / self.penalty
        self._model.soft_weights(rho_l=curved, rho_u=curved, w_l=linear, w_u=linear)

    def form(self, xp: Any, s: Stages) -> tuple[Any, ...]:
        """Eliminate the states: return Hessian, gradient, rows, bounds and the states."""
        m = self.m
        pose, speeds = self._moved(xp, s)
        pushes = sum(s.felt[:, :, i, None] * pose[:, None, 2 + i] for i in range(4))
        pushes = pushes + self._by_motor(xp, s.felt[:, :, 4:]) * speeds[:, None]
        weighted = xp.concatenate(
            [s.weights[:-1, :, None] * pose[:-1], (s.terminal @ pose[-1])[None]]
        )
        weighted, effort, rows, pushes = (
            part.reshape(-1, m) for part in (weighted, self.effort[:, None] * pushes, pose, pushes)
        )
        bent = (self._by_motor(xp, s.bend) * speeds).T @ speeds
        hessian = weighted.T @ rows + effort.T @ pushes + self._same * bent + xp.diag(self.changed)
        plan = xp.ravel(s.plan)
        gradient = xp.ravel(s.error) @ weighted + xp.ravel(s.excess) @ effort
        gradient = gradient + self.used * (plan - self.least)
        limited = (s.limited @ pose).reshape(-1, m)
        lower = xp.concatenate([self.least - plan, xp.ravel(s.lower)])
        upper = xp.concatenate([self.greatest - plan, xp.ravel(s.upper)])
        return hessian, gradient, limited, lower, upper, pose

    def _moved(self, xp: Any, s: Stages) -> tuple[Num[Any, "N 6 m"], Num[Any, "N m"]]:
        """Return how the commands change pose with rates, and the speed of their own motor.

        As they change no other motor, most products of the full matrices would be with zeros.
        """
        before, now = slice(4, 4 + self.n), slice(4 + self.n, None)
        held = xp.broadcast_to(np.eye(6, 2), (len(s.onward), 6, 2))
        slopes = xp.concatenate([held, s.onward[:, :6, :4]], axis=2)
        by_speed, by_command, decay, drive = (
            self._by_motor(xp, part)
            for part in (
                s.onward[:, :6, before],
                s.onward[:, :6, now],
                xp.diagonal(s.onward[:, 6:, before], axis1=1, axis2=2),
                xp.diagonal(s.onward[:, 6:, now], axis1=1, axis2=2),
            )
        )

        def onward(moved: Any, given: tuple[Any, ...]) -> tuple[Any, Any]:
            slope, by_speed, pushed, decay, driven = given
            pose = sum(slope[:, i, None] * moved[i] for i in range(6)) + by_speed * moved[6]
            following = xp.concatenate([pose + pushed, (decay * moved[6] + driven)[None]])
            return following, following

        given = slopes, by_speed, by_command * self._chosen[:, None], decay, drive * self._chosen
        _, moved = scan(xp, onward, xp.zeros((7, self.m)), given)
        return moved[:, :6], moved[:, 6]

    def _by_motor(self, xp: Any, values: Num[Any, "... n"]) -> Num[Any, "... m"]:
        """Repeat a value of each motor for each of its commands."""
        return xp.tile(values, self.m // self.n)

    def solve(self, formed: Sequence[Float[np.ndarray, "..."]]) -> Answer | None:
        """Solve from the last active set; start cold if the last attempt failed."""
        hessian, gradient, rows, lower, upper, pose = formed
        if not math.isfinite(hessian.sum() + gradient.sum() + rows.sum()):
            return None
        given = {"H": hessian, "f": gradient, "A": rows, "bupper": upper, "blower": lower}
        # The active set of a very different problem can make DAQP cycle. After a cold start that
        # ran out of iterations, however, its active set is worth continuing from. There is one
        # attempt per period, so the time stays bounded.
        start = {"sense": self._senses} if self._astray else {}
        if self._model.update(**given, **start) >= 0:
            x, _, flag, info = self._model.solve()
            if flag in (_OPTIMAL, _SOFTENED):
                self._astray = False
                binding, exceeded = info["lam"] != 0, flag == _SOFTENED
                return Answer(x.reshape(-1, self.n), pose @ x, binding, exceeded)
        self._astray = not self._astray
        return None
