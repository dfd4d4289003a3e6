"""Tracks a plan with its own thrusts, corrected by a law; departs once the craft rests."""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Float

from airpuck.control.allocation import all_finite
from airpuck.control.law import Law, LawOptions, Moment, Pilot, Step, staged
from airpuck.control.laws import law_class
from airpuck.control.lqr import LQR, motor_lag, point_mass
from airpuck.control.reference import Reference
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning
from airpuck.craft.table import Table
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model
from airpuck.physics.motor import lag_decay
from airpuck.physics.rigid_body import acceleration, acceleration_map, pose_difference
from airpuck.physics.thrust import InverseThrust, thrust
from airpuck.planning.plan import Plan

# The exported controller has the same numbers (`airpuck.export.c`).

#: Times [s]: how far ahead on the plan the craft aims; largest delay with which it may come to
#: rest; shortest time in which motors and thrusts can have an effect.
HORIZON, LATER, LEAST = 0.6, 0.03, 0.08
#: Time after its end for which a plan to rest is still flown; then its goal is a set point [s].
_AFTERWARDS = 0.1
#: Equally weighted errors at the aim point (x, y, γ and their rates), and deviations from the
#: planned thrusts over a period [N].
PRECISION = np.array([2e-3, 2e-3, 0.02, 0.01, 0.01, 0.3])
CORRECTION = 0.05
#: Assumed duration of an estimated disturbance: at full thrust it mostly indicates a late
#: packet [s].
LASTING = 0.1
#: Step of the finite differences that linearise accelerations.
DIFFERENCE = 1e-5
#: Number of samples per period over which planned commands are averaged.
SAMPLES = 4
#: Newton's method: largest remaining slope, and number of iterations.
TOLERANCE, ITERATIONS = 1e-6, 40
#: Its line search: least decrease as a fraction of the linear one (Armijo), and the shortest step.
DECREASE, SHORTEST = 1e-4, 1e-4
#: Rounding of a number of periods.
ROUNDING = 1e-9
#: The craft is at rest once it has stayed this near (x, y, γ and their rates) for this long [s];
#: longer than a pilot's steps on the spot before a flight.
_AT_REST = np.array([5e-3, 5e-3, 0.05, 0.05, 0.05, 1.0])
_RESTS = 1.0
#: A longer pause between two steps restarts the time at rest [s].
_INTERRUPTED = 0.1


