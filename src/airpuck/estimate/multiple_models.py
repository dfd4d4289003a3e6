"""The equations of the multiple-model filters: pure functions over an array namespace.

The unknowns are x = (p, v, d, e). p, v and d are position, velocity and disturbance of the axes x,
y, γ. e is the deviation from the model: each motor's effectiveness minus one, and the delay beyond
the model's. Along the yaw, which the cameras measure well, everything is linear:

    p' = v,   v' = a + d + Σᵢ eᵢ aᵢ + w₁,   d' = w₂,

where a are the modelled accelerations, aᵢ the contribution of motor i, and for the delay -da/dt.
A craft that learns has more in e: drag, for which aᵢ is -v; the offset of the centre of mass, which
changes the moments of all thrusts; and the slope of the table. The slope is the mean of d, so d
contains its acceleration.
Every packet has its own delay, too, modelled as white noise along da/dt. Without it one large
change of the commands would determine the delay, which only many packets can.
Several states of the craft with different priors of e compete, each with its own Kalman filter: an
interacting multiple-model estimator (Blom and Bar-Shalom, IEEE Transactions on Automatic Control
33, 1988). A craft that learns also learns the density of w₁ from the innovations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.compute.arrays import small_product
from airpuck.craft.vehicle import GRAVITY
from airpuck.estimate.axis_filter import INITIAL_VELOCITY, Noise, process_noise, propagate, to_world
from airpuck.physics.motor import lag_at, motor_step
from airpuck.physics.rigid_body import Dynamics, motor_accelerations, pose_difference

#: An innovation beyond this many standard deviations in every state means contact with a rail or a
#: hand; a motor would need ten frames for it. The velocities become unknown, and no motor is
#: blamed.
_KNOCK = 8.0
#: Standard deviations from which on a learned change is used.
_CERTAIN = 2.5
#: Drag is learned only above this speed [m/s]: of a craft at rest only the noise of the velocity is
#: seen, which looks like drag.
_MOVES = 0.02
#: Density of disturbances around the slope's acceleration, below 0.5 Hz [m/s²/√Hz], from replays of
#: five real flights (studies/learning.md); and the largest that counts [m/s²].
_WANDERS, _PUSH = 0.1, 0.3
#: Time for which the error of an estimated disturbance lasts [s].
_ERROR_LASTS = 1.0
#: Indices of p, v, d and e.
POSITION, VELOCITY, DISTURBANCE = slice(0, 3), slice(3, 6), slice(6, 9)
ACTUATION = slice(9, None)

#: Time over which the density of unexplained accelerations is learned [s], bounds of the logarithm
#: of its square relative to the noise's, and the largest squared innovation that counts.
_DENSITY_S, _DENSITY, _INNOVATION = 2.0, (math.log(0.01), math.log(25.0)), 9.0

#: Means (H, k), covariances (H, k, k) and weights (H,) of H states of the craft, and the learned
#: logarithm of the squared density, relative to the noise's, of each axis (3,); never written to.
Belief = tuple[Any, Any, Any, Any]


@dataclass(frozen=True)
class Memory:
    """What a craft that learns keeps."""

    #: Time over which what was learned about the first state's e becomes uncertain again [s].
    lasting: float
    #: I/m, the squared radius of gyration [m²].
    squared_gyration: float
    #: Standard deviation of a packet's own delay [s].
    jitter: float


@dataclass(frozen=True, eq=False)
class States:
    """Competing states of the craft, and the transitions between them.

    A state lasts for some time. Then another state, or the same one, is drawn according to the
    weights, and e is drawn again from its prior.
    """

    #: Names of the states.
    names: tuple[str, ...]
    #: Probability of each state.
    weight: Float[np.ndarray, " H"]
    #: Covariances of e, around zero.
    covariance: Float[np.ndarray, "H m m"]
    #: Mean duration of a state [s].
    lasting: float
    #: Degrees of freedom of Student's distribution of the innovations.
    tail: float
    #: Exponent of the likelihood by which states compete.
    tempering: float
    #: None: nothing is learned, and e is drawn around zero.
    memory: Memory | None = None


@dataclass(frozen=True, eq=False)
class MultipleModels:
    """Equations of a craft's beliefs over time and measurements."""

    dynamics: Dynamics
    noise: Noise
    states: States

    def begin(self, pose: Float[np.ndarray, " 3"], before: Belief | None, elapsed: float) -> Belief:
        """Return the belief at a pose, at rest, some time after another belief."""
        states = self.states
        if before is None:
            covariances = _padded(states.covariance)
            # What is learned about the body is known in all states alike.
            lasting = slice(10 + self.dynamics.configuration.shape[1], None)
            covariances[1:, lasting, lasting] = covariances[0, lasting, lasting]
            means, weights = np.zeros(covariances.shape[:2]), states.weight
            density = np.zeros(3)
        else:
            # Knowledge of the motors is kept unless it is too old.
            means, covariances, weights, density = self.renewed(np, before, elapsed)
        means[:, :9], covariances[:, :9, :], covariances[:, :, :9] = 0.0, 0.0, 0.0
        means[:, POSITION] = pose
        covariances[:, range(9), range(9)] = self.noise.initial_variance.T.ravel()
        return means, covariances, weights, density

    def renewed(self, xp: Any, belief: Belief, duration: Any) -> Belief:
        """Advance over a time in which the state of the craft may have been redrawn."""
        means, covariances, weights, density = belief
        states = self.states
        same = xp.exp(-duration / states.lasting)
        mean, covariance = mixed(xp, belief)
        # After a redraw nothing is known about the actuation, but what was learned.
        known = np.concatenate([np.ones(9), np.zeros(means.shape[1] - 9)])
        learned, drawn, growth = self._learned(xp, belief, mean, covariance, duration)
        base = mean * known + learned
        fresh = covariance * known[:, None] * known + drawn
        away = means - base
        after = same * weights + (1 - same) * states.weight
        keeps = (same * weights / xp.maximum(after, 1e-300))[:, None, None]
        between = keeps * (1 - keeps) * away[:, :, None] * away[:, None, :]
        means = base + keeps[:, :, 0] * away
        covariances = keeps * covariances + (1 - keeps) * fresh + between + growth
        return means, covariances, after, density

    def _learned(
        self, xp: Any, belief: Belief, mean: Any, covariance: Any, duration: Any
    ) -> tuple[Any, Any, Any]:
        """Return means and covariances of e when a state is drawn, and how they grow until then.

        Other states than the first are drawn around what it has learned; it takes over what
        they have found. Its covariance grows towards the prior's.
        """
        states, prior = self.states, _padded(self.states.covariance)
        if states.memory is None:
            return 0.0, prior, 0.0
        e = np.concatenate([np.zeros(9), np.ones(len(mean) - 9)])
        block, first = e[:, None] * e, (np.arange(len(prior)) == 0)[:, None]
        means, covariances, *_ = belief
        base = xp.where(first, mean, means[0]) * e
        own, is_first = covariances[0] * block, first[:, :, None]
        drawn = xp.where(is_first, covariance * block, own + prior)
        growth = -xp.expm1(-duration / states.memory.lasting) * (prior[0] - own)
        return base, drawn, xp.where(is_first, growth, 0.0)

    def advance(self, xp: Any, *given: Any) -> Any:
        """Advance belief and motor speeds through intervals with one command each.

        After the belief come motor speeds (n,), durations (S,) and commands (S, n).
        """
        *belief, speed, durations, commands = given
        total = xp.sum(durations)
        means, covariances, weights, density = self.renewed(xp, tuple(belief), total)
        path = xp.sum(weights[:, None] * means, axis=0)
        memory = self.states.memory
        gyration = memory and memory.squared_gyration
        given = xp, self.dynamics, path, speed, durations, commands, gyration
        transition, offset, speed, slopes = drift(*given)
        half = small_product(xp, transition, covariances)
        moved = small_product(xp, transition, xp.swapaxes(half, 1, 2))
        unexplained = np.square(self.noise.acceleration) * xp.exp(density)
        densities = unexplained, np.square(self.noise.disturbance)
        added = process_noise(xp, total, *densities)
        # From a matrix for each axis to a single one: the axis is the inner index.
        by_axis = xp.eye(3)[None, :, None, :] * xp.moveaxis(added, 0, 1)[:, :, :, None]
        # A packet that is late by δ changes the velocity by δ times the step of acceleration. White
        # noise along da/dt of this squared density gives the same variance over one lag, and more
        # for smooth commands, whose packets add up.
        jitter = memory.jitter if memory else 0.0
        late = 2 * self.dynamics.motor_time_constant * jitter**2
        by_axis = xp.reshape(by_axis, (9, 9)) + xp.pad(late * slopes, (3, 3))
        covariances = moved + xp.pad(by_axis, (0, means.shape[1] - 9))
        means = xp.sum(transition * means[:, None, :], axis=2) + offset
        belief = means, covariances, weights, density
        if memory:
            belief = with_slope(xp, belief, total)
        return *belief, speed

    def use_pose(self, xp: Any, *given: Any) -> Any:
        """Advance, then use a pose, the last argument; the last result is the innovation."""
        *moving, pose = given
        *belief, speed = self.advance(xp, *moving)
        means, covariances, weights, density = belief
        expected = xp.sum(weights[:, None] * means, axis=0)[POSITION]
        innovation = pose_difference(xp, pose, expected)
        rows, variances = np.eye(means.shape[1])[POSITION], np.square(self.noise.pose)
        if self.states.memory is not None:
            spread = xp.diagonal(covariances, axis1=1, axis2=2)[:, POSITION] + variances
            square = innovation**2 * xp.sum(weights[:, None] / spread, axis=0)
            belief[3] = learned_density(xp, density, square, xp.sum(moving[-2]))
        belief = self.measure(xp, tuple(belief), rows, innovation, variances)
        return *belief, speed, innovation

    def use_imu(
        self,
        belief: Belief,
        motors: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
        acceleration_body: Float[np.ndarray, " 2"],
        gyro: float,
        noise: tuple[float, float],
    ) -> Belief:
        """Use an inertial measurement at given motor speeds and commands."""
        mean, _ = mixed(np, belief)
        motion = mean[2], *mean[VELOCITY]
        gyration = self.states.memory and self.states.memory.squared_gyration
        modelled, by_e = sensitivity(np, self.dynamics, motion, *motors, gyration=gyration)
        rows = np.zeros((3, len(mean)))
        rows[:, DISTURBANCE] = np.diag([1.0, 1.0, 0.0])
        rows[:2, ACTUATION] = by_e[:2]
        rows[2, 5] = 1.0
        measured = np.array([*to_world(acceleration_body, mean[2]), gyro])
        innovation = measured - np.array([*modelled[:2], 0.0]) - rows @ mean
        variance = np.square([noise[0], noise[0], noise[1]])
        return self.measure(np, belief, rows, innovation, variance)

    def use_mouse(self, belief: Belief, velocity: Float[np.ndarray, " 2"], noise: float) -> Belief:
        """Use a measured velocity along the body's axes."""
        mean, _ = mixed(np, belief)
        rows = np.eye(len(mean))[3:5]
        innovation = np.array(to_world(velocity, mean[2])) - mean[3:5]
        return self.measure(np, belief, rows, innovation, np.full(2, noise**2))

    def measure(self, xp: Any, belief: Belief, rows: Any, innovations: Any, variances: Any) -> Any:
        """Use measurements y = Hx + noise, one component after the other."""
        means, covariances, weights, density = belief
        states, size = self.states, means.shape[1]
        reference = xp.sum(weights[:, None] * means, axis=0)
        unknown = np.zeros(size)
        unknown[VELOCITY] = INITIAL_VELOCITY**2
        deviations = innovations - xp.sum((means - reference)[:, None] * rows, axis=2)
        plain = xp.sum(small_product(xp, rows, covariances) * rows, axis=2) + variances
        knocked = xp.min(xp.max(deviations**2 / plain, axis=1)) > _KNOCK**2
        covariances = covariances + xp.where(knocked, 1.0, 0.0) * np.diag(unknown)
        evidence = xp.log(weights)
        for k in range(len(rows)):
            row = rows[k]
            column = xp.sum(covariances * row, axis=2)
            expected = xp.sum(column * row, axis=1) + variances[k]
            innovation = innovations[k] - xp.sum((means - reference) * row, axis=1)
            gain = column / expected[:, None]
            means = means + gain * innovation[:, None]
            covariances = covariances - gain[:, :, None] * column[:, None, :]
            surprise = xp.log1p(innovation**2 / expected / states.tail)
            likelihood = -(states.tail + 1) / 2 * surprise - xp.log(expected) / 2
            evidence = evidence + states.tempering * likelihood
        weights = xp.exp(evidence - xp.max(evidence))
        return means, covariances, weights / xp.sum(weights), density

    def predict(self, xp: Any, means: Any, covariances: Any, weights: Any, *given: Any) -> Any:
        """Return state, motor speeds, disturbance and effectiveness after time intervals.

        Also returns e with its standard deviations, and the weights.
        """
        mean = xp.sum(weights[:, None] * means, axis=0)
        variances = xp.diagonal(covariances, axis1=1, axis2=2) + (means - mean) ** 2
        deviation = xp.sqrt(xp.sum(weights[:, None] * variances, axis=0)[ACTUATION])
        e = mean[ACTUATION]
        n = self.dynamics.configuration.shape[1]
        if self.states.memory is not None:
            # What is not certain is not used: then the craft is as if nothing had been learned.
            means = conditioned(xp, means, covariances, certain_changes(xp, means, covariances, n))
            mean = xp.sum(weights[:, None] * means, axis=0)
        # The delay is left out: each command in transit has its own.
        effectiveness = 1 + mean[ACTUATION][:n]
        effective = replace(self.dynamics, thrust=self.dynamics.thrust * effectiveness[:, None])
        axes, speed = propagate(xp, effective, xp.reshape(mean[:9], (3, 3)).T, *given[1:])
        state = xp.ravel(axes[:, :2].T)
        return state, speed, axes[:, 2], effectiveness, e, deviation, weights


