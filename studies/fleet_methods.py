"""Other ways to move several craft: the published formulation, Voronoi cells, one problem for all.

The first two replan 20 times a second with a double integrator over one second, and give the plan
to the same controller, on the same twin, as `airpuck.fleet`.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import daqp
import numpy as np
from jaxtyping import Float

from airpuck.control.law import Step
from airpuck.fleet.path import Route, braked
from airpuck.fleet.pilot import FleetPilot, Sighting
from airpuck.fleet.scenario import Fleet, Member

#: Period of planning [s], and number of periods in a plan.
DT, STEPS = 0.05, 20
#: Published limits: acceleration along each axis [m/s²], yaw [rad/s²], distance of centres [m].
PUSH, TURN, APART = 5.0, 15.0, 0.2
#: Weights of position, speed and acceleration, and of a missing separation; the published ones are
#: not known. These bring one craft across the table about as fast as `Reach` allows.
_PLACE, _SPEED, _PUSH, _SOFT = 10.0, 2.0, 0.3, 1e4
#: Number of tangents instead of the circle that bounds an acceleration.
_SIDES = 8
#: A craft slower than this [m/s], and farther from its goal than this [m], is stuck. After this
#: time it aims to the right of its goal by this angle, for as long [s, rad].
_SLOW, _AWAY, _STUCK, _RIGHT = 0.05, 0.02, 0.5, math.radians(80)

# Position and speed after 1 … STEPS periods, per acceleration.
_late = np.arange(1, STEPS + 1)[:, None] - np.arange(STEPS)
_P = np.where(_late > 0, _late - 0.5, 0.0) * DT**2
_V = np.where(_late > 0, 1.0, 0.0) * DT
_T = DT * np.arange(1, STEPS + 1)


class TimedPilot(FleetPilot):
    """Our pilot, with the processor time of each step on request; measuring costs time."""

    timed = False

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        #: Processor times of all steps [s].
        self.processor: list[float] = []

    def step(self, time: float) -> Step:
        """Let the pilot act."""
        if not self.timed:
            return self.act(time)
        began = clock.process_time()
        step = self.act(time)
        self.processor.append(clock.process_time() - began)
        return step

    def act(self, time: float) -> Step:
        """Compute the command."""
        return super().step(time)


@dataclass(frozen=True)
class Plan:
    """A plan as others hear it: places after 1 … STEPS periods."""

    sender: str
    time: float
    places: Float[np.ndarray, "20 2"]

    def at(self, times: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N 2"]:
        """Return its places at several times; it rests after its end."""
        own = self.time + _T
        return np.stack([np.interp(times, own, column) for column in self.places.T], axis=1)


class Replanning(TimedPilot):
    """A pilot that replaces its path by a new plan every period, each craft in its turn."""

    def __init__(
        self, fleet: Fleet, name: str, tell: Callable[[Any], None], *, seed: int = 0
    ) -> None:
        super().__init__(fleet, name, tell, seed=seed)
        self.tell, self.fleet = tell, fleet
        self.reference.path = self.member.start
        self.border = np.array(fleet.settings.table.reach(self.member.reach.radius))
        self.next = DT * fleet.names.index(name) / len(fleet.names)
        self.plans = {
            one.name: Plan(one.name, 0.0, np.tile(one.start.pose[:2], (STEPS, 1)))
            for one in fleet.members
        }
        self.seen: Mapping[str, Sighting] = {}

    def heard(self, messages: Iterable[Any], now: float) -> None:
        """Receive plans of the others."""
        for plan in messages:
            if plan.time > self.plans[plan.sender].time:
                self.plans[plan.sender] = plan

    def saw(self, seen: Mapping[str, Sighting]) -> None:
        """Receive the latest poses of the others."""
        self.seen = dict(seen)

    def act(self, time: float) -> Step:
        """Plan if it is time, and compute the command."""
        if time >= self.next:
            self.next += DT
            own = self.reference.path
            motion = own.moved(np.array([time]))
            pose, rate = motion.pose[0], motion.rate[0]
            found = self.pushes(time, pose, rate)
            if found is not None:
                turn = yaw_plan(pose[2], rate[2], self.member.goal(time)[2])
                durations = np.full((3, STEPS), DT)
                then = Route(time, pose, rate, durations, np.vstack([found.T, turn]))
                self.reference.path = own.followed(time - 1.0, time, then)
                self.tell(self.plan(time, pose, rate, found))
        return self.controller.step(time)

    def plan(self, time: float, pose: Any, rate: Any, pushes: Float[np.ndarray, "20 2"]) -> Plan:
        """Keep and return a plan."""
        places = pose[:2] + _T[:, None] * rate[:2] + _P @ pushes
        self.plans[self.member.name] = Plan(self.member.name, time, places)
        return self.plans[self.member.name]

    def pushes(self, time: float, pose: Any, rate: Any) -> Float[np.ndarray, "20 2"] | None:
        """Return the accelerations of a plan; None: continue the last plan."""
        raise NotImplementedError


class Published(Replanning):
    """The published formulation: soft separation, between neighbours of a chain."""

    def pushes(self, time: float, pose: Any, rate: Any) -> Float[np.ndarray, "20 2"] | None:
        """Solve the quadratic program of this craft; see `Replanning.pushes`."""
        names, name = self.fleet.names, self.member.name
        k = names.index(name)
        near = [names[j] for j in (k - 1, k + 1) if 0 <= j < len(names)]
        times = time + _T
        own, free = self.plans[name].at(times), pose[:2] + _T[:, None] * rate[:2]
        rows, bounds = [], []
        for j, other in enumerate(near):
            places = self.plans[other].at(times)
            normal = own - places
            normal /= np.maximum(np.hypot(*normal.T)[:, None], 1e-6)
            slack = np.zeros((STEPS, len(near) * STEPS))
            slack[:, j * STEPS : (j + 1) * STEPS] = np.eye(STEPS)
            rows.append(np.hstack([normal[:, :1] * _P, normal[:, 1:] * _P, slack]))
            bounds.append(APART + np.einsum("ti,ti->t", normal, places - free))
        for obstacle in self.fleet.scenario.obstacles:
            centre = np.array([obstacle.x_m, obstacle.y_m])
            normal = (own - centre) / np.hypot(*(own - centre).T)[:, None]
            slack = np.zeros((STEPS, len(near) * STEPS))
            rows.append(np.hstack([normal[:, :1] * _P, normal[:, 1:] * _P, slack]))
            least = obstacle.radius_m + self.member.reach.radius
            bounds.append(least + np.einsum("ti,ti->t", normal, centre - free))
        quadratic, linear = tracking_cost(free, rate[:2], self.member.goal(time)[:2])
        count = len(near) * STEPS
        quadratic = np.block(
            [
                [quadratic, np.zeros((2 * STEPS, count))],
                [np.zeros((count, 2 * STEPS)), 2 * _SOFT * np.eye(count)],
            ]
        )
        on_table = np.zeros((2 * STEPS, 2 * STEPS + count))
        on_table[:, : 2 * STEPS] = np.kron(np.eye(2), _P)
        matrix = np.vstack([*rows, on_table])
        least = np.concatenate([*bounds, (-self.border - free).T.ravel()])
        most = np.concatenate(
            [np.full(len(least) - 2 * STEPS, np.inf), (self.border - free).T.ravel()]
        )
        limits = np.concatenate([np.full(2 * STEPS, PUSH), np.full(count, np.inf)])
        lower = np.concatenate([np.full(2 * STEPS, -PUSH), np.zeros(count)])
        found = solved(
            quadratic,
            np.concatenate([linear, np.zeros(count)]),
            matrix,
            np.concatenate([limits, most]),
            np.concatenate([lower, least]),
        )
        return None if found is None else found[: 2 * STEPS].reshape(2, STEPS).T


class Voronoi(Replanning):
    """Buffered Voronoi cells (Zhou et al. 2017), with the accelerations and speeds of `Reach`.

    A plan stays in the craft's own cell and ends at rest there. A craft that is stuck aims to the
    right of its goal for a while.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.border = np.array(self.fleet.settings.table.reach(self.member.reach.room))
        self.slow_since = math.inf

    def pushes(self, time: float, pose: Any, rate: Any) -> Float[np.ndarray, "20 2"] | None:
        """Solve the quadratic program of this craft; see `Replanning.pushes`."""
        reach, free = self.member.reach, pose[:2] + _T[:, None] * rate[:2]
        walls = [
            (seen.pose[:2] - pose[:2], (reach.room + self.fleet.member(name).reach.room) / 2, 0.5)
            for name, seen in self.seen.items()
            if name != self.member.name
        ]
        for one in self.fleet.scenario.obstacles:
            walls.append((np.array([one.x_m, one.y_m]) - pose[:2], reach.room + one.radius_m, 1.0))
        rows, most = [], []
        for away, room, share in walls:
            distance = float(np.hypot(*away))
            normal = away / distance
            rows.append(np.hstack([normal[0] * _P, normal[1] * _P]))
            # A craft that is too close already must not come closer.
            most.append(max(share * distance - room, 0.0) - (free - pose[:2]) @ normal)
        for axis in (0, 1):
            unit = np.eye(2)[axis]
            for side in (-1, 1):
                rows.append(np.kron(side * unit, _P))
                most.append(self.border[axis] - side * free[:, axis])
                rows.append(np.kron(side * unit, _V))
                most.append(np.full(STEPS, reach.speed - side * rate[axis]))
        for angle in np.arange(_SIDES) * 2 * np.pi / _SIDES:
            rows.append(np.kron([np.cos(angle), np.sin(angle)], np.eye(STEPS)))
            most.append(np.full(STEPS, reach.push * np.cos(np.pi / _SIDES)))
        upper = np.concatenate(most)
        lower = np.full(len(upper), -np.inf)
        rests = np.kron(np.eye(2), _V[-1:])
        matrix = np.vstack([*rows, rests])
        upper, lower = np.append(upper, -rate[:2]), np.append(lower, -rate[:2])
        quadratic, linear = tracking_cost(free, rate[:2], self.aim(time, pose, rate))
        sense = np.zeros(len(upper), dtype=np.int32)
        sense[-2:] = 5  # equalities
        found = solved(quadratic, linear, matrix, upper, lower, sense)
        return None if found is None else found.reshape(2, STEPS).T

    def aim(self, time: float, pose: Any, rate: Any) -> Float[np.ndarray, " 2"]:
        """Return where to go: the goal, or to the right of it for a craft that is stuck."""
        goal = self.member.goal(time)[:2]
        away = goal - pose[:2]
        if np.hypot(*away) < _AWAY:
            self.slow_since = math.inf
        elif math.isinf(self.slow_since):
            if np.hypot(*rate[:2]) < _SLOW and time > DT:
                self.slow_since = time
        elif time - self.slow_since > 2 * _STUCK:
            self.slow_since = math.inf
        elif time - self.slow_since >= _STUCK:
            c, s = np.cos(_RIGHT), np.sin(_RIGHT)
            return pose[:2] + np.array([[c, s], [-s, c]]) @ away
        elif np.hypot(*rate[:2]) > 2 * _SLOW:
            self.slow_since = math.inf
        return goal