class PlanTracker(Law):
    """Flies a plan with its thrusts, corrected so that the craft rejoins the plan a little later.

    A separate allocation would distribute the accelerations differently over the motors, and find
    motors too slow that the plan had already spun up. Errors are not corrected at once, with thrust
    that may not exist, but over the rest of the flight, within what the motors can do. Before and
    after the plan, and for other references, an `LQR` steers.
    """

    title, c_modules = "the thrusts of a plan", ("flight", "slopes")

    def __init__(self, model: Model, tuning: Tuning, options: LawOptions | None = None) -> None:
        options = options or LawOptions()
        self.model, self.period = model, tuning.period_s
        self._lqr = LQR(model, tuning, options)
        self._by_lqr = staged(self._lqr, model, options.compiled)
        self._inverse = InverseThrust(model.dynamics.thrust)
        self._lag, self._drive = motor_lag(
            float(model.dynamics.motor_time_constant), tuning.period_s
        )

    def step(self, state: None, moment: Moment) -> tuple[Step, None]:
        """Correct the planned thrusts for an estimate; see `Law.step`."""
        vehicle, plan = self.model.vehicle, moment.reference
        (estimate, _), acting = moment.foresee(), moment.now + moment.delay
        if not isinstance(plan, Plan) or not 0 <= acting - plan.begin < given_up(plan):
            return self._lqr.step(state, moment._replace(foresee=partial(self._by_lqr, estimate)))
        curves, lag, drive = self.model.dynamics.thrust, self._lag, self._drive
        ahead = self.period * np.arange(self._periods(plan, acting) + 1)
        states = _flown_on(plan, acting, ahead)
        planned = thrust(curves, states[:, 6:].T).T
        # Difference between the present thrusts and the plan's.
        aside = thrust(curves, estimate.motor_speed) - planned[0]
        correction = self._correction(plan, acting, ahead, states, estimate, aside)
        coasting = lag * estimate.motor_speed
        low = thrust(curves, coasting + drive * vehicle.command_min)
        high = thrust(curves, coasting + drive * vehicle.command_max)
        force = np.clip(planned[1] + lag * aside + drive * correction, low, high)
        command = (self._inverse(force) - coasting) / drive
        if not all_finite(command):
            return Step(vehicle.idle, "failed"), state
        command = np.clip(command, vehicle.command_min, vehicle.command_max)
        return Step(command, "exact", np.zeros(3), estimate), state

    def _periods(self, plan: Plan, acting: float) -> int:
        """Return how many periods ahead the target state lies."""
        left = plan.begin + plan.duration - acting
        if rests(plan):
            left = max(left + LATER, LEAST)
        return periods(left, self.period)

    def _correction(
        self,
        plan: Plan,
        acting: float,
        ahead: Float[np.ndarray, " nodes"],
        states: Float[np.ndarray, "nodes s"],
        estimate: Estimate,
        aside: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:
        """Return corrections to request from the motors now, besides the planned thrusts [N].

        The errors at the end are linear in the present errors and in all thrust corrections until
        then.
        """
        curves, vehicle, period = self.model.dynamics.thrust, self.model.vehicle, ahead[1]
        count, n = len(ahead) - 1, vehicle.n_propellers
        forces = thrust(curves, states[:, 6:].T).T
        # Account for actual motors: weak ones give less, and after the end they still spin down.
        flying = np.clip((plan.begin + plan.duration - acting - ahead[:-1]) / period, 0, 1)
        share = estimate.effectiveness
        surplus = (share - flying[:, None]) * (forces[1:] + forces[:-1]) / 2
        transition, pushes = self._linearised((states[1:] + states[:-1]).T / 2)
        onward, running = np.eye(6), np.zeros((6, n))
        _, disturbed = point_mass(period)
        gains, missed = np.empty((6, count, n)), np.zeros(6)
        for k in reversed(range(count)):
            push = onward @ pushes[k]
            lasting = np.exp(-ahead[k] / LASTING) * estimate.disturbance
            missed += push @ surplus[k] + onward @ disturbed @ lasting
            push = push * share
            gains[:, k] = self._drive * (push / 2 + running)
            running = (1 + self._lag) / 2 * push + self._lag * running
            onward = onward @ transition[k]
        missed += onward @ pose_difference(np, estimate.state, states[0, :6]) + running @ aside
        within = ahead[:-1, None] + period * (np.arange(SAMPLES) + 0.5) / SAMPLES
        asked = thrust(curves, np.moveaxis(plan.motors_at(acting, within), -1, 0)).mean(axis=2).T
        least, most = thrust(
            curves, np.outer(np.ones(n), [vehicle.command_min, vehicle.command_max])
        ).T
        low, high = np.minimum(least - asked, 0.0).ravel(), np.maximum(most - asked, 0.0).ravel()
        a = (CORRECTION / PRECISION)[:, None] * gains.reshape(6, -1)
        x = least_correction(a, missed / PRECISION, low / CORRECTION, high / CORRECTION)
        return CORRECTION * x[:n]

    def _linearised(
        self, states: Float[np.ndarray, "s K"]
    ) -> tuple[Float[np.ndarray, "K 6 6"], Float[np.ndarray, "K 6 n"]]:
        """Return the effects of errors and of thrust corrections over one period, at each state."""
        dynamics = self.model.dynamics
        rates = [
            acceleration(np, dynamics, states[2:6] + row[:, None], states[6:])
            for row in np.vstack([np.zeros(4), DIFFERENCE * np.eye(4)])
        ]
        slopes = (np.array(rates[1:]) - np.array(rates[0])) / DIFFERENCE
        a, b = point_mass(self.period)
        # The effect depends on yaw and rates, not on the position.
        jacobian = np.zeros((states.shape[1], 3, 6))
        jacobian[:, :, 2:] = slopes.transpose(2, 1, 0)
        maps = [acceleration_map(np, dynamics, yaw, 0.0)[0] for yaw in states[2]]
        return a + b @ jacobian, b @ np.stack(maps)


def periods(left: float, period: float) -> int:
    """Return how many control periods ahead a tracker aims, given the time that is left [s]."""
    return max(int(min(left, HORIZON) / period + ROUNDING), 1)


def rests(plan: Plan) -> bool:
    """Return whether the craft rests at the end."""
    return bool((np.abs(plan.states[-1, 3:6]) < _AT_REST[3:]).all())


def given_up(plan: Plan) -> float:
    """Return how long after its start a plan stops being flown [s]."""
    return plan.duration + (_AFTERWARDS if rests(plan) else 0.0)


def _flown_on(
    plan: Plan, acting: float, ahead: Float[np.ndarray, " K"]
) -> Float[np.ndarray, "K s"]:
    """Return the planned states; after the end the craft is at rest and the motors spin down."""
    states = plan.state_at(acting, ahead)
    late = np.maximum(acting + ahead - plan.begin - plan.duration, 0.0)
    left = lag_decay(np, late, float(plan.model.dynamics.motor_time_constant))
    idle = plan.model.vehicle.command_min
    after = late > 0
    states[after, 6:] = idle + left[after, None] * (states[after, 6:] - idle)
    states[after, 3:6] = 0.0
    return states


def least_correction(
    a: Float[np.ndarray, "k m"],
    missed: Float[np.ndarray, " k"],
    low: Float[np.ndarray, " m"],
    high: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " m"]:
    """Minimise |a x + missed|² + |x|² within bounds.

    With λ = a x + missed, x is -aᵀλ, clipped. This leaves k unknowns. Newton's method on the dual,
    which is convex and smooth, is ten times as fast as a solver for the m primal ones.
    """

    def residual(price: Float[np.ndarray, " k"]) -> tuple[np.ndarray, np.ndarray]:
        x = np.clip(-(a.T @ price), low, high)
        return price - missed - a @ x, x

    def dual(price: Float[np.ndarray, " k"]) -> float:
        free = -(a.T @ price)
        x = np.clip(free, low, high)
        return float(price @ (price / 2 - missed) + x @ (free - x / 2))

    price = np.zeros(len(missed))
    slope, x = residual(price)
    for _ in range(ITERATIONS):
        if np.abs(slope).max() < TOLERANCE:
            break
        inside = a[:, (x > low) & (x < high)]
        step = np.linalg.solve(np.eye(len(price)) + inside @ inside.T, -slope)
        share, before = 1.0, dual(price)
        while (
            dual(price + share * step) > before + DECREASE * share * (slope @ step)
            and share > SHORTEST
        ):
            share /= 2
        price = price + share * step
        slope, x = residual(price)
    return x


def plan_tracker(plan: Plan, tuning: Tuning, table: Table | None = None) -> TrackingController:
    """Return a controller that flies a plan; see `for_plans`."""
    return TrackingController(plan.model, plan, for_plans(tuning), table=table)


def for_plans(tuning: Tuning) -> Tuning:
    """Return the tuning with `PlanTracker` instead of a law that does not look ahead."""
    ahead = getattr(law_class(tuning.law.kind), "looks_ahead", True)
    return tuning if ahead else tuning.with_law("plan")


class Departing(Pilot):
    """Goes to the start of a plan, rests there for a second, and flies the plan once; a `Pilot`.

    Parameters
    ----------
    controller : TrackingController
        The controller, as returned by `plan_tracker`.
    plan : Plan
        A plan that starts from rest; its time of departure is ignored.
    """

    def __init__(self, controller: TrackingController, plan: Plan) -> None:
        self._controller, self._plan = controller, plan
        self._start = np.concatenate([plan.states[0, :3], np.zeros(3)])
        #: Time since which the craft has rested at the start, and time of the latest step then [s].
        self._since = self._latest = -np.inf
        self._departed = False
        #: The plan; its departure is at infinity until the craft departs.
        self.reference: Reference = plan.starting(np.inf)
        controller.reference = self.reference
        self.pose, self.measured, self.sent = controller.pose, controller.measured, controller.sent

    def step(self, time: float) -> Step:
        """Compute the command to send now, and depart when ready; see `TrackingController.step`."""
        step = self._controller.step(time)
        if not self._departed and step.flies and step.estimate is not None:
            error = pose_difference(np, step.estimate.state, self._start)
            if time > self._latest + _INTERRUPTED or (np.abs(error) > _AT_REST).any():
                self._since = time
            self._latest = time
            if time >= self._since + _RESTS:
                self._departed = True
                self.reference = self._controller.reference = self._plan.starting(time)
        return step