def learned_density(xp: Any, density: Any, square: Any, duration: Any) -> Any:
    """Move the density until squared innovations are as large as expected, on average.

    An adaptive filter (Mehra, IEEE Transactions on Automatic Control 17, 1972) by small steps; x
    and y share a density.
    """
    square = xp.minimum(square, _INNOVATION)
    linear = (square[0] + square[1]) / 2
    surplus = xp.stack([linear, linear, square[2]]) - 1
    return xp.clip(density + duration / _DENSITY_S * surplus, *_DENSITY)


def with_slope(xp: Any, belief: Belief, duration: Any) -> Belief:
    """Use the disturbance that was found as a measurement of the slope, over a duration.

    The filter's own disturbance is a random walk, which has no mean. With one, a weak motor that is
    not certain yet would be rejected less.
    """
    means, covariances, weights, density = belief
    mean, covariance = mixed(xp, belief)
    d, unknown = mean[6:8], xp.diagonal(covariance)[6:8]
    # While a weak motor may be a disturbance, neither is known.
    density_of_d = (_WANDERS**2 + 2 * _ERROR_LASTS * unknown) / GRAVITY**2
    surplus = xp.clip(d / GRAVITY - means[:, -2:], -_PUSH / GRAVITY, _PUSH / GRAVITY)
    variance = xp.diagonal(covariances, axis1=1, axis2=2)[:, -2:]
    gain = variance / (variance + density_of_d / xp.maximum(duration, 1e-6))
    size = means.shape[1]
    means = means + xp.pad(gain * surplus, ((0, 0), (size - 2, 0)))
    # Beside the filter, the slope does not depend on the other unknowns.
    used = xp.pad(gain[:, :, None] * np.eye(2), ((0, 0), (size - 2, 0), (size - 2, 0)))
    return means, covariances * (1 - used), weights, density


