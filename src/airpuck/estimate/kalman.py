"""State estimation from past poses and commands: a Kalman filter with a disturbance.

The accelerations of x, y and γ are those of the model under the commands that act at the time,
plus a disturbance d that wanders slowly. Given the yaw, which the motion capture measures well,
the three axes are independent: each has a state (p, v, d) with p' = v, v' = a(t) + d + w₁, d' = w₂.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck.model.motor import motor_step
from airpuck.model.rigid_body import acceleration
from airpuck.model_file import Model


@dataclass(frozen=True)
class Noise:
    """Noise of the three axes x, y, γ.

    Attributes
    ----------
    pose : tuple of float
        Standard deviation of the measured pose [m, m, rad].
    acceleration : tuple of float
        Density of the white acceleration w₁ [m/s²/√Hz, m/s²/√Hz, rad/s²/√Hz].
    disturbance : tuple of float
        Density of w₂, which drives the disturbance [m/s³/√Hz, m/s³/√Hz, rad/s³/√Hz].
    """

    pose: tuple[float, float, float]
    acceleration: tuple[float, float, float]
    disturbance: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What the filter believes.

    Attributes
    ----------
    time : float
        When [s].
    state : array, shape (6,)
        x, y, γ (continuous), vx, vy, ω.
    motor_speed : array, shape (n,)
        Normalised motor speeds φ.
    disturbance : array, shape (3,)
        Acceleration that the model does not explain [m/s², m/s², rad/s²].
    """

    time: float
    state: Float[np.ndarray, " 6"]
    motor_speed: Float[np.ndarray, " n"]
    disturbance: Float[np.ndarray, " 3"]


