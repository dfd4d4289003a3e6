"""Linear regression of poses on the contribution of each motor and on errors of a model.

Along a measured motion the modelled accelerations are a sum over the motors. Integrated twice, they
give each motor's contribution to the poses. The strength of a motor, and when it began to turn,
follow by weighted least squares with priors, here for a batch of windows at once. Any error of the
model adds accelerations of its own. So poses over short windows, minus the model's and without the
unknown initial pose and velocity, are linear in all errors together.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import Windows, integration_parts, make_windows
from airpuck.deviation.time_scale import clear_time, forgetting_time, showing_time
from airpuck.model.model_file import Model
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics, acceleration, motor_accelerations

#: Time before and after the present of a window [s]; the latter is longer for a slow craft. Jitter
#: of the radio biases accelerations by 3 % for windows of 0.2 s, and by 1 % for windows of 0.4 s.
_PAST_S, _AHEAD_S = 40 / 240, 0.4
#: Step of the finite differences in transport delay and lag [s].
_STEP_S = 1e-3
#: Integration steps per lag of an actuator, and the largest number between two poses. With a
#: lag of 10 ms and poses every 60 ms, 6 and 12 steps agree to 11 ms in timing, and one step misses
#: it by seconds.
_STEPS_PER_LAG, _MOST_PARTS = 2, 12
#: Minimum length [s] and number of the blocks of time behind the standard errors.
_BLOCK_S, _FEWEST_BLOCKS = 0.8, 5
#: Unit of accelerations besides the motors' [m/s², rad/s²], and per speed [1/s].
OTHER_UNIT = 0.1
#: Information in a channel of one window beyond its initial pose and velocity: about two numbers.
_TOLD = 2


def with_effectiveness(dynamics: Dynamics, effectiveness: Float[np.ndarray, "n B"]) -> Dynamics:
    """Return a batch of craft whose motors deliver these fractions of their thrust."""
    return replace(
        dynamics,
        thrust=np.asarray(dynamics.thrust)[..., None] * effectiveness[:, None],
        configuration=np.asarray(dynamics.configuration)[..., None],
        center_of_mass=np.asarray(dynamics.center_of_mass)[..., None],
    )


def accelerations_by_motor(
    dynamics: Dynamics, state: Float[np.ndarray, "E z *B"], speed: Float[np.ndarray, "E n *B"]
) -> tuple[Float[np.ndarray, "E 3 n *B"], Float[np.ndarray, "E 3 *B"]]:
    """Return each motor's accelerations along measured states, and the remaining accelerations."""
    motion = motion_of(dynamics, state)
    by_motor, rest = motor_accelerations(np, dynamics, motion, np.moveaxis(speed, 1, 0))
    return np.moveaxis(by_motor, 2, 0), np.moveaxis(rest, 1, 0)


def accelerations_along(
    dynamics: Dynamics, state: Float[np.ndarray, "E z *#B"], speed: Float[np.ndarray, "E n *B"]
) -> Float[np.ndarray, "E 3 *B"]:
    """Return the modelled accelerations along measured states."""
    found = acceleration(np, dynamics, motion_of(dynamics, state), np.moveaxis(speed, 1, 0))
    return np.stack(np.broadcast_arrays(*found), axis=1)


def motion_of(
    dynamics: Dynamics, state: Float[np.ndarray, "E z *B"]
) -> Float[np.ndarray, "k E *B"]:
    """Return yaw and rates, and the position if an effect depends on it."""
    everything = np.moveaxis(np.asarray(state), 1, 0)
    return np.concatenate([everything[2:6], everything[: 2 if dynamics.of_place else 0]])