def certain(xp: Any, value: Any, variance: Any) -> Any:
    """Shrink an estimate to zero if it may be zero; leave it nearly alone if it cannot."""
    square = value * value
    return value * xp.maximum(1 - (_CERTAIN**2 * variance / xp.maximum(square, 1e-30)) ** 2, 0.0)


def certain_changes(xp: Any, means: Any, covariances: Any, n: int) -> Any:
    """Return the e to use in each state, without the slope, which is part of d.

    That is the certain part of the common change of n motors, and of each motor's own. The delay is
    used elsewhere; drag and the offset of the centre of mass are not.
    """
    e, block = means[:, 9 : 9 + n], covariances[:, 9 : 9 + n, 9 : 9 + n]
    rows = xp.mean(block, axis=2)
    common, spread = xp.mean(e, axis=1)[:, None], xp.mean(rows, axis=1)[:, None]
    own = xp.diagonal(block, axis1=1, axis2=2) - 2 * rows + spread
    changes = certain(xp, common, spread) + certain(xp, e - common, own)
    return xp.concatenate([changes, xp.zeros((len(means), 4))], axis=1)


def conditioned(xp: Any, means: Any, covariances: Any, values: Any) -> Any:
    """Return the means if the first of e have certain values."""
    columns = covariances[:, :, 9 : 9 + values.shape[1]]
    for k in range(values.shape[1]):
        gain = columns[:, :, k] / xp.maximum(columns[:, 9 + k, k], 1e-30)[:, None]
        means = means + gain * (values[:, k] - means[:, 9 + k])[:, None]
        columns = columns - gain[:, :, None] * columns[:, 9 + k, None, :]
    return means


