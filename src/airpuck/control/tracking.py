"""The tracking controller: poses in, motor commands out (seq:control)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.arguments import checked_class, numbers_of
from airpuck.boundary.errors import InputError
from airpuck.compute.process import large_programs_are_fast
from airpuck.control.allocation import all_finite
from airpuck.control.authority import LEAST_EFFORT, control_authority, weakest_effort
from airpuck.control.landing import Landing
from airpuck.control.law import Law, LawOptions, Moment, Pilot, Status, Step, make_law, staged
from airpuck.control.limits import Limit, checked_limits
from airpuck.control.modulation import modulator_for, of_means, stage_of_means
from airpuck.control.pose_gate import PoseGate, longest_pause, remembered
from airpuck.control.reference import Numbers, Reference, check_inside
from airpuck.control.tuning import Estimation, Tuning, tuning_for
from airpuck.craft.table import Table
from airpuck.data.measurement import Measurement
from airpuck.estimate.estimator import Estimate
from airpuck.estimate.kalman import ActuationFilter, KalmanFilter
from airpuck.model.model_file import Model, nominal_model

#: Predicts the craft, and evaluates a law's stage there; see `Moment`.
_Foresee = Callable[..., tuple[Estimate, Sequence[Any]]]
#: Remedies for limits that a law of the user or one of ours ignores.
_REMEDIES = ("if the law keeps them, set `obeys_limits = True` in its class", 'use law="mpc"')


@checked_class
class TrackingController(Pilot):
    """Steers the craft along a reference.

    Each step predicts the state over the transport delay, to the time at which the command acts.
    The law then computes the command.

    Parameters
    ----------
    model : Model
        The craft; its thrust curves must rise.
    reference : Reference
        Reference to track; may be replaced at any time.
    tuning : Tuning, optional
        Tuning; by default the one for the model.
    law : str, or subclass of Law or an object of it, optional
        The law, such as "mpc", FILE.py:NAME or ``MyLaw``; by default the tuning's. An object is
        copied.
    table : Table, optional
        The table whose rails a predictive law avoids; by default the paper's.
    limits : sequence of Fence, KeepOut and HalfPlane, optional
        Limits for a law that obeys them (`Law.obeys_limits`), such as "mpc"; may be replaced at any
        time. Other laws warn about soft limits and reject hard ones. Discs and half planes add to
        the tuning's limits. A fence replaces the tuning's and the table's rails; several fences all
        hold.
    gain : array, shape (3, 6), optional
        Gain of the law `LQR`.
    reject_disturbance : bool, default True
        Whether the estimated disturbance is compensated. Without compensation a poor model leaves a
        steady-state offset, like the paper's M0.
    compensate_delay : bool, default True
        Whether the state is predicted over the transport delay. The paper's controller predicted it
        only to the present.
    compiled : bool, default True
        Whether to compile the mathematics (takes a second, once) or run it in NumPy.

    Attributes
    ----------
    law : Law
        Must not be replaced: programs are compiled for it.
    state : object
        The law's state between steps.

    Raises
    ------
    InputError
        If a thrust curve falls somewhere, the propellers cannot produce every acceleration, a gain
        is not finite, the reference is beyond the rails of the given table, or the law does not
        obey hard limits.

    Examples
    --------
    >>> controller = airpuck.TrackingController(model, airpuck.SetPoint(0.2, 0.0, 0.0))
    >>> controller.pose(0.0, np.zeros(3))
    >>> controller.step(0.0).status
    'scaled'
    """

    SHOWN = "model=model.name reference law limits period_s=tuning.period_s"

    def __init__(
        self,
        model: Model,
        reference: Reference,
        tuning: Tuning | None = None,
        *,
        law: str | type[Law] | Law | None = None,
        table: Table | None = None,
        limits: Sequence[Limit] = (),
        gain: Float[np.ndarray, "3 6"] | None = None,
        reject_disturbance: bool = True,
        compensate_delay: bool = True,
        compiled: bool = True,
    ) -> None:
        tuning = tuning or tuning_for(model)
        tuning = tuning.with_law(law) if isinstance(law, str) else tuning
        vehicle = model.vehicle
        check_steerable(model)
        if gain is not None:
            gain = numbers_of(gain, (3, 6), "gain")
        if table is not None:
            check_inside(reference, table.reach(0.0), "the table")
        self.model, self.reference, self.tuning = model, reference, tuning
        self.compensate_delay, self._idle = compensate_delay, vehicle.idle
        limits = checked_limits(limits)
        options = LawOptions(table or Table(), limits, gain, reject_disturbance, compiled)
        moved = of_means(tuning.turning(model))
        self.law = make_law(law or tuning.law.kind, moved, tuning, options)
        self.limits = limits
        self.law.stage = stage_of_means(model, self.law.stage)
        self._modulator = modulator_for(model, tuning)
        self.state = self.law.init()
        self.filter = _estimator(model, tuning.estimation, compiled)
        self._compiled, self._programs = compiled, {}
        self._program(self.law.inputs)
        # Without compensation it flies like the paper's controller, or below an excitation.
        lands = compensate_delay and not self.law.looks_ahead
        learns = tuning.estimation.estimator == "learning"
        self._landing = Landing(model) if lands and learns else None
        self._gate = PoseGate(longest_pause(model, tuning))
        #: Speed of the craft in the last step [m/s].
        self._speed = 0.0
        #: Latest time that is certain to have passed; -inf: none yet.
        self._clock = -math.inf

    @property
    def limits(self) -> tuple[Limit, ...]:
        """Limits that the law obeys, or ignores with a warning; see `Law.obeys_limits`."""
        return self._limits

    @limits.setter
    def limits(self, given: Iterable[Limit]) -> None:
        limits = checked_limits(given)
        if limits and not self.law.obeys_limits:
            ours = type(getattr(self.law, "_own", self.law)).__module__.startswith("airpuck.")
            problem = f"are ignored by {self.law.title}; {_REMEDIES[ours]}"
            if any(limit.hard for limit in limits):
                raise InputError(problem, field="limits")
            # At the line of the user; the constructor is called through its check of arguments.
            warnings.warn(f"limits {problem}", stacklevel=2 if hasattr(self, "_limits") else 4)
        self._limits = limits

    def pose(self, time: float, pose: Numbers) -> None:
        """Receive a measured pose.

        The controller ignores a pose that is not finite, not newer than the last, or implausibly
        far from its prediction. A pose is too old after `airpuck.control.pose_gate.longest_pause`,
        which is 50 ms for the paper's craft and cameras. Poses that agree with each other for that
        long are accepted anywhere. A pose that is older than the last by more than that shows that
        the last stamp was wrong, and is accepted at once; so is the first pose after such a gap.

        Parameters
        ----------
        time : float
            Time stamp of the pose [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad]. The array is copied.

        Raises
        ------
        InputError
            If the pose is not three numbers.
        """
        if self._gate.offer(self.filter, time, _copied(pose, 3, "pose")):
            self._clock = max(self._clock, time)

    def measured(self, measurement: Measurement) -> None:
        """Receive a measurement.

        Readings of on-board sensors may arrive later than poses with newer stamps. The controller
        ignores a reading that is not finite, or too far from the last pose (see `pose`).

        Parameters
        ----------
        measurement : Measurement
            A pose of the craft (see `pose`), or a reading of ``imu`` or ``mouse``; others are
            ignored.

        Raises
        ------
        InputError
            If its size differs from that sensor's.
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
        """Receive the command that was actually sent.

        A command that is not finite counts as not sent: the previous one stays in force. A time
        that is not finite, or too far ahead of the last step, pose and command, is replaced by the
        present.

        Parameters
        ----------
        time : float
            When [s].
        command : array, shape (n,)
            Motor commands. The array is copied.

        Raises
        ------
        InputError
            If the number of commands differs from the number of propellers.
        """
        command = _copied(command, len(self._idle), "command")
        if not all_finite(command):
            return
        if math.isfinite(self._clock) and not -math.inf < time <= self._clock + self._gate.pause:
            time = self._clock
        if not math.isfinite(time):
            return
        self._clock = max(self._clock, time)
        self.filter.command(time, command)
        self.filter.run_motors(time - remembered(self._gate.pause))

    def step(self, time: float) -> Step:
        """Compute the command to send now; report the command actually sent with `sent`.

        Parameters
        ----------
        time : float
            Current time, on the clock of the poses [s].

        Returns
        -------
        Step
            A command in every case: idle, with a reason, if the craft cannot be steered.
        """
        refusal = self.refusal(time)
        if refusal is not None:
            self._modulator.reset()
            self._speed = 0.0
            return Step(self._idle.copy(), refusal, np.zeros(3), None)
        landing, foresee = self._landing, partial(self._foresee, time)
        if landing is None:
            return self._act(time, foresee, self.reference)
        step = landing.land(time, self._act(time, foresee, landing.reference(self.reference)))
        if landing.retries(time):
            self.filter.forget()
        return step

    def _foresee(self, time: float, *inputs: Any) -> tuple[Estimate, Sequence[Any]]:
        """Predict the craft and evaluate the law's stage there; see `Moment`."""
        alone, composed = self._program(inputs)
        if composed is None:
            return alone(self.predict(time), *inputs)
        return self.filter.predict_with(composed, time + self.model.transport_delay, *inputs)

    def _program(self, inputs: Sequence[Any]) -> tuple[Any, Any]:
        """Return the law's stage alone, and with the prediction, for the shapes of its inputs.

        The latter is None where it would be slower. The first call with other shapes compiles.
        """
        shapes = tuple(map(np.shape, inputs))
        if shapes not in self._programs:
            stage, composed = self.law.stage, None
            fast = not self._compiled or large_programs_are_fast()
            if self.compensate_delay and stage and fast:
                composed = self.filter.composed(stage, *inputs)
            self._programs[shapes] = staged(self.law, self.model, self._compiled, inputs), composed
        return self._programs[shapes]

    def _act(self, now: float, foresee: _Foresee, reference: Reference) -> Step:
        """Let the law compute the command, and store its state."""
        delay = self.model.transport_delay + self.filter.later
        moment = Moment(reference, now, delay, foresee, self.limits)
        step, self.state = self.law.step(self.state, moment)
        self._speed = 0.0 if step.estimate is None else math.hypot(*step.estimate.state[3:5])
        return replace(step, command=self._modulator.command(now, step.command))

    def predict(self, time: float) -> Estimate:
        """Predict the craft for the time at which a command sent now begins to act.

        Parameters
        ----------
        time : float
            Now [s].

        Returns
        -------
        Estimate
            State, motor speeds and disturbance at that time.

        Raises
        ------
        InputError
            If no pose has come, or the time is not finite.
        """
        if self._gate.received is None or not math.isfinite(time):
            raise InputError("needs a pose of the craft first, and a finite time", field="time")
        acting = self.filter.predict(time + self.model.transport_delay)
        if self.compensate_delay:
            return acting
        # As if commands in transit acted already, on a craft that has not moved yet.
        return replace(self.filter.predict(time), motor_speed=acting.motor_speed)

    def steer(self, estimate: Estimate, now: float) -> Step:
        """Compute the command for an estimate, regardless of the clock.

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
        foresee = lambda *inputs: self._program(inputs)[0](estimate, *inputs)  # noqa: E731
        return self._act(now, foresee, self.reference)

    def refusal(self, time: float) -> Status | None:
        """Return why the craft cannot be steered now.

        Parameters
        ----------
        time : float
            Now [s].

        Returns
        -------
        str or None
            Status of a step that idles the motors; None if the craft can be steered.
        """
        if not math.isfinite(time):
            return "bad input"
        self._clock = time
        return self._gate.refusal(time, self._speed)


def check_steerable(model: Model) -> None:
    """Raise InputError if a craft cannot be pushed and turned in every direction."""
    if _commands_all_directions(model):
        return
    vehicle = model.vehicle
    missing = control_authority(nominal_model(vehicle)).sentences
    why = f" ({'; '.join(missing)})" if missing else ""
    raise InputError(
        f"the propellers of {vehicle.name!r} cannot push and turn in every direction{why}, so no "
        "controller can steer it; `airpuck check`, `identify`, `evaluate`, `faults` and `plan` "
        "work without one. If this is wrong, correct the vehicle file"
    )


def _commands_all_directions(model: Model) -> bool:
    """Return whether forces and moments span all accelerations, and cancel in the vehicle file.

    Thrusts of a craft that lost a motor may not cancel; it is steered as well as it can be.
    """
    # Express moments as forces at the radius of gyration: one unit for all three rows.
    spans = np.linalg.matrix_rank(model.propeller_effects, rtol=1e-6) == 3
    return bool(spans) and weakest_effort(nominal_model(model.vehicle)) >= LEAST_EFFORT


def _copied(values: Numbers, count: int, name: str) -> Float[np.ndarray, " k"]:
    """Copy an array that a caller may change later, and check its shape."""
    try:
        copied = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"must be {count} numbers", field=name) from None
    if copied.shape != (count,):
        raise InputError(
            f"must be {count} numbers, not an array of shape {copied.shape}", field=name
        )
    return copied


def _estimator(model: Model, estimation: Estimation, compiled: bool) -> KalmanFilter:
    """Return the estimator that the tuning names."""
    if estimation.estimator == "kalman":
        return KalmanFilter(model, estimation.noise, compiled=compiled)
    learned = estimation.learned_s if estimation.estimator == "learning" else None
    lasting = estimation.forgetting_s
    return ActuationFilter(
        model, estimation.noise, lasting=lasting, learned=learned, compiled=compiled
    )