def body_accelerations(state: Float[np.ndarray, "E z *B"]) -> Float[np.ndarray, "E 3 3 *B"]:
    """Return accelerations of 1 m/s² forward and left, and 1 rad/s² of yaw, in the world."""
    cos, sin = np.cos(state[:, 2]), np.sin(state[:, 2])
    turn = np.zeros((len(cos), 3, 3, *cos.shape[1:]))
    turn[:, 0, 0] = turn[:, 1, 1] = cos
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = -sin, sin, 1.0
    return turn


def other_accelerations(state: Float[np.ndarray, "E z *B"]) -> Float[np.ndarray, "E 3 5 *B"]:
    """Return constant accelerations in the world, and drag of translation and rotation."""
    added = np.zeros((len(state), 3, 5, *state.shape[2:]))
    added[:, [0, 1, 2], [0, 1, 2]] = 1.0
    added[:, :2, 3], added[:, 2, 4] = -state[:, 3:5], -state[:, 5]
    return added


def following(
    dynamics: Dynamics,
    speed: Float[np.ndarray, "n B"],
    commands: Float[np.ndarray, "e n B"],
    durations: Float[np.ndarray, "e B"],
) -> Float[np.ndarray, "E n B"]:
    """Return the speeds of motors that follow commands, from given speeds on."""
    speeds, lag = [np.asarray(speed)], (dynamics.lag, dynamics.idle_lag)
    for command, duration in zip(commands, durations, strict=True):
        speeds.append(motor_step(np, speeds[-1], command, duration, *lag))
    return np.array(speeds)


def twice_integrated(
    acceleration: Float[np.ndarray, "E ... B"], duration: Float[np.ndarray, "e #B"]
) -> Float[np.ndarray, "E ... B"]:
    """Integrate twice, backwards from rest at the last sample, linear between samples."""
    return integrated(acceleration, duration)[1]


def integrated(
    acceleration: Float[np.ndarray, "E ... B"], duration: Float[np.ndarray, "e #B"]
) -> tuple[Float[np.ndarray, "E ... B"], Float[np.ndarray, "E ... B"]]:
    """Return velocities and positions that end at rest; accelerations are linear in between."""
    h = duration.reshape(len(duration), *(1,) * (acceleration.ndim - 2), -1)
    here, there = acceleration[:-1], acceleration[1:]
    velocity = _sums_from_the_end(-h / 2 * (here + there))
    position = _sums_from_the_end(-h * velocity - h**2 / 6 * (2 * here + there))
    rest = np.zeros_like(acceleration[:1])
    return np.concatenate([velocity, rest]), np.concatenate([position, rest])


def _sums_from_the_end(steps: Float[np.ndarray, "e ..."]) -> Float[np.ndarray, "e ..."]:
    """Sum over each step and all later ones."""
    return np.cumsum(steps[::-1], axis=0)[::-1]


def normal_equations(
    rows: Float[np.ndarray, "B N m"], aim: Float[np.ndarray, "B N"]
) -> tuple[Float[np.ndarray, "B m m"], Float[np.ndarray, "B m"], Float[np.ndarray, " B"]]:
    """Return XᵀX, Xᵀy and yᵀy of each window; X and y are in units of the noise."""
    across = np.swapaxes(rows, 1, 2)
    return across @ rows, (across @ aim[..., None])[..., 0], (aim**2).sum(axis=1)


def solved(
    information: Float[np.ndarray, "*B m m"],
    score: Float[np.ndarray, "*B m"],
    prior: Float[np.ndarray, "m m"],
) -> tuple[Float[np.ndarray, "*B m"], Float[np.ndarray, "*B m m"]]:
    """Solve normal equations with a prior's precision; return unknowns and their covariance."""
    covariance = np.linalg.inv(information + prior)
    return (covariance @ score[..., None])[..., 0], covariance


