"""Tracks a plan by its own thrusts, corrected by a regulator; departs once the craft rests."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from airpuck.control.discretization import motor_lag
from airpuck.control.law import Step
from airpuck.control.lqr import regulator
from airpuck.control.reference import Reference
from airpuck.control.stages import look_ahead
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning
from airpuck.craft.table import Table
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model
from airpuck.physics.angle import pose_difference
from airpuck.physics.thrust import InverseThrust, thrust
from airpuck.planning.plan import Plan

#: By how much accelerations are cheaper than in the tuning's regulator: a plan asks for all that
#: the motors give, so what they do late or wrongly must be made good at once.
_STIFFER = 30.0
#: Weight of an acceleration that is missed against thrusts that differ from the plan's.
_EXACT = 30.0
#: The craft rests at a place when it has been as near as this (x, y, γ and their rates) for so long
#: [s]; longer than a pilot's steps on the spot before a flight.
_AT_REST = np.array([5e-3, 5e-3, 0.05, 0.05, 0.05, 1.0])
_RESTS = 1.0


class PlanTracker(TrackingController):
    """Flies a plan by its thrusts; a regulator corrects them within what the motors can reach.

    An allocation of its own would spread the accelerations otherwise over the motors, and find them
    too slow where the plan had them ready. Before and after the plan, and where it is left far
    behind, it is a `TrackingController`.

    Parameters
    ----------
    model : Model
        What the controller believes.
    plan : Plan
        With its time of departure (`Plan.starting`).
    tuning : Tuning, optional
        By default the packaged one.
    """

    def __init__(self, model: Model, plan: Plan, tuning: Tuning | None = None) -> None:
        super().__init__(model, plan, tuning)
        weights = self.tuning.weights
        cheap = {
            name: getattr(weights, name) / _STIFFER
            for name in ("acceleration", "angular_acceleration")
        }
        self._gain = regulator(weights.model_copy(update=cheap), self.tuning.period_s)
        self._inverse = InverseThrust(model.dynamics.thrust)
        self._arms = np.array([1.0, 1.0, model.radius_of_gyration])

    def step(self, time: float) -> Step:
        """Compute the command to send now; see `TrackingController.step`."""
        if self.refusal(time) is not None:
            return super().step(time)
        return self.steer(self.predict(time), time)

    def steer(self, estimate: Estimate, now: float) -> Step:
        """Correct the planned thrusts for an estimate; see `TrackingController.steer`."""
        period, delay = self.tuning.period_s, self.model.transport_delay
        dynamics, vehicle, plan = self.model.dynamics, self.model.vehicle, self.reference
        if not isinstance(plan, Plan) or now + delay < plan.begin:
            return super().steer(estimate, now)
        planned = plan.state_at(now, delay + period)
        if now + delay - plan.begin > plan.duration - period:
            # What is left of the way, as stiffly; from idle motors.
            idle = np.full(vehicle.n_propellers, vehicle.command_min)
            planned = np.concatenate([planned[:3], np.zeros(3), idle])
        e = estimate
        following, matrix, _ = look_ahead(
            np, dynamics, period, e.state, e.motor_speed, e.disturbance, e.effectiveness
        )
        error = pose_difference(np, following, planned[:6])
        wanted = -self._gain @ error - e.disturbance
        lag, drive = motor_lag(float(dynamics.motor_time_constant), period)
        coasting = lag * e.motor_speed
        low = thrust(dynamics.thrust, coasting + drive * vehicle.command_min)
        high = thrust(dynamics.thrust, coasting + drive * vehicle.command_max)
        force = self._corrected(thrust(dynamics.thrust, planned[6:]), wanted, matrix, low, high)
        command = (self._inverse(force) - coasting) / drive
        command = np.clip(command, vehicle.command_min, vehicle.command_max)
        return Step(command, "exact", wanted, estimate)

    def _corrected(
        self,
        planned: Float[np.ndarray, " n"],
        wanted: Float[np.ndarray, " 3"],
        matrix: Float[np.ndarray, "3 n"],
        low: Float[np.ndarray, " n"],
        high: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, " n"]:
        """Return thrusts near the planned ones that give the correction as nearly as possible."""
        n = len(planned)
        rows = _EXACT * self._arms[:, None] * matrix
        a = np.vstack([rows, np.eye(n)])
        b = np.concatenate([_EXACT * self._arms * wanted, np.zeros(n)])
        room = np.maximum(high, low + 1e-9)
        found = lsq_linear(a, b, (low - planned, room - planned), method="bvls")
        return np.clip(planned + found.x, low, high)


def plan_tracker(plan: Plan, tuning: Tuning, table: Table | None = None) -> TrackingController:
    """Return what tracks a plan by the law of the tuning."""
    if tuning.regulator.kind == "lqr":
        return PlanTracker(plan.model, plan, tuning)
    return TrackingController(plan.model, plan, tuning, table=table)


class Departing:
    """Goes to the start of a plan, rests there for a second, and flies the plan, once; a `Pilot`.

    Parameters
    ----------
    controller : TrackingController
        What flies; `plan_tracker` returns one.
    plan : Plan
        From rest; its time of departure is not used.
    """

    def __init__(self, controller: TrackingController, plan: Plan) -> None:
        self._controller, self._plan = controller, plan
        self._start = np.concatenate([plan.states[0, :3], np.zeros(3)])
        #: Since when the craft has rested at the start, and the latest step then [s].
        self._since = self._latest = -np.inf
        self._departed = False
        #: The plan, which begins at infinity until the craft departs.
        self.reference: Reference = plan.starting(np.inf)
        controller.reference = self.reference
        self.pose, self.imu, self.mouse = controller.pose, controller.imu, controller.mouse
        self.sent = controller.sent

    def step(self, time: float) -> Step:
        """Compute the command to send now, and depart in time; see `TrackingController.step`."""
        step = self._controller.step(time)
        if not self._departed and step.flies and step.estimate is not None:
            error = pose_difference(np, step.estimate.state, self._start)
            if time > self._latest + 0.1 or (np.abs(error) > _AT_REST).any():
                self._since = time
            self._latest = time
            if time >= self._since + _RESTS:
                self._departed = True
                self.reference = self._controller.reference = self._plan.starting(time)
        return step