def tracking_cost(free: Any, rate: Any, goal: Any) -> tuple[Any, Any]:
    """Return the quadratic and linear cost of accelerations along x and y."""
    weights = np.ones(STEPS)
    weights[-1] = STEPS / 2
    block = _PLACE * _P.T * weights @ _P + _SPEED * _V.T * weights @ _V + _PUSH * np.eye(STEPS)
    linear = _PLACE * _P.T * weights @ (free - goal)
    linear = linear + _SPEED * _V.T * weights @ np.tile(rate, (STEPS, 1))
    return 2 * np.kron(np.eye(2), block), 2 * linear.T.ravel()


def yaw_plan(yaw: float, spin: float, goal: float) -> Float[np.ndarray, " 20"]:
    """Return the angular accelerations of a plan."""
    goal = yaw + (goal - yaw + math.pi) % (2 * math.pi) - math.pi
    free = yaw + _T * spin
    quadratic, linear = tracking_cost(np.stack([free, free], axis=1), [spin, spin], [goal, goal])
    limits = np.full(STEPS, TURN)
    found = solved(quadratic[:STEPS, :STEPS], linear[:STEPS], np.zeros((0, STEPS)), limits, -limits)
    return np.zeros(STEPS) if found is None else found


def solved(
    quadratic: Any, linear: Any, matrix: Any, most: Any, least: Any, sense: Any = None
) -> Any | None:
    """Solve a quadratic program with DAQP; None if it has no solution."""
    sense = np.zeros(len(most), dtype=np.int32) if sense is None else sense
    most, least = np.clip(most, None, 1e30), np.clip(least, -1e30, None)
    x, _, flag, _ = daqp.solve(
        np.ascontiguousarray(quadratic), linear, np.ascontiguousarray(matrix), most, least, sense
    )
    return np.array(x) if flag > 0 else None