def block_regression(
    columns: Float[np.ndarray, "M 3 m"],
    values: Float[np.ndarray, "M 3"],
    period: float,
    block_s: float,
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m m"], int]:
    """Regress three channels together; the covariance is from leaving out one block at a time.

    This jackknife allows for errors that are correlated within a block, and for few blocks. Returns
    coefficients, their covariance, and the number of blocks. Undetermined coefficients get a
    standard error of a hundred units.
    """
    flat = columns.reshape(-1, columns.shape[2])
    normal = flat.T @ flat + 1e-4 * np.eye(flat.shape[1])
    inverse = np.linalg.inv(normal)
    coefficients = inverse @ (flat.T @ values.reshape(-1))
    left = values - columns @ coefficients
    starts = np.arange(0, len(columns), max(1, round(block_s / period)))
    blocks = len(starts)
    scores = np.add.reduceat(np.einsum("kcm,kc->km", columns, left), starts)
    moved = np.array(
        [
            np.linalg.solve(normal - np.tensordot(part, part, ((0, 1), (0, 1))), score)
            for part, score in zip(np.split(columns, starts[1:]), scores, strict=True)
        ]
    )
    spread = moved.T @ moved * (blocks - 1) / blocks
    # At least as large as for independent innovations.
    variance = np.diag(spread)
    grown = np.sqrt(np.maximum(np.diag(inverse) / np.maximum(variance, 1e-300), 1.0))
    return coefficients, spread * np.outer(grown, grown), blocks


class PoseRegression:
    """Poses of W windows minus a model's, and the effects of accelerations on them.

    Arrays over the E samples of the windows have the batch as last axis. `moved` [s] is added to
    the transport delay.
    """

    def __init__(self, model: Model, windows: Windows, moved: float = 0.0) -> None:
        delay, usual = model.transport_delay, model.vehicle.nominal.transport_delay_s
        if not model.delay_learned and not all(t.delay_known for t in windows.trajectories):
            delay = usual
        self.model, self.windows = model, windows
        self._delay, self._parts = delay + moved, _parts(model.dynamics, windows)
        self._fine = windows.refined(self._parts)
        index = self._fine.present + np.arange(self._fine.prediction_length + 1)[:, None]
        #: Measured states along the windows, times and motor speeds.
        self.state = np.moveaxis(self._fine.state[index], 2, 1)
        self.time = self._fine.time[index]
        self.speed = self._speeds(model.dynamics, self._delay)
        #: Which poses were measured.
        self.real: Bool[np.ndarray, "t W"] = self._fine.measured[index[:: self._parts]]
        elapsed = (self.time - self.time[0])[:: self._parts]
        trend = np.stack([np.ones_like(elapsed), elapsed], axis=-1) * self.real[..., None]
        self._basis = np.linalg.qr(trend.swapaxes(0, 1))[0]
        #: Accelerations of the model.
        self.modelled = accelerations_along(model.dynamics, self.state, self.speed)
        driven = twice_integrated(self.modelled, np.diff(self.time, axis=0))
        #: Residuals of the poses, window by window, in units of their root mean square.
        left = self._of_poses((self.state[:, :3] - driven)[:, :, None])[..., 0]
        self._spread = np.maximum(np.sqrt(np.mean(left**2, axis=0)), 1e-12)
        self.values = left / self._spread

    def columns(self, *accelerations: Float[np.ndarray, "E 3 _ W"]) -> Float[np.ndarray, "M 3 m"]:
        """Return the effects of accelerations on the poses."""
        # One error after the other: together they take several times the memory.
        each = (one for some in accelerations for one in np.moveaxis(some, 2, 0)[..., None, :])
        steps = np.diff(self.time, axis=0)
        found = np.concatenate([self._of_poses(twice_integrated(one, steps)) for one in each], 2)
        found /= self._spread[:, None]
        return found

    def timing(self) -> Float[np.ndarray, "E 3 2 W"]:
        """Return the accelerations that later commands add, and slower motors, per second."""
        dynamics = self.model.dynamics
        slow = replace(dynamics, motor_time_constant=dynamics.motor_time_constant + _STEP_S)
        both = [
            accelerations_along(one, self.state, self._speeds(one, delay))
            for one, delay in ((dynamics, self._delay + _STEP_S), (slow, self._delay))
        ]
        return (np.stack(both, axis=2) - self.modelled[:, :, None]) / _STEP_S

    def solve(
        self, columns: Float[np.ndarray, "M 3 m"], units: Float[np.ndarray, " m"], block: float
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m m"], Float[np.ndarray, "M 3"]]:
        """Estimate all errors together; return them, their covariance, and what they leave.

        Each error has a unit, which sets the scale of a weak prior. The covariance is from blocks
        of time of `block` [s].
        """
        period = self.windows.trajectories[0].sample_period
        found, covariance, _ = block_regression(columns * units, self.values, period, block)
        told = _TOLD * 3 * len(self.windows)
        covariance *= told / max(told - len(units), 1) * np.outer(units, units)
        return found * units, covariance, self.values - columns @ (found * units)

    def _of_poses(self, poses: Float[np.ndarray, "E 3 m W"]) -> Float[np.ndarray, "M 3 m"]:
        """Remove constants and linear trends from the measured poses of each window."""
        windows = np.moveaxis(poses[:: self._parts] * self.real[:, None, None], 3, 0)
        flat = windows.reshape(*windows.shape[:2], -1)
        left = flat - self._basis @ (self._basis.swapaxes(1, 2) @ flat)
        return left.reshape(-1, *windows.shape[2:])

    def _speeds(self, dynamics: Dynamics, delay: float) -> Float[np.ndarray, "E n W"]:
        """Return the motor speeds from the present of each window on."""
        held = self._fine.delayed(delay, self.model.vehicle.nominal.transport_delay_s)
        past, (commands, durations, _) = held.past(), held.future()
        before = past.command[:-1] if self.model.indexing == "start" else past.command[1:]
        commands = np.concatenate([before, commands])
        durations = np.concatenate([past.duration, durations])
        return following(dynamics, past.command[0], commands, durations)[len(before) :]


def judging_windows(trajectory: Trajectory, model: Model) -> tuple[Windows, float] | None:
    """Return windows over a recording, and the length of a block [s]; None if it is too short."""
    remembered = forgetting_time(model.vehicle)
    before = trajectory.steps(max(_PAST_S, remembered), least=2)
    # On a slow craft, thrust takes longer to emerge from the noise; slow motors take time to build
    # it up.
    lasting = max(_AHEAD_S, showing_time([trajectory], model.vehicle), remembered)
    ahead = trajectory.steps(lasting)
    count = len(trajectory.window_starts(before + ahead, ahead))
    block = max(_BLOCK_S, 2 * lasting)
    if count * lasting < _FEWEST_BLOCKS * block:
        return None
    return make_windows(trajectory, before, ahead, stride=ahead), block


def shortest_judged(vehicle: Vehicle, noise: float) -> float:
    """Return the length of a flight that can be judged, at this noise of the positions [m, s]."""
    remembered = forgetting_time(vehicle)
    lasting = max(_AHEAD_S, clear_time(noise, vehicle), remembered)
    # The first and the last window may be incomplete.
    return remembered + _FEWEST_BLOCKS * max(_BLOCK_S, 2 * lasting) + 2 * lasting


def _parts(dynamics: Dynamics, windows: Windows) -> int:
    """Return the number of steps from one pose to the next that resolve the shortest lag.

    If a valve's force settles within one step, its lag barely changes the sampled forces, and the
    regression reports many times the true error.
    """
    coarse = max(map(integration_parts, windows.trajectories))
    lags = np.atleast_1d(np.asarray(dynamics.lag, dtype=float))
    if not (lags > 0).any():
        return coarse
    period = max(trajectory.sample_period for trajectory in windows.trajectories)
    needed = math.ceil(_STEPS_PER_LAG * period / lags[lags > 0].min())
    return max(coarse, min(needed, _MOST_PARTS))
