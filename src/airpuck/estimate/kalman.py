"""State estimation in closed loop, from one measurement to the next.

The accelerations of x, y and γ are the model's under the commands in force, plus a slowly varying
disturbance d. The equations are in `airpuck.estimate.axis_filter`, and for unknown motors in
`airpuck.estimate.multiple_models`. Commands act a transport delay after they were sent.
Measurements come at any time and may come late ("out of sequence").
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.compute.arrays import register_pytree
from airpuck.compute.compiled import Applied, program
from airpuck.estimate.actuation import LEARNED, ActuationEncoder
from airpuck.estimate.axis_filter import IndependentAxes, Noise
from airpuck.estimate.estimator import BEYOND, ActuationEstimate, Estimate, HeldCommands
from airpuck.estimate.multiple_models import Memory, MultipleModels, States, certain
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import register_pytrees

#: Number of one-command intervals that one call handles; longer times take several calls. A command
#: begins to act between two poses of 240 Hz nearly half of the time.
_PIECES_TO_PREDICT, _PIECES_TO_MEASURE = 3, 2
#: Standard deviation of a delay that is learned [s].
_LEARNED_DELAY = 8e-3
#: Standard deviation of a packet's delay if the model has none, for packets that do not overtake
#: each other (studies/coverage.md) [s].
_JITTER = 6.3e-3
#: Bounds of a learned delay beyond the model's [s], and its largest change from pose to pose.
_LATER, _CHANGE = (-0.02, 0.05), 1e-3
#: Largest lateness of a measurement if sensors have different latencies [s].
_REMEMBERED = 0.1
#: A belief about the craft in the form of the equations: arrays that are never written to.
AnyBelief = tuple[Any, ...]
#: Time, belief, motor speeds and learned delay.
_FilterState = tuple[float, AnyBelief, Float[np.ndarray, " n"], float]
#: Durations [s] and commands of intervals.
_Pieces = tuple[Float[np.ndarray, " S"], Float[np.ndarray, "S n"]]


class KalmanFilter:
    """Estimates state, motor speeds and disturbance; uses nothing from the future.

    It assumes that motors follow the model, unless other states of the craft are given.

    Parameters
    ----------
    model : Model
        The craft, with its transport delay.
    noise : Noise
        Noise of measurements and model.
    states : States, optional
        Competing states of the craft; by default motors follow the model.
    compiled : bool, default True
        Whether to compile the mathematics (takes a second, once) or run it in NumPy.
    """

    def __init__(
        self, model: Model, noise: Noise, *, states: States | None = None, compiled: bool = True
    ) -> None:
        self.model = model
        self._compiled = compiled
        self._idle = np.full(model.vehicle.n_propellers, model.vehicle.command_min)
        self._states = states
        self._equations = equations = (
            IndependentAxes(model.dynamics, noise)
            if states is None
            else MultipleModels(model.dynamics, noise, states)
        )
        first = *equations.begin(np.zeros(3), None, 0.0), self._idle
        #: Arguments of a prediction, as examples for the compiler.
        self._examples = *first, *_arrays([(0.0, self._idle)], _PIECES_TO_PREDICT)
        if compiled:
            register_pytrees()
            register_pytree(Noise)
            register_pytree(IndependentAxes)

        advance = Applied(lambda xp, known, *given: known.advance(xp, *given), equations)
        self._advance_by = program(advance, *self._examples, compiled=compiled)
        measured = *first, *_arrays([(0.0, self._idle)], _PIECES_TO_MEASURE), np.zeros(3)
        use_pose = Applied(lambda xp, known, *given: known.use_pose(xp, *given), equations)
        self._use_pose = program(use_pose, *measured, compiled=compiled)
        self._predict = self.composed(lambda *_: ())
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._time: float | None = None
        self._belief: Any = ()
        self._motor_speed = self._idle
        #: Commands, from the one in force at the oldest stored time on.
        self._commands = HeldCommands(self._idle)
        #: Time of the motor speeds, if later than the belief's.
        self._motors_at: float | None = None
        #: Measurements and the filter before each: stamp, state, method, arguments.
        self._history: deque[tuple[float, _FilterState, str, tuple[Any, ...]]] = deque()
        #: Whether an on-board sensor has reported, so that measurements may come late.
        self._remembers = False

    @property
    def time(self) -> float | None:
        """Time of the last measurement; None before the first pose [s]."""
        return self._time

    @property
    def later(self) -> float:
        """Learned delay beyond the model's [s]."""
        return self._commands.later

    def command(self, time: float, command: Float[np.ndarray, " c"]) -> None:
        """Record a command that was sent.

        Parameters
        ----------
        time : float
            Time of sending [s]. The command begins to act a transport delay later.
        command : array, shape (c,)
            A command for each actuator. The array is copied.
        """
        self._commands.send(time, command, self.model)

    def run_motors(self, time: float) -> None:
        """Advance only the motors, up to the last command that begins to act before a time.

        If that is later than the last measurement, the rest of the state is lost: the next pose
        restarts the filter.

        Parameters
        ----------
        time : float
            Time to advance to [s].
        """
        for begins, _ in self._commands.until(time)[-1:]:
            self._turn_motors(begins)

    def _turn_motors(self, time: float) -> None:
        """Advance only the motors to a time, if it is later than theirs."""
        last = self._time if self._motors_at is None else self._motors_at
        last = -math.inf if last is None else last
        if time <= last:
            return
        tau, idle = self.model.dynamics.lag, self.model.dynamics.idle_lag
        for duration, command in self._commands.cut(last, time):
            self._motor_speed = motor_step(np, self._motor_speed, command, duration, tau, idle)
        self._motors_at = time
        self._history.clear()
        self._commands.drop(time)

    def pose(
        self,
        time: float,
        pose: Float[np.ndarray, " 3"],
        gate: tuple[float, float, float] | None = None,
    ) -> bool:
        """Use a measured pose.

        Parameters
        ----------
        time : float
            Time stamp of the pose [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad], wrapped or not.
        gate : tuple of float, optional
            Largest innovation (with the yaw wrapped) at which the pose is used [m, m, rad]; by
            default unlimited.

        Returns
        -------
        bool
            Whether the pose was used; otherwise the filter does not change. A pose older than the
            stored history is not used.
        """
        if self._time is None or self._motors_at is not None:
            self.restart(time, pose)
            return True
        if time < self._time:
            return self._late(time, "pose", (time, np.array(pose, dtype=float), gate))
        belief, speed, pieces = self._pieces(time, _PIECES_TO_MEASURE)
        *belief, speed, innovation = self._use_pose(*belief, speed, *pieces, pose)
        if gate is not None:
            x, y, yaw = innovation.tolist()
            # NaN counts as too far, too: the estimate is lost, and a restart recovers it.
            if not (abs(x) <= gate[0] and abs(y) <= gate[1] and abs(yaw) <= gate[2]):
                return False
        if self._remembers:
            # It passed the check once: a late measurement must not change that.
            self._remember("pose", (time, np.array(pose, dtype=float)))
        self._settle(time, tuple(belief), speed)
        if self._states is not None and self._states.memory is not None:
            self._apply_delay()
        return True

    def imu(
        self,
        time: float,
        acceleration_body: Float[np.ndarray, " 2"],
        gyro: float,
        noise: tuple[float, float],
    ) -> None:
        """Use an inertial measurement.

        Parameters
        ----------
        time : float
            Time stamp; a measurement older than the stored history is not used [s].
        acceleration_body : array, shape (2,)
            Acceleration along the body's x and y axes [m/s²].
        gyro : float
            Spin [rad/s].
        noise : tuple of float
            Standard deviations of acceleration and angular velocity [m/s², rad/s].
        """
        given = time, np.array(acceleration_body, dtype=float), gyro, noise
        if self._advance(time, "imu", given):
            motors = self._motor_speed, self._commands.cut(time, time)[-1][1]
            self._belief = self._equations.use_imu(self._belief, motors, *given[1:])

    def mouse(self, time: float, velocity: Float[np.ndarray, " 2"], noise: float) -> None:
        """Use the velocity measured by the optical sensor under the craft.

        Parameters
        ----------
        time : float
            Time stamp; a measurement older than the stored history is not used [s].
        velocity : array, shape (2,)
            Velocity along the body's x and y axes [m/s].
        noise : float
            Standard deviation [m/s].
        """
        given = time, np.array(velocity, dtype=float), noise
        if self._advance(time, "mouse", given):
            self._belief = self._equations.use_mouse(self._belief, *given[1:])

    def _apply_delay(self) -> None:
        """Let commands act as late as is certain; the equations are linear around that delay."""
        means, covariances, weights, density = self._belief
        at = 9 + self.model.vehicle.n_propellers
        rest = float(weights @ means[:, at])
        variance = float(weights @ (covariances[:, at, at] + (means[:, at] - rest) ** 2))
        later = float(np.clip(certain(np, self.later + rest, variance), *_LATER))
        change = float(np.clip(later - self.later, -_CHANGE, _CHANGE))
        self._commands.later += change
        means = np.array(means)
        means[:, at] -= change
        self._belief = means, covariances, weights, density
        tau, idle = self.model.dynamics.lag, self.model.dynamics.idle_lag
        assert self._time is not None
        [(_, command)] = self._commands.cut(self._time, self._time)[-1:]
        speed = motor_step(np, self._motor_speed, command, -change, tau, idle)
        self._motor_speed = np.clip(speed, self._idle, self.model.vehicle.command_max)

    def predict(self, time: float) -> Estimate:
        """Predict with the commands reported to the filter, without changing its state.

        Parameters
        ----------
        time : float
            Time of the prediction, at or after the last measurement, if the model's delay is right
            [s]; a learned delay is added. The last command stays in force.

        Returns
        -------
        Estimate
            The prediction.
        """
        return self.predict_with(self._predict, time)[0]

    def composed(self, then: Callable[..., Any], *examples: Any) -> Callable[..., Any]:
        """Combine a prediction and a function of it in one program: each call costs time.

        Parameters
        ----------
        then : callable
            Pure function of an array namespace, the predicted state, motor speeds, disturbance and
            effectiveness of the motors (as in `Estimate`), and further arrays; it returns a tuple
            of arrays.
        *examples : array or float
            Further arrays, with the shapes that it will be called with.

        Returns
        -------
        callable
            For `predict_with`.
        """
        count, known = len(self._examples), (self._equations, then)

        def both(xp: Any, known: Any, *given: Any) -> tuple[Any, ...]:
            equations, then = known
            predicted = equations.predict(xp, *given[:count])
            return *predicted, *then(xp, *predicted[:4], *given[count:])

        return program(Applied(both, known), *self._examples, *examples, compiled=self._compiled)

    def predict_with(
        self, composed: Callable[..., Any], time: float, *more: Any
    ) -> tuple[Estimate, Sequence[Any]]:
        """Predict, and evaluate a function of the prediction.

        Parameters
        ----------
        composed : callable
            Result of `composed`, from this filter or an equivalent one.
        time : float
            Time of the prediction; see `predict` [s].
        *more : array or float
            Further arguments of the function.

        Returns
        -------
        estimate : Estimate
            The prediction.
        results : sequence of array
            Results of the function.
        """
        time += self.later
        belief, speed, pieces = self._pieces(time, _PIECES_TO_PREDICT)
        results = composed(*belief, speed, *pieces, *more)
        state, speed, disturbance, effectiveness, *following = results
        actuation = None
        if self._states is not None:
            e, deviation, weights, *following = following
            probability = dict(zip(self._states.names, weights.tolist(), strict=True))
            n = len(effectiveness)
            delay = self.later + float(e[n]), float(deviation[n])
            found = 1 + e[:n], deviation[:n], probability
            pairs = zip(e[n + 1 :].tolist(), deviation[n + 1 :].tolist(), strict=True)
            # Only a craft that learns has these.
            beyond = dict(zip(BEYOND, pairs, strict=False))
            actuation = ActuationEstimate(*found, *delay, used=effectiveness, beyond=beyond)
        return Estimate(time, state, speed, disturbance, actuation), following

    def restart(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Restart at a pose, at rest; commands and motor speeds are kept.

        Parameters
        ----------
        time : float
            Time stamp of the pose [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        """
        if self._time is not None and time < self._time and self._motors_at is None:
            self._rewind(time)
        before, elapsed = None, 0.0
        if self._time is not None:
            before, elapsed = self._belief, max(time - self._time, 0.0)
        self._turn_motors(time)
        self._motors_at = None
        self._history.clear()
        self._time = time
        self._belief = self._equations.begin(pose, before, elapsed)

    def forget(self) -> None:
        """Reset what `states` describe, such as motors; keep the motion and the delay in use."""
        assert self._time is not None
        last, _ = self.predict_with(self._predict, self._time - self.later)
        self._history.clear()
        self._belief = self._equations.begin(last.state[:3], None, 0.0)
        self._belief[0][:, :9] = np.append(last.state, last.disturbance)

    def _advance(self, time: float, sensor: str, given: tuple[Any, ...]) -> bool:
        """Advance to a measurement of an on-board sensor; return whether to use it now.

        False before the first pose; a late measurement is inserted at its time.
        """
        if self._time is None or self._motors_at is not None:
            return False
        self._remembers = True
        if time < self._time:
            self._late(time, sensor, given)
            return False
        self._remember(sensor, given)
        belief, speed, pieces = self._pieces(time, _PIECES_TO_PREDICT)
        *belief, speed = self._advance_by(*belief, speed, *pieces)
        self._settle(time, tuple(belief), speed)
        return True

    def _settle(self, time: float, belief: AnyBelief, speed: Float[np.ndarray, " n"]) -> None:
        """Store a state and drop commands older than every snapshot."""
        self._time, self._belief, self._motor_speed = time, belief, speed
        self._commands.drop(self._history[0][1][0] if self._history else time)

    def _remember(self, sensor: str, given: tuple[Any, ...]) -> None:
        """Record a measurement and the state before it, and drop old ones."""
        assert self._time is not None
        state, time = (self._time, self._belief, self._motor_speed, self.later), given[0]
        self._history.append((time, state, sensor, given))
        while self._history[0][0] < time - _REMEMBERED:
            self._history.popleft()

    def _late(self, time: float, sensor: str, given: tuple[Any, ...]) -> bool:
        """Use a measurement from before the last one; return whether it was used."""
        later = self._rewind(time)
        if later is None:
            return False
        used = getattr(self, sensor)(*given)
        for again, arguments in later:
            getattr(self, again)(*arguments)
        return used is not False

    def _rewind(self, time: float) -> list[tuple[str, tuple[Any, ...]]] | None:
        """Rewind to a time, and return the measurements after it.

        If the history does not reach back that far, return None and change nothing.
        """
        later = [entry for entry in self._history if entry[0] > time]
        if not later or later[0][1][0] > time:
            return None
        self._time, self._belief, self._motor_speed, self._commands.later = later[0][1]
        for _ in later:
            self._history.pop()
        return [(sensor, given) for _, _, sensor, given in later]

    def _pieces(self, time: float, most: int) -> tuple[Any, Float[np.ndarray, " n"], _Pieces]:
        """Return belief, motor speeds and the last `most` intervals of the time until `time`.

        The belief is the one after all earlier intervals.
        """
        assert self._time is not None
        pieces = self._commands.cut(self._time, time)
        belief, speed = self._belief, self._motor_speed
        early = max(len(pieces) - most, 0)
        for first in range(0, early, _PIECES_TO_PREDICT):
            some = pieces[first : min(first + _PIECES_TO_PREDICT, early)]
            *belief, speed = self._advance_by(*belief, speed, *_arrays(some, _PIECES_TO_PREDICT))
        return belief, speed, _arrays(pieces[early:], most)


def _arrays(pieces: list[tuple[float, Float[np.ndarray, " n"]]], size: int) -> _Pieces:
    """Lay out intervals as arrays of a fixed size, padded with intervals of zero duration."""
    filled = pieces + [(0.0, pieces[-1][1])] * (size - len(pieces))
    durations, commands = zip(*filled, strict=True)
    return np.array(durations), np.array(commands)


class ActuationFilter(KalmanFilter):
    """A Kalman filter that also estimates what each motor does with its command.

    It solves the problem of `airpuck.estimate.actuation`, with the same priors and evidence, in
    closed loop. If `learned` is a time [s], it also learns what lasts, the delay included, and
    predicts with it; after that time without excitation it is as uncertain as at the beginning.
    """

    def __init__(
        self,
        model: Model,
        noise: Noise,
        *,
        encoder: ActuationEncoder | None = None,
        lasting: float = 3.0,
        delay_deviation: float = 3e-3,
        learned: float | None = None,
        compiled: bool = True,
    ) -> None:
        encoder = encoder or ActuationEncoder()
        priors, n = encoder.priors, model.vehicle.n_propellers
        if learned is not None:
            priors, delay_deviation = (LEARNED, *priors[1:]), _LEARNED_DELAY
        size = n + 1 if learned is None else n + 1 + len(BEYOND)
        covariance = np.zeros((len(priors), size, size))
        covariance[:, :n, :n] = [prior.covariance(n) for prior in priors]
        # Motors without lag give no information about the delay: their speed jumps.
        lags = float(model.dynamics.motor_time_constant) > 0
        covariance[:, n, n] = delay_deviation**2 * lags
        memory = None
        if learned is not None:
            jitter = model.delay_jitter.standard_deviation_s if model.delay_jitter else _JITTER
            memory = Memory(learned, model.radius_of_gyration**2, jitter)
            body = np.square(list(BEYOND.values()))
            # The slope is the mean of the disturbance, if there is one.
            body[-2:] *= np.array(noise.disturbance[:2]) > 0
            covariance[0, range(n + 1, size), range(n + 1, size)] = body
        weight = np.array([prior.weight for prior in priors])
        names = tuple(prior.name for prior in priors)
        drawn = names, weight / weight.sum(), covariance, lasting
        states = States(*drawn, encoder.tail, encoder.tempering, memory)
        super().__init__(model, noise, states=states, compiled=compiled)