#: Number of intervals of the problem for all.
INTERVALS = 40


def central(
    members: Sequence[Member], border: Sequence[Any], flown: Any, flown_time: float, seed: int
) -> dict[str, Any]:
    """Return the shortest time until all rest at their goals, from several starts.

    Double integrators with the accelerations, speeds and rooms of `Reach`, piecewise constant
    accelerations, separation at the ends and middles of all intervals. One start is what we flew.
    """
    solve, unpack = _problem(members, border)
    random, found = np.random.default_rng(seed), []
    start = np.array([one.start.pose[:2] for one in members])
    goal = np.array([one.goals[-1][:2] for one in members])
    share = np.linspace(0, 1, INTERVALS + 1)[:, None, None]
    smooth = 3 * share**2 - 2 * share**3
    bump = np.sin(np.pi * share)
    guesses = [(flown, flown_time)]
    for _ in range(3):
        aside = 0.25 * random.normal(size=(len(members), 2))
        guesses.append((start + smooth * (goal - start) + bump * aside, 2.5))
    for places, lasts in guesses:
        answer = solve(places, lasts)
        if answer is not None:
            found.append(unpack(answer))
    yaws = [_turned(one) for one in members]
    times = [max(lasts, *(rest for rest, _ in yaws)) for lasts, _ in found]
    within = [max(near, *(n for _, n in yaws)) for _, near in found]
    return {
        "rest": min(times, default=math.inf),
        "within": min(within, default=math.inf),
        "converged": len(found),
        "starts": len(guesses),
    }


