"""State estimation from past poses and commands: a Kalman filter with a disturbance.

The accelerations of x, y and γ are those of the model under the commands that act at the time,
plus a disturbance d that wanders slowly. Given the yaw, which the motion capture measures well,
the three axes are independent: each has a state (p, v, d) with p' = v, v' = a(t) + d + w₁, d' = w₂.

The mathematics is in three pure functions (`airpuck.estimate.axis_filter`); `KalmanFilter` keeps
the books and runs them compiled.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.estimate.axis_filter import Estimate, Noise, correct, propagate, spread
from airpuck.model.compiled import for_real_time
from airpuck.model.motor import motor_step
from airpuck.model.rigid_body import acceleration
from airpuck.model_file import Model

#: Pieces of time with one command each that a call handles: few, since XLA gives programs above
#: some size to several threads, which costs more than all the arithmetic.
_PIECES_TO_PREDICT, _PIECES_TO_MEASURE = 3, 1
#: How late a measurement may come where sensors have different latencies [s].
_REMEMBERED = 0.1

#: One turn of each axis, and its inverse: only the yaw goes round.
_TURN, _PER_TURN = np.array([0.0, 0.0, 2 * np.pi]), np.array([0.0, 0.0, 0.5 / np.pi])


#: Time, mean, covariance, motor speeds, the command that acts, how many have begun to.
_State = tuple[
    float,
    Float[np.ndarray, "3 3"],
    Float[np.ndarray, "3 3 3"],
    Float[np.ndarray, " n"],
    Float[np.ndarray, " n"],
    int,
]


class KalmanFilter:
    """Estimates state, motor speeds and disturbance; uses nothing from the future.

    Parameters
    ----------
    model : Model
        The craft, with its transport delay.
    noise : Noise
        What to expect of measurements and model.
    compiled : bool, default True
        Whether to compile the mathematics (a second, once) or to run it in NumPy.

    Notes
    -----
    Commands act `model.transport_delay` after their time. They must be given in the order of their
    times and before measurements that they have acted on.

    Once an inertial sensor or a mouse has spoken, the measurements of the last 100 ms are
    remembered with the filter before each: one that comes late is put where it belongs, and those
    after it are used again.
    """

    #: Standard deviation of velocity and disturbance at the first pose, in each axis.
    _INITIAL_VELOCITY = np.array([0.5, 0.5, 5.0])
    _INITIAL_DISTURBANCE = np.array([0.1, 0.1, 3.0])

    def __init__(self, model: Model, noise: Noise, *, compiled: bool = True) -> None:
        self.model = model
        self._pose_variance = np.square(noise.pose)
        self._noise = np.square(noise.acceleration), np.square(noise.disturbance)
        self._estimates_disturbance = self._noise[1] > 0
        self._idle = np.full(model.vehicle.n_propellers, model.vehicle.command_min)
        self._propagate, self._measure_pose = self._programs(compiled)
        self.reset()

    def _programs(self, compiled: bool) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """Return what runs at every pose and every prediction."""
        dynamics, noise, pose_variance = self.model.dynamics, self._noise, self._pose_variance

        def programs(xp: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
            def predict(mean: Any, speed: Any, durations: Any, commands: Any) -> Any:
                return propagate(xp, dynamics, mean, speed, durations, commands)

            def measure(
                mean: Any,
                covariance: Any,
                speed: Any,
                duration: Any,
                durations: Any,
                commands: Any,
                pose: Any,
            ) -> Any:
                mean, speed = propagate(xp, dynamics, mean, speed, durations, commands)
                covariance = spread(xp, covariance, duration, *noise)
                innovation = pose - mean[:, 0]
                innovation = innovation - _TURN * xp.round(innovation * _PER_TURN)
                mean, covariance = correct(mean, covariance, 0, innovation, pose_variance)
                return mean, covariance, speed, innovation

            return predict, measure

        if not compiled:
            return programs(np)
        import jax.numpy as jnp

        predict, measure = programs(jnp)
        n, mean, covariance = len(self._idle), np.zeros((3, 3)), np.zeros((3, 3, 3))
        to_predict = np.zeros(_PIECES_TO_PREDICT), np.zeros((_PIECES_TO_PREDICT, n))
        to_measure = np.zeros(_PIECES_TO_MEASURE), np.zeros((_PIECES_TO_MEASURE, n))
        return (
            for_real_time(predict, mean, self._idle, *to_predict),
            for_real_time(measure, mean, covariance, self._idle, 0.0, *to_measure, np.zeros(3)),
        )

    def reset(self) -> None:
        """Forget everything."""
        self._time: float | None = None
        self._mean = np.zeros((3, 3))
        self._covariance = np.zeros((3, 3, 3))
        self._motor_speed = self._idle
        self._acting = self._idle
        #: Commands on their way: when they begin to act, and what they are.
        self._pending: deque[tuple[float, Float[np.ndarray, " n"]]] = deque()
        #: Time of the motor speeds where they have left the rest behind.
        self._motors_at: float | None = None
        #: Measurements and the filter before each: stamp, state, method, arguments.
        self._history: deque[tuple[float, _State, str, tuple[Any, ...]]] = deque()
        self._remembers = False
        #: How many commands have begun to act, and those that the history may need again.
        self._begun = 0
        self._recent: deque[tuple[float, Float[np.ndarray, " n"]]] = deque()

    @property
    def time(self) -> float | None:
        """Time of the last measurement; None before the first pose [s]."""
        return self._time

    def command(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Take note of a command that was sent.

        Parameters
        ----------
        time : float
            When it was sent [s].
        command : array, shape (n,)
            Motor commands. They are copied.
        """
        begins = time + self.model.transport_delay
        # Commands that would begin later than this one, which was sent after them, had wrong times.
        while self._pending and self._pending[-1][0] >= begins:
            self._pending.pop()
        self._pending.append((begins, np.array(command, dtype=float)))

    def run_motors(self, time: float) -> None:
        """Go through all commands that began to act before a time, for the motors only.

        Where that is later than the last measurement, the rest of the state is lost: the next pose
        begins anew.

        Parameters
        ----------
        time : float
            Up to when [s].
        """
        while self._pending and self._pending[0][0] < time:
            begins, command = self._pending.popleft()
            self._turn_motors(begins)
            self._acting = command

    def _turn_motors(self, time: float) -> None:
        """Let the motors run under the command that acts until a time, if it is later."""
        last = self._time if self._motors_at is None else self._motors_at
        if last is not None and time <= last:
            return
        if last is not None:
            tau = self.model.dynamics.motor_time_constant
            self._motor_speed = motor_step(np, self._motor_speed, self._acting, time - last, tau)
        self._motors_at = time
        self._forget()

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
            Its stamp [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad], wrapped or not.
        gate : tuple of float, optional
            Largest difference from the prediction, the yaw's wrapped, at which the pose is used
            [m, m, rad]; by default any.

        Returns
        -------
        bool
            Whether it was used; otherwise the filter is as it was. One from before what is
            remembered is not.
        """
        if self._time is None or self._motors_at is not None:
            self.restart(time, pose)
            return True
        if time < self._time:
            return self._late(time, "pose", (time, np.array(pose, dtype=float), gate))
        mean, speed, pieces, used = self._pieces(time, _PIECES_TO_MEASURE)
        mean, covariance, speed, innovation = self._measure_pose(
            mean, self._covariance, speed, time - self._time, *pieces, pose
        )
        if gate is not None:
            x, y, yaw = innovation.tolist()
            if abs(x) > gate[0] or abs(y) > gate[1] or abs(yaw) > gate[2]:
                return False
        before = self._state() if self._remembers else None
        self._settle(used)
        self._mean, self._covariance, self._motor_speed, self._time = mean, covariance, speed, time
        if before is not None:
            # It was plausible once: a late measurement must not change that.
            self._remember(before, "pose", (time, np.array(pose, dtype=float)))
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
            Its stamp; from before what is remembered, it is not used [s].
        acceleration_body : array, shape (2,)
            Acceleration along the body's x and y axes [m/s²].
        gyro : float
            Spin [rad/s].
        noise : tuple of float
            Standard deviations of acceleration and spin [m/s², rad/s].
        """
        given = time, np.array(acceleration_body, dtype=float), gyro, noise
        before = self._prepare(time, "imu", given)
        if before is None:
            return
        self._advance(time)
        (_, vx, dx), (_, vy, dy), (yaw, spin, _) = self._mean
        modelled = acceleration(np, self.model.dynamics, (yaw, vx, vy, spin), self._motor_speed)
        world = self._to_world(acceleration_body)
        self._correct(2, [world[0] - modelled[0] - dx, world[1] - modelled[1] - dy, 0.0], noise[0])
        variance = np.array([np.inf, np.inf, noise[1] ** 2])
        innovation = np.array([0.0, 0.0, gyro - self._mean[2, 1]])
        self._mean, self._covariance = correct(
            self._mean, self._covariance, 1, innovation, variance
        )
        self._remember(before, "imu", given)

    def mouse(self, time: float, velocity: Float[np.ndarray, " 2"], noise: float) -> None:
        """Use the velocity that the optical sensor under the craft measured.

        Parameters
        ----------
        time : float
            Its stamp; from before what is remembered, it is not used [s].
        velocity : array, shape (2,)
            Velocity along the body's x and y axes [m/s].
        noise : float
            Standard deviation [m/s].
        """
        given = time, np.array(velocity, dtype=float), noise
        before = self._prepare(time, "mouse", given)
        if before is None:
            return
        self._advance(time)
        vx, vy = self._to_world(velocity)
        self._correct(1, [vx - self._mean[0, 1], vy - self._mean[1, 1], 0.0], noise)
        self._remember(before, "mouse", given)

    def predict(self, time: float) -> Estimate:
        """Predict with the commands that are known, without changing anything.

        Parameters
        ----------
        time : float
            When, at or after the last measurement; later than the last command's action, that
            command is taken to stay in force [s].

        Returns
        -------
        Estimate
            The prediction.
        """
        mean, speed, pieces, _ = self._pieces(time, _PIECES_TO_PREDICT)
        mean, speed = self._propagate(mean, speed, *pieces)
        return Estimate(time, mean[:, :2].T.ravel(), speed, mean[:, 2])

    def restart(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Begin anew at a pose, at rest; commands and motor speeds are kept.

        Parameters
        ----------
        time : float
            Stamp of the pose [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        """
        if self._time is not None and time < self._time and self._motors_at is None:
            self._rewind(time)
        while self._pending and self._pending[0][0] <= time:
            begins, command = self._pending.popleft()
            self._turn_motors(begins)
            self._acting = command
        self._turn_motors(time)
        self._motors_at = None
        self._forget()
        self._time = time
        self._mean = np.zeros((3, 3))
        self._mean[:, 0] = pose
        self._covariance = np.zeros((3, 3, 3))
        self._covariance[:, 0, 0] = self._pose_variance
        self._covariance[:, 1, 1] = self._INITIAL_VELOCITY**2
        self._covariance[:, 2, 2] = self._INITIAL_DISTURBANCE**2 * self._estimates_disturbance

    def _advance(self, time: float) -> None:
        """Move everything to a later time without a measurement."""
        assert self._time is not None
        mean, speed, pieces, used = self._pieces(time, _PIECES_TO_PREDICT)
        self._mean, self._motor_speed = self._propagate(mean, speed, *pieces)
        self._covariance = spread(np, self._covariance, time - self._time, *self._noise)
        self._settle(used)
        self._time = time

    def _settle(self, used: int) -> None:
        """Take commands off the list that have begun to act."""
        for _ in range(used):
            begun = self._pending.popleft()
            self._acting = begun[1]
            if self._remembers:
                self._begun += 1
                self._recent.append(begun)

    def _state(self) -> _State:
        """Return what a measurement changes; the arrays are never written to."""
        assert self._time is not None
        return (
            self._time,
            self._mean,
            self._covariance,
            self._motor_speed,
            self._acting,
            self._begun,
        )

    def _prepare(self, time: float, kind: str, given: tuple[Any, ...]) -> _State | None:
        """Return the state to remember before a measurement; None if nothing is left to do."""
        if self._time is None or self._motors_at is not None:
            return None
        self._remembers = True
        if time < self._time:
            self._late(time, kind, given)
            return None
        return self._state()

    def _remember(self, before: _State, kind: str, given: tuple[Any, ...]) -> None:
        """Note a measurement that was used, and let go of old ones."""
        history, time = self._history, given[0]
        history.append((time, before, kind, given))
        while history[0][0] < time - _REMEMBERED:
            history.popleft()
        while self._begun - len(self._recent) < history[0][1][-1]:
            self._recent.popleft()

    def _forget(self) -> None:
        """Let go of everything that was remembered."""
        self._history.clear()
        self._recent.clear()

    def _late(self, time: float, kind: str, given: tuple[Any, ...]) -> bool:
        """Use a measurement from before the last one; say whether it was used."""
        later = self._rewind(time)
        if later is None:
            return False
        used = getattr(self, kind)(*given)
        for again, arguments in later:
            getattr(self, again)(*arguments)
        return used is not False

    def _rewind(self, time: float) -> list[tuple[str, tuple[Any, ...]]] | None:
        """Go back to before all measurements later than a time, and return these.

        None, and nothing is changed, where that is not remembered.
        """
        history = self._history
        count = sum(entry[0] > time for entry in history)
        if count == 0 or history[-count][1][0] > time:
            return None
        state, later = history[-count][1], [entry[2:] for entry in list(history)[-count:]]
        for _ in range(count):
            history.pop()
        self._time, self._mean, self._covariance, self._motor_speed, self._acting, begun = state
        for _ in range(self._begun - begun):
            self._pending.appendleft(self._recent.pop())
        self._begun = begun
        return later

    def _pieces(
        self, time: float, most: int
    ) -> tuple[Any, Any, tuple[Float[np.ndarray, " S"], Float[np.ndarray, "S n"]], int]:
        """Cut the time until `time` where commands change.

        Returns mean and motor speeds, the durations and commands of the last `most` pieces, and how
        many pending commands have begun to act. Earlier pieces are gone through already.
        """
        assert self._time is not None
        pieces, now, acting, used = [], self._time, self._acting, 0
        for begins, command in self._pending:
            if begins > time:
                break
            if begins > now:
                pieces.append((begins - now, acting))
                now = begins
            acting = command
            used += 1
        pieces.append((time - now, acting))
        mean, speed = self._mean, self._motor_speed
        early = max(len(pieces) - most, 0)
        for first in range(0, early, _PIECES_TO_PREDICT):
            some = pieces[first : min(first + _PIECES_TO_PREDICT, early)]
            mean, speed = self._propagate(mean, speed, *_arrays(some, _PIECES_TO_PREDICT))
        return mean, speed, _arrays(pieces[early:], most), used

    def _to_world(self, vector: Float[np.ndarray, " 2"]) -> tuple[float, float]:
        """Turn a body vector into the world frame."""
        cos, sin = np.cos(self._mean[2, 0]), np.sin(self._mean[2, 0])
        return cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]

    def _correct(self, component: int, innovation: list[float], deviation: float) -> None:
        """Use a measurement of x and y that the compiled programs do not know."""
        variance = np.array([deviation**2, deviation**2, np.inf])
        self._mean, self._covariance = correct(
            self._mean, self._covariance, component, np.array(innovation), variance
        )


def _arrays(
    pieces: list[tuple[float, Float[np.ndarray, " n"]]], size: int
) -> tuple[Float[np.ndarray, " S"], Float[np.ndarray, "S n"]]:
    """Lay pieces out as arrays of a fixed size, filled up with pieces of no length."""
    durations = np.zeros(size)
    durations[: len(pieces)] = [duration for duration, _ in pieces]
    commands = [command for _, command in pieces]
    return durations, np.array(commands + commands[-1:] * (size - len(commands)))
