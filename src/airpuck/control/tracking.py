"""The tracking controller: poses in, motor commands out (seq:control)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.compute.process import large_programs_are_fast
from airpuck.control.allocation import all_finite
from airpuck.control.law import Law, LawOptions, Moment, Status, Step, staged
from airpuck.control.laws import law_named
from airpuck.control.pilot import Pilot
from airpuck.control.reference import Numbers, Reference
from airpuck.control.tuning import Estimation, Tuning, default_tuning
from airpuck.craft.table import Table
from airpuck.data.measurement import Measurement
from airpuck.estimate.estimator import Estimate
from airpuck.estimate.kalman import ActuationFilter, KalmanFilter
from airpuck.model.model_file import Model
from airpuck.physics.angle import pose_difference

#: Commands that began to act longer ago than this matter to the motor speeds only [s].
_REMEMBERED = 0.5


class TrackingController(Pilot):
    """Steers the craft to a reference.

    Each step predicts the state to when the command will act, over the transport delay; the law
    that the tuning names then finds the command.

    Parameters
    ----------
    model : Model
        The craft; its thrust curves must rise.
    reference : Reference
        What to track; may be exchanged at any time.
    tuning : Tuning, optional
        By default the packaged one.
    table : Table, optional
        Whose rails a predictive law keeps to; by default the paper's.
    gain : array, shape (3, 6), optional
        Of the law `LQR`.
    reject_disturbance : bool, default True
        Whether the estimated disturbance is compensated. Without it a poor model leaves a
        steady-state offset, as the paper's M0 does.
    compensate_delay : bool, default True
        Whether the state is predicted over the transport delay. The paper's controller predicted
        it to the present only.
    compiled : bool, default True
        Whether to compile the mathematics (a second, once) or to run it in NumPy.

    Attributes
    ----------
    law : Law
        Not to be exchanged: programs are compiled for it.
    state : object
        What the law remembers.

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
        table: Table | None = None,
        gain: Float[np.ndarray, "3 6"] | None = None,
        reject_disturbance: bool = True,
        compensate_delay: bool = True,
        compiled: bool = True,
    ) -> None:
        tuning = tuning or default_tuning()
        vehicle = model.vehicle
        if not _commands_all_directions(model):
            raise InputError(
                f"the propellers of {vehicle.name!r} cannot push and turn in every direction; "
                "check their positions and directions"
            )
        self.model, self.reference, self.tuning = model, reference, tuning
        self.compensate_delay = compensate_delay
        self._idle = np.full(vehicle.n_propellers, vehicle.command_min)
        options = LawOptions(table or Table(), gain, reject_disturbance, compiled)
        self.law: Law = law_named(tuning.regulator.kind)(model, tuning, options)
        self.state = self.law.init()
        self.filter = _estimator(model, tuning.estimation, compiled)
        self._staged = staged(self.law, model, compiled)
        #: Prediction and stage as one program, where that is faster.
        self._predict_and_stage = None
        if compensate_delay and self.law.stage and (not compiled or large_programs_are_fast()):
            self._predict_and_stage = self.filter.composed(self.law.stage, *self.law.inputs)
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

    def measured(self, measurement: Measurement) -> None:
        """Take note of a measurement.

        Those of sensors on board may come later than poses with newer stamps. One that is not
        finite, or more than 50 ms from the last pose, is not used.

        Parameters
        ----------
        measurement : Measurement
            A pose of the craft (see `pose`), or one of ``imu`` and ``mouse``; others are not used.

        Raises
        ------
        InputError
            If it is not as many numbers as that sensor gives.
        """
        time, kind, noise = measurement.stamp, measurement.kind, self.tuning.estimation
        if kind == "pose":
            self.pose(time, measurement.values)
        elif kind == "imu":
            planar = _copied(measurement.values, 6, kind)[[0, 1, 5]]
            if self._gate.is_recent(time) and all_finite(planar):
                noises = noise.imu_acceleration_m_s2, noise.gyro_rad_s
                self.filter.imu(time, planar[:2], float(planar[2]), noises)
        elif kind == "mouse":
            values = _copied(measurement.values, 2, kind)
            if self._gate.is_recent(time) and all_finite(values):
                self.filter.mouse(time, values, noise.mouse_m_s)

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
        return self._act(time, partial(self._foresee, time))

    def _foresee(self, time: float, *inputs: Any) -> tuple[Estimate, Sequence[Any]]:
        """Predict the craft, and compute the stage of the law there; see `Moment`."""
        if self._predict_and_stage is None:
            return self._staged(self.predict(time), *inputs)
        acting = time + self.model.transport_delay
        return self.filter.predict_with(self._predict_and_stage, acting, *inputs)

    def _act(self, now: float, foresee: Callable[..., tuple[Estimate, Sequence[Any]]]) -> Step:
        """Let the law find the command, and keep what it remembers."""
        moment = Moment(self.reference, now, self.model.transport_delay, foresee)
        step, self.state = self.law.step(self.state, moment)
        return step

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

    def steer(self, estimate: Estimate, now: float) -> Step:
        """Compute the command for an estimate, whatever the clock says.

        Parameters
        ----------
        estimate : Estimate
            The craft when the command begins to act.
        now : float
            When the command is sent [s].

        Returns
        -------
        Step
            The command.
        """
        return self._act(now, partial(self._staged, estimate))

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