def _turned(one: Member) -> tuple[float, float]:
    """Return when a craft's yaw can be at its goal, and within 0.1 rad of it [s]."""
    away = (one.start.pose[2] - one.goals[-1][2] + math.pi) % (2 * math.pi) - math.pi
    durations, pushes = braked(
        np.array(away), np.array(0.0), np.array(one.reach.turn), one.reach.spin
    )
    path = Route(
        0.0,
        np.array([0.0, 0.0, away]),
        np.zeros(3),
        np.array([0 * durations, 0 * durations, durations]),
        np.array([0 * pushes, 0 * pushes, pushes]),
    )
    times = np.linspace(0, path.end, 200)
    far = np.flatnonzero(np.abs(path.moved(times).pose[:, 2]) > 0.1)
    return path.end, float(times[far[-1]]) if len(far) else 0.0


def _problem(members: Sequence[Member], border: Sequence[Any]) -> tuple[Any, Any]:
    """Return a solver from guessed places and duration, and what reads its answer."""
    import casadi

    n, N = len(members), INTERVALS
    lasts = casadi.SX.sym("T")
    p = [casadi.SX.sym(f"p{k}", 2, n) for k in range(N + 1)]
    v = [casadi.SX.sym(f"v{k}", 2, n) for k in range(N + 1)]
    u = [casadi.SX.sym(f"u{k}", 2, n) for k in range(N)]
    h, g, low, high = lasts / N, [], [], []

    def bound(value: Any, least: float, most: float) -> None:
        g.append(casadi.vec(value))
        low.extend([least] * g[-1].numel())
        high.extend([most] * g[-1].numel())

    pairs = [(i, j) for i in range(n) for j in range(i)]
    rooms = [one.reach.room for one in members]
    for k in range(N):
        bound(p[k + 1] - p[k] - h * v[k] - h**2 / 2 * u[k], 0.0, 0.0)
        bound(v[k + 1] - v[k] - h * u[k], 0.0, 0.0)
        middle = p[k] + h / 2 * v[k] + h**2 / 8 * u[k]
        for i, one in enumerate(members):
            bound(casadi.sumsqr(u[k][:, i]) / one.reach.push**2, -math.inf, 1.0)
            bound(casadi.sumsqr(v[k + 1][:, i]) / one.reach.speed**2, -math.inf, 1.0)
        for i, j in pairs:
            for place in (middle, p[k + 1]):
                apart = casadi.sumsqr(place[:, i] - place[:, j])
                bound(apart / (rooms[i] + rooms[j]) ** 2, 1.0, math.inf)
    x = casadi.vertcat(lasts, *(casadi.vec(one) for one in (*p, *v, *u)))
    cost = lasts + 1e-4 * sum(casadi.sumsqr(one) for one in u) / N
    options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes"}
    options |= {"ipopt.max_iter": 400, "ipopt.tol": 1e-5, "ipopt.max_cpu_time": 30.0}
    problem = {"x": x, "f": cost, "g": casadi.vertcat(*g)}
    solver = casadi.nlpsol("central", "ipopt", problem, options)
    start = np.array([one.start.pose[:2] for one in members])
    goal = np.array([one.goals[-1][:2] for one in members])
    side = np.tile(np.array(border), (N + 1, 1, 1))
    least_p, most_p = -side, side
    least_p[0] = most_p[0] = start
    least_p[-1] = most_p[-1] = goal
    most_v = np.full((N + 1, n, 2), math.inf)
    most_v[0] = most_v[-1] = 0.0
    free = np.full((N, n, 2), math.inf)

    def packed(duration: float, *parts: Any) -> Any:
        return np.concatenate([[duration], *(part.ravel() for part in parts)])

    def solve(places: Any, duration: float) -> Any | None:
        rates = np.gradient(places, duration / N, axis=0)
        pushes = np.diff(rates, axis=0) * N / duration
        answer = solver(
            x0=packed(duration, places, rates, pushes),
            lbx=packed(0.1, least_p, -most_v, -free),
            ubx=packed(30.0, most_p, most_v, free),
            lbg=low,
            ubg=high,
        )
        return answer["x"].full()[:, 0] if solver.stats()["success"] else None

    def unpack(answer: Any) -> tuple[float, float]:
        """Return when all rest, and when the last craft comes within 2 cm of its goal."""
        size = (N + 1) * n * 2
        places = answer[1 : 1 + size].reshape(N + 1, n, 2)
        fine = np.linspace(0, N, 20 * N + 1)
        away = np.hypot(*np.moveaxis(places - goal, 2, 0))
        away = np.stack([np.interp(fine, np.arange(N + 1), one) for one in away.T], axis=1)
        far = np.flatnonzero((away > 0.02).any(axis=1))
        return float(answer[0]), float(answer[0] * fine[far[-1]] / N)

    return solve, unpack