class KalmanFilter:
    """Estimates state, motor speeds and disturbance; uses nothing from the future.

    Parameters
    ----------
    model : Model
        The craft, with its transport delay.
    noise : Noise
        What to expect of measurements and model.

    Notes
    -----
    Commands act `model.transport_delay` after their time. They must be given in the order of their
    times and before measurements that they have acted on.
    """

    #: Standard deviation of velocity and disturbance at the first pose, in each axis.
    _INITIAL_VELOCITY = np.array([0.5, 0.5, 5.0])
    _INITIAL_DISTURBANCE = np.array([0.1, 0.1, 3.0])

    def __init__(self, model: Model, noise: Noise) -> None:
        self.model = model
        self._dynamics = model.dynamics
        self._pose_variance = np.square(noise.pose)
        self._acceleration_density = np.square(noise.acceleration)
        self._disturbance_density = np.square(noise.disturbance)
        self._estimates_disturbance = self._disturbance_density > 0
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        n = self.model.vehicle.n_propellers
        idle = np.full(n, self.model.vehicle.command_min)
        self._time: float | None = None
        self._mean = np.zeros((3, 3))  # axes x, y, γ; components p, v, d
        self._covariance = np.zeros((3, 3, 3))
        self._motor_speed = idle.copy()
        self._acting = idle.copy()
        #: Commands on their way: when they begin to act, and what they are.
        self._pending: deque[tuple[float, Float[np.ndarray, " n"]]] = deque()

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
            Motor commands.
        """
        self._pending.append((time + self.model.transport_delay, command))

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        """Use a measured pose.

        Parameters
        ----------
        time : float
            Its stamp, later than that of the last measurement [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad], wrapped or not.

        Returns
        -------
        array, shape (3,)
            Innovation: measured minus predicted, the yaw's wrapped.
        """
        if self._time is None:
            self.restart(time, pose)
            return np.zeros(3)
        self._advance(time)
        innovation = pose - self._mean[:, 0]
        innovation[2] = (innovation[2] + np.pi) % (2 * np.pi) - np.pi
        self._update(0, innovation, self._pose_variance)
        return innovation

    def imu(
        self,
        time: float,
        acceleration: Float[np.ndarray, " 2"],
        gyro: float,
        noise: tuple[float, float],
    ) -> None:
        """Use an inertial measurement.

        Parameters
        ----------
        time : float
            Its stamp [s].
        acceleration : array, shape (2,)
            Acceleration along the body's x and y axes [m/s²].
        gyro : float
            Spin [rad/s].
        noise : tuple of float
            Standard deviations of acceleration and spin [m/s², rad/s].
        """
        if self._time is None:
            return
        self._advance(time)
        innovation, variance = np.zeros(3), np.full(3, np.inf)
        modelled = self._model_acceleration(self._motor_speed, self._mean[:, :2])
        innovation[:2] = self._to_world(acceleration) - modelled[:2] - self._mean[:2, 2]
        variance[:2] = noise[0] ** 2
        self._update(2, innovation, variance)
        innovation, variance = np.zeros(3), np.full(3, np.inf)
        innovation[2], variance[2] = gyro - self._mean[2, 1], noise[1] ** 2
        self._update(1, innovation, variance)

    def mouse(self, time: float, velocity: Float[np.ndarray, " 2"], noise: float) -> None:
        """Use the velocity that the optical sensor under the craft measured.

        Parameters
        ----------
        time : float
            Its stamp [s].
        velocity : array, shape (2,)
            Velocity along the body's x and y axes [m/s].
        noise : float
            Standard deviation [m/s].
        """
        if self._time is None:
            return
        self._advance(time)
        innovation, variance = np.zeros(3), np.full(3, np.inf)
        innovation[:2] = self._to_world(velocity) - self._mean[:2, 1]
        variance[:2] = noise**2
        self._update(1, innovation, variance)

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
        mean, speed, _, _ = self._propagate(time)
        return Estimate(time, np.concatenate([mean[:, 0], mean[:, 1]]), speed, mean[:, 2].copy())

    def restart(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Begin anew at a pose, at rest; commands and motor speeds are kept.

        Parameters
        ----------
        time : float
            Stamp of the pose [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        """
        if self._time is not None and time > self._time:
            _, self._motor_speed, self._acting, used = self._propagate(time)
            for _ in range(used):
                self._pending.popleft()
        self._time = time
        self._mean = np.zeros((3, 3))
        self._mean[:, 0] = pose
        self._covariance = np.zeros((3, 3, 3))
        self._covariance[:, 0, 0] = self._pose_variance
        self._covariance[:, 1, 1] = self._INITIAL_VELOCITY**2
        self._covariance[:, 2, 2] = self._INITIAL_DISTURBANCE**2 * self._estimates_disturbance

    def _advance(self, time: float) -> None:
        """Move mean, covariance and motors to a later time."""
        assert self._time is not None
        duration = time - self._time
        self._mean, self._motor_speed, self._acting, used = self._propagate(time)
        for _ in range(used):
            self._pending.popleft()
        self._time = time
        h = duration
        step = np.array([[1.0, h, h * h / 2], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
        # Integrals of the two white noises over the step.
        by_acceleration = np.array([[h**3 / 3, h**2 / 2, 0], [h**2 / 2, h, 0], [0, 0, 0]])
        by_disturbance = np.array(
            [
                [h**5 / 20, h**4 / 8, h**3 / 6],
                [h**4 / 8, h**3 / 3, h**2 / 2],
                [h**3 / 6, h**2 / 2, h],
            ]
        )
        self._covariance = (
            step @ self._covariance @ step.T
            + self._acceleration_density[:, None, None] * by_acceleration
            + self._disturbance_density[:, None, None] * by_disturbance
        )

    def _propagate(
        self, time: float
    ) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " n"], Float[np.ndarray, " n"], int]:
        """Return mean, motor speeds and acting command at a later time, and commands used up."""
        assert self._time is not None
        now, mean, speed, acting, used = self._time, self._mean, self._motor_speed, self._acting, 0
        while now < time or (used < len(self._pending) and self._pending[used][0] <= time):
            until = time
            if used < len(self._pending):
                until = min(max(self._pending[used][0], now), time)
            if until > now:
                mean, speed = self._piece(mean, speed, acting, until - now)
                now = until
            if used < len(self._pending) and self._pending[used][0] <= now:
                acting = self._pending[used][1]
                used += 1
        return mean, speed, acting, used

    def _piece(
        self,
        mean: Float[np.ndarray, "3 3"],
        speed: Float[np.ndarray, " n"],
        command: Float[np.ndarray, " n"],
        h: float,
    ) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " n"]]:
        """Move the mean while one command acts; the acceleration is that of the middle."""
        tau = self._dynamics.motor_time_constant
        middle = motor_step(np, speed, command, h / 2, tau)
        halfway = mean[:, :2].copy()
        halfway[:, 0] += h / 2 * mean[:, 1]
        rate = self._model_acceleration(middle, halfway) + mean[:, 2]
        moved = mean.copy()
        moved[:, 0] += h * mean[:, 1] + h * h / 2 * rate
        moved[:, 1] += h * rate
        return moved, motor_step(np, speed, command, h, tau)

    def _model_acceleration(
        self, motor_speed: Float[np.ndarray, " n"], motion: Float[np.ndarray, "3 2"]
    ) -> Float[np.ndarray, " 3"]:
        """Accelerations of the model, without the disturbance."""
        yaw, vx, vy, spin = motion[2, 0], motion[0, 1], motion[1, 1], motion[2, 1]
        return np.array(acceleration(np, self._dynamics, (yaw, vx, vy, spin), motor_speed))

    def _to_world(self, vector: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " 2"]:
        """Turn a body vector into the world frame."""
        cos, sin = np.cos(self._mean[2, 0]), np.sin(self._mean[2, 0])
        return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])

    def _update(
        self,
        component: int,
        innovation: Float[np.ndarray, " 3"],
        variance: Float[np.ndarray, " 3"],
    ) -> None:
        """Update all axes by a measurement of one component; infinite variance: not measured."""
        column = self._covariance[:, :, component]
        gain = column / (column[:, component] + variance)[:, None]
        self._mean = self._mean + gain * innovation[:, None]
        self._covariance = self._covariance - gain[:, :, None] * column[:, None, :]