#: No control without a pose from the last 50 ms: twelve frames of the motion capture.
STALE = 0.05
#: A pose this far from its prediction cannot be the craft: [m, m, rad].
_JUMP = (0.1, 0.1, 1.0)
#: Poses that agree with each other for this long, but not with the prediction, are believed [s];
#: rounding of stamps must not cost a frame.
_BELIEVED_AFTER = STALE - 1e-6


class PoseGate:
    """Hands poses on to an estimator, unless they cannot be the craft."""

    def __init__(self) -> None:
        #: Stamps of the last pose that was received, and of the last that was used.
        self.received: float | None = None
        self._used = -math.inf
        #: The last of the poses that agree with each other only, and the stamp of their first.
        self._doubtful: Float[np.ndarray, " 3"] | None = None
        self._doubtful_since = 0.0
        self._bad = False

    def offer(self, estimator: KalmanFilter, time: float, pose: Float[np.ndarray, " 3"]) -> bool:
        """Use a pose if it is plausible; return whether it is finite and new.

        See `TrackingController.pose` for the rules.
        """
        self._bad = not (math.isfinite(time) and all_finite(pose))
        last = self.received
        if self._bad or (last is not None and last - STALE <= time <= last):
            return False
        self.received = time
        if last is None or abs(time - last) > STALE:
            # Too long ago to predict over, or the last stamp lay in the future: begin anew.
            self._restart(estimator, time, pose)
        # A prediction from before 50 ms of doubtful poses is worth no more than they are.
        elif time - self._used <= STALE and estimator.pose(time, pose, gate=_JUMP):
            self._used = time
            self._doubtful = None
        else:
            if self._doubtful is None or _far(pose, self._doubtful):
                self._doubtful_since = time
            self._doubtful = pose
            if time - self._doubtful_since >= _BELIEVED_AFTER:
                self._restart(estimator, time, pose)
        return True

    def refusal(
        self, time: float
    ) -> Literal["bad input", "no pose", "stale pose", "jumping pose"] | None:
        """Return why the poses do not allow to steer now; None if they do."""
        if self._bad:
            return "bad input"
        if self.received is None:
            return "no pose"
        if not self.is_recent(time):
            return "stale pose"
        return None if self._doubtful is None else "jumping pose"

    def is_recent(self, time: float) -> bool:
        """Return whether a time is within 50 ms of the last pose."""
        return self.received is not None and abs(time - self.received) <= STALE

    def _restart(self, estimator: KalmanFilter, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Start the estimator anew at a pose, keeping what is known of commands."""
        self._doubtful = None
        self._used = time
        estimator.restart(time, pose)


def _far(pose: Float[np.ndarray, " 3"], other: Float[np.ndarray, " 3"]) -> bool:
    """Return whether two poses cannot be neighbours."""
    return bool((np.abs(pose_difference(np, pose, other)) > _JUMP).any())
