"""The tracking controller: poses in, motor commands out (seq:control)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.compute.compiled import program
from airpuck.compute.process import large_programs_are_fast
from airpuck.control.allocation import Outcome, ThrustAllocator, all_finite
from airpuck.control.lqr import LQR, regulator
from airpuck.control.pose_gate import STALE, PoseGate
from airpuck.control.reference import Numbers, Reference, Target
from airpuck.control.stages import Plan, command_stage, plan_stage
from airpuck.control.tuning import Estimation, Tuning, default_tuning
from airpuck.estimate.estimator import Estimate
from airpuck.estimate.kalman import ActuationFilter, KalmanFilter
from airpuck.model.model_file import Model
from airpuck.physics.thrust import InverseThrust

#: How a control step ended. The outcomes of the allocation fly; all others idle the motors; a guard
#: around the controller sets ``unsafe``.
Status = (
    Outcome | Literal["no pose", "stale pose", "jumping pose", "bad input", "open loop", "unsafe"]
)
FLYING: tuple[Status, ...] = ("exact", "scaled", "nearest", "open loop")

#: Commands that began to act longer ago than this matter to the motor speeds only [s].
_REMEMBERED = 0.5


@dataclass(frozen=True, eq=False)
class Step:
    """Result of a control step.

    Attributes
    ----------
    command : array, shape (n,)
        Motor commands to send, finite and within the vehicle's limits; an array of the caller's
        own, to change at will.
    status : str, default "open loop"
        ``exact``, ``scaled``, ``nearest``: the craft flies, ``open loop``: without an allocation;
        anything else: the motors idle, and this is why.
    request : array, shape (3,), default 0
        Acceleration asked of the allocation [m/s², m/s², rad/s²]; zero when idle.
    estimate : Estimate or None
        State at the time at which the command will begin to act; None when idle.
    """

    command: Float[np.ndarray, " n"]
    status: Status = "open loop"
    request: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))
    estimate: Estimate | None = None

    @property
    def flies(self) -> bool:
        """Whether the command steers the craft, rather than idling its motors."""
        return self.status in FLYING


class TrackingController:
    """Steers the craft to a reference.

    Each step predicts the state x_k to when the command will act, over the transport delay; moves
    one period on with the accelerations that the motors already determine; asks the regulator for
    v_{k+1} = -K (x_{k+1} - reference), takes off the disturbance, and finds the commands that make
    the motors give it (eq. force_qp).

    Parameters
    ----------
    model : Model
        The craft; its thrust curves must rise.
    reference : Reference
        What to track; may be exchanged at any time.
    tuning : Tuning, optional
        By default the packaged one.
    gain : array, shape (3, 6), optional
        K for the state x, y, γ, vx, vy, ω; by default the regulator of the tuning's weights.
    reject_disturbance : bool, default True
        Whether the estimated disturbance is compensated. Without it a poor model leaves a
        steady-state offset, as the paper's M0 does.
    compensate_delay : bool, default True
        Whether the state is predicted over the transport delay. The paper's controller predicted
        it to the present only.
    compiled : bool, default True
        Whether to compile the mathematics (a second, once) or to run it in NumPy.

    Raises
    ------
    InputError
        If a thrust curve falls somewhere, or the propellers cannot produce every acceleration.
    """

    def __init__(
        self,
        model: Model,
        reference: Reference,
        tuning: Tuning | None = None,
        *,
        gain: Float[np.ndarray, "3 6"] | None = None,
        reject_disturbance: bool = True,
        compensate_delay: bool = True,
        compiled: bool = True,
    ) -> None:
        tuning = tuning or default_tuning()
        vehicle, dynamics = model.vehicle, model.dynamics
        if not _commands_all_directions(model):
            raise InputError(
                f"the propellers of {vehicle.name!r} cannot push and turn in every direction; "
                "check their positions and directions"
            )
        self.model, self.reference, self.tuning = model, reference, tuning
        self.reject_disturbance = reject_disturbance
        self.compensate_delay = compensate_delay
        InverseThrust(dynamics.thrust)  # refuses curves that fall
        #: Which acceleration to ask for; may be exchanged for one with another gain.
        self.law = LQR(regulator(tuning.weights, tuning.period_s) if gain is None else gain)
        #: Not to be exchanged: the programs below are made for it.
        self.filter = _estimator(model, tuning.estimation, compiled)
        n, period, allocation = vehicle.n_propellers, tuning.period_s, tuning.allocation
        slack_weight = allocation.slack_weight
        self._allocator = ThrustAllocator(
            n, model.radius_of_gyration, slack_weight, allocation.solver
        )
        self._idle = np.full(n, vehicle.command_min)
        state, axes, motors, bounds = np.zeros(6), np.zeros(3), np.zeros(n), np.zeros(n + 5)
        asked = state, axes, *self.law.numbers
        plan = plan_stage(model, period, self.law, slack_weight, reject_disturbance)
        self._plan = program(plan, state, motors, axes, motors, *asked, compiled=compiled)
        command, solution = command_stage(model, period), np.zeros(n + 2)
        self._command = program(command, solution, bounds, bounds, motors, compiled=compiled)
        #: Prediction and plan as one program, where that is faster.
        self._predict_and_plan = None
        if compensate_delay and (not compiled or large_programs_are_fast()):
            self._predict_and_plan = self.filter.composed(plan, *asked)
        self._gate = PoseGate()
        #: The latest time that has certainly come; -inf: none yet.
        self._clock = -math.inf

    def pose(self, time: float, pose: Numbers) -> None:
        """Take note of a measured pose.

        One that is not finite, not newer than the last, or implausibly far from its prediction is
        not used; ones elsewhere that agree with each other for 50 ms are believed. One that is more
        than 50 ms older than the last shows that the last stamp was wrong, and is believed at once;
        so is the first after 50 ms without any.

        Parameters
        ----------
        time : float
            Its stamp [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad]. It is copied.

        Raises
        ------
        InputError
            If the pose is not three numbers.
        """
        if self._gate.offer(self.filter, time, _copied(pose, 3, "pose")):
            self._clock = max(self._clock, time)

    def imu(self, time: float, acceleration: Numbers, gyro: float) -> None:
        """Take note of an inertial measurement.

        It may come later than poses with newer stamps. One that is not finite, or more than 50 ms
        from the last pose, is not used.

        Parameters
        ----------
        time : float
            Its stamp [s].
        acceleration : array, shape (2,)
            Along the body's x and y axes [m/s²].
        gyro : float
            Spin [rad/s].
        """
        acceleration = _copied(acceleration, 2, "acceleration")
        if self._gate.is_recent(time) and all_finite(acceleration) and math.isfinite(gyro):
            noise = self.tuning.estimation
            noises = noise.imu_acceleration_m_s2, noise.gyro_rad_s
            self.filter.imu(time, acceleration, gyro, noises)

    def mouse(self, time: float, velocity: Numbers) -> None:
        """Take note of a velocity from the optical sensor under the craft.

        It may come later than poses with newer stamps. One that is not finite, or more than 50 ms
        from the last pose, is not used.

        Parameters
        ----------
        time : float
            Its stamp [s].
        velocity : array, shape (2,)
            Along the body's x and y axes [m/s].
        """
        velocity = _copied(velocity, 2, "velocity")
        if self._gate.is_recent(time) and all_finite(velocity):
            self.filter.mouse(time, velocity, self.tuning.estimation.mouse_m_s)

    def sent(self, time: float, command: Numbers) -> None:
        """Take note of the command that was really sent.

        One that is not finite is taken as not sent: the one before stays in force. A time that is
        not finite, or more than 50 ms ahead of the last step, pose and command, is taken as now.

        Parameters
        ----------
        time : float
            When [s].
        command : array, shape (n,)
            Motor commands. They are copied.

        Raises
        ------
        InputError
            If there is not one command for each propeller.
        """
        command = _copied(command, len(self._idle), "command")
        if not all_finite(command):
            return
        if math.isfinite(self._clock) and not -math.inf < time <= self._clock + STALE:
            time = self._clock
        if not math.isfinite(time):
            return
        self._clock = max(self._clock, time)
        self.filter.command(time, command)
        self.filter.run_motors(time - _REMEMBERED)

    def step(self, time: float) -> Step:
        """Compute the command to send now; report with `sent` what was.

        Parameters
        ----------
        time : float
            Now, on the clock of the poses [s].

        Returns
        -------
        Step
            A command, whatever happened: idle with a reason where the craft cannot be steered.
        """
        refusal = self.refusal(time)
        if refusal is not None:
            return Step(self._idle.copy(), refusal, np.zeros(3), None)
        delay = self.model.transport_delay
        target = self.reference.at(time, delay + self.tuning.period_s)
        if self._predict_and_plan is None:
            return self.steer(self.predict(time), target)
        asked = self._asked(target)
        estimate, plan = self.filter.predict_with(self._predict_and_plan, time + delay, *asked)
        return self._carried_out(estimate, Plan(*plan))

    def predict(self, time: float) -> Estimate:
        """Predict the craft to when a command sent now begins to act.

        Parameters
        ----------
        time : float
            Now [s].

        Returns
        -------
        Estimate
            State, motor speeds and disturbance at that time.
        """
        acting = self.filter.predict(time + self.model.transport_delay)
        if self.compensate_delay:
            return acting
        # As if the commands on their way acted already, on a craft that is still here.
        return replace(self.filter.predict(time), motor_speed=acting.motor_speed)

    def steer(self, estimate: Estimate, target: Target) -> Step:
        """Compute the command for an estimate and a target, whatever the clock says.

        Parameters
        ----------
        estimate : Estimate
            The craft when the command begins to act.
        target : Target
            Where it should be one period later.

        Returns
        -------
        Step
            The command.
        """
        e = estimate
        believed = e.state, e.motor_speed, e.disturbance, e.effectiveness
        return self._carried_out(e, Plan(*self._plan(*believed, *self._asked(target))))

    def _asked(self, target: Target) -> tuple[np.ndarray, ...]:
        """Return what a plan needs beside the estimate."""
        return target.state, target.acceleration, *self.law.numbers

    def _carried_out(self, estimate: Estimate, plan: Plan) -> Step:
        """Allocate thrusts for a plan and invert them to commands."""
        solution, outcome = self._allocator.solve(plan.a, plan.lower, plan.upper, plan.finite)
        if solution is not None:
            (command,) = self._command(solution, plan.lower, plan.upper, plan.coasting)
            if all_finite(command):
                return Step(command, outcome, plan.request, estimate)
        return Step(self._idle.copy(), "failed", plan.request, estimate)

    def refusal(self, time: float) -> Status | None:
        """Return why the craft cannot be steered now.

        Parameters
        ----------
        time : float
            Now [s].

        Returns
        -------
        str or None
            The status of a step that idles the motors; None if the craft can be steered.
        """
        if not math.isfinite(time):
            return "bad input"
        self._clock = time
        return self._gate.refusal(time)


def _commands_all_directions(model: Model) -> bool:
    """Return whether the propellers' forces and moments span all accelerations."""
    # Moments as forces at the radius of gyration: one unit for all three rows.
    return bool(np.linalg.matrix_rank(model.propeller_effects, rtol=1e-6) == 3)


def _copied(values: Numbers, count: int, name: str) -> Float[np.ndarray, " k"]:
    """Copy what a caller may change later, and check its shape."""
    copied = np.array(values, dtype=float)
    if copied.shape != (count,):
        raise InputError(f"give {count} numbers, not an array of shape {copied.shape}", field=name)
    return copied


def _estimator(model: Model, estimation: Estimation, compiled: bool) -> KalmanFilter:
    """Return the estimator that the tuning names."""
    if estimation.estimator == "kalman":
        return KalmanFilter(model, estimation.noise, compiled=compiled)
    return ActuationFilter(
        model, estimation.noise, lasting=estimation.forgetting_s, compiled=compiled
    )