def drift(
    xp: Any,
    dynamics: Dynamics,
    mean: Any,
    speed: Any,
    durations: Any,
    commands: Any,
    gyration: float | None = None,
) -> tuple[Any, Any, Any, Any]:
    """Integrate the accelerations over intervals with one command each.

    Each interval uses the values at its middle, so that the error is of second order. Returns the
    matrix and the offset that advance any x, the motor speeds, and the integral of da/dt (da/dt)ᵀ.
    If the craft learns, with this squared radius of gyration, the delay acts on the thrusts found
    in flight, otherwise on the modelled ones.
    """
    tau, idle = dynamics.lag, dynamics.idle_lag
    p, v, d, e = mean[POSITION], mean[VELOCITY], mean[DISTURBANCE], mean[ACTUATION]
    size, n = len(e), dynamics.configuration.shape[1]
    # Effects of e on v and p, and contributions of a itself.
    v_by_e, p_by_e = xp.zeros((3, size)), xp.zeros((3, size))
    v_by_a, p_by_a = xp.zeros(3), xp.zeros(3)
    total, slopes = 0.0, xp.zeros((3, 3))
    for k in range(len(durations)):
        h, command = durations[k], commands[k]
        middle = motor_step(xp, speed, command, h / 2, tau, idle)
        motion = p[2] + h / 2 * v[2], v[0], v[1], v[2]
        delayed = 1.0 if gyration is None else 1 + e[:n]
        a, by_e = sensitivity(xp, dynamics, motion, middle, command, delayed, gyration)
        rate = a + d + small_product(xp, by_e, e)
        p_by_e, v_by_e = p_by_e + h * v_by_e + h * h / 2 * by_e, v_by_e + h * by_e
        p_by_a, v_by_a = p_by_a + h * v_by_a + h * h / 2 * a, v_by_a + h * a
        p, v = p + h * v + h * h / 2 * rate, v + h * rate
        speed = motor_step(xp, speed, command, h, tau, idle)
        slopes = slopes + h * by_e[:, None, n] * by_e[None, :, n]
        total = total + h
    eye, none = xp.eye(3), xp.zeros((3, 3))
    transition = xp.concatenate(
        [
            xp.concatenate([eye, total * eye, total * total / 2 * eye, p_by_e], axis=1),
            xp.concatenate([none, eye, total * eye, v_by_e], axis=1),
            xp.eye(9 + size)[6:],
        ]
    )
    return transition, xp.concatenate([p_by_a, v_by_a, xp.zeros(3 + size)]), speed, slopes


def sensitivity(
    xp: Any,
    dynamics: Dynamics,
    motion: Any,
    speed: Any,
    command: Any,
    delayed: Any = 1.0,
    gyration: float | None = None,
) -> tuple[Any, Any]:
    """Return the modelled accelerations and their derivatives with respect to e.

    The delay acts on these fractions of the motors' thrusts. A squared radius of gyration belongs
    to a craft that learns.
    """
    by_motor, rest = motor_accelerations(xp, dynamics, motion, speed)
    a = xp.sum(by_motor, axis=1) + rest
    # For a later arrival of the commands: a(t - δ).
    little = 1e-4
    lag = lag_at(xp, speed, dynamics.lag, dynamics.idle_lag)
    slope = (command - speed) / xp.maximum(lag, little)
    earlier = motor_accelerations(xp, dynamics, motion, speed - little * slope)
    by_delay = (xp.sum(delayed * (earlier[0] - by_motor), axis=1) + earlier[1] - rest) / little
    parts = [by_motor, by_delay[:, None]]
    if gyration is not None:
        parts += [by_body(xp, motion, xp.sum(delayed * by_motor, axis=1), gyration)]
    return a, xp.concatenate(parts, axis=1)


def by_body(xp: Any, motion: Any, pushed: Any, gyration: float) -> Any:
    """Return derivatives of the accelerations: by drag, centre of mass (x, y) and slope (none).

    The motors alone cause the accelerations `pushed`. The force turns the craft about another
    centre, and the measured point moves about it (eq. acc_corr).
    """
    yaw, vx, vy, spin = motion
    cos, sin = xp.cos(yaw), xp.sin(yaw)
    fx, fy, turn = pushed
    moves = xp.where(vx**2 + vy**2 > _MOVES**2, 1.0, 0.0)
    columns = [[-moves * vx, -moves * vy, 0.0]]
    for x, y in ((cos, sin), (-sin, cos)):
        columns.append(
            [y * turn + x * spin**2, y * spin**2 - x * turn, (y * fx - x * fy) / gyration]
        )
    return xp.concatenate([xp.array(columns).T, xp.zeros((3, 2))], axis=1)


def mixed(xp: Any, belief: Belief) -> tuple[Any, Any]:
    """Return mean and covariance of the mixture of all states."""
    means, covariances, weights, _ = belief
    mean = xp.sum(weights[:, None] * means, axis=0)
    away = means - mean
    spread = covariances + away[:, :, None] * away[:, None, :]
    return mean, xp.sum(weights[:, None, None] * spread, axis=0)


def _padded(covariance: Float[np.ndarray, "H m m"]) -> Float[np.ndarray, "H k k"]:
    """Place covariances of e at the indices of e."""
    return np.pad(covariance, ((0, 0), (9, 0), (9, 0)))
