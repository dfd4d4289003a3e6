"""The equations of the actuation filter: pure functions over an array namespace.

The unknowns are x = (p, v, d, e): of the axes x, y, γ the position, velocity and disturbance, and
how far the actuation is from the model's: each motor's effectiveness minus one, and last the delay
beyond the model's. Along the yaw, which the cameras measure well, everything is linear:

    p' = v,   v' = a + d + Σᵢ eᵢ aᵢ + w₁,   d' = w₂,

a the modelled accelerations, aᵢ those of motor i, and for the delay -da/dt. Several states of the
craft with different priors of e compete, each with a Kalman filter of its own: an interacting
multiple-model estimator (Blom and Bar-Shalom, IEEE Transactions on Automatic Control 33, 1988).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.estimate.axis_filter import INITIAL_VELOCITY, Noise, process_noise
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics, motor_accelerations

#: What surprises every state by this many standard deviations is a rail or a hand, no motor: those
#: need ten frames for it. The velocities are unknown again, and the motors are not blamed.
_KNOCK = 8.0
#: Where p, v, d and e are.
POSITION, VELOCITY, DISTURBANCE = slice(0, 3), slice(3, 6), slice(6, 9)
ACTUATION = slice(9, None)


@dataclass(frozen=True, eq=False)
class States:
    """States of the craft that compete, and how they follow each other.

    A state lasts for some time; then another one, or the same, is drawn by the weights, and e
    anew from its prior.
    """

    #: How probable each is.
    weight: Float[np.ndarray, " H"]
    #: Of e, around zero.
    covariance: Float[np.ndarray, "H m m"]
    #: How long one lasts in the mean [s].
    lasting: float
    #: Degrees of freedom of Student's distribution of the innovations.
    tail: float
    #: Power of the likelihood by which states compete.
    tempering: float


def drift(
    xp: Any, dynamics: Dynamics, mean: Any, speed: Any, durations: Any, commands: Any
) -> tuple[Any, Any, Any]:
    """Integrate the accelerations over pieces of time with one command each.

    In each piece they are those of its middle.
    """
    tau = dynamics.motor_time_constant
    p, v, d, e = mean[POSITION], mean[VELOCITY], mean[DISTURBANCE], mean[ACTUATION]
    size = len(e)
    # Of v and p by e, and what a itself gives them.
    v_by_e, p_by_e = xp.zeros((3, size)), xp.zeros((3, size))
    v_by_a, p_by_a = xp.zeros(3), xp.zeros(3)
    total = 0.0
    for k in range(len(durations)):
        h, command = durations[k], commands[k]
        middle = motor_step(xp, speed, command, h / 2, tau)
        motion = p[2] + h / 2 * v[2], v[0], v[1], v[2]
        a, by_e = sensitivity(xp, dynamics, motion, middle, command)
        rate = a + d + _times(xp, by_e, e)
        p_by_e, v_by_e = p_by_e + h * v_by_e + h * h / 2 * by_e, v_by_e + h * by_e
        p_by_a, v_by_a = p_by_a + h * v_by_a + h * h / 2 * a, v_by_a + h * a
        p, v = p + h * v + h * h / 2 * rate, v + h * rate
        speed = motor_step(xp, speed, command, h, tau)
        total = total + h
    eye, none = xp.eye(3), xp.zeros((3, 3))
    transition = xp.concatenate(
        [
            xp.concatenate([eye, total * eye, total * total / 2 * eye, p_by_e], axis=1),
            xp.concatenate([none, eye, total * eye, v_by_e], axis=1),
            xp.eye(9 + size)[6:],
        ]
    )
    return transition, xp.concatenate([p_by_a, v_by_a, xp.zeros(3 + size)]), speed


def sensitivity(
    xp: Any, dynamics: Dynamics, motion: Any, speed: Any, command: Any
) -> tuple[Any, Any]:
    """Return the modelled accelerations and their derivatives by e."""
    by_motor, rest = motor_accelerations(xp, dynamics, motion, speed)
    a = xp.sum(by_motor, axis=1) + rest
    # Had the commands come a little later: a(t - δ).
    little = 1e-4
    slope = (command - speed) / xp.maximum(dynamics.motor_time_constant, little)
    earlier = motor_accelerations(xp, dynamics, motion, speed - little * slope)
    by_delay = (xp.sum(earlier[0], axis=1) + earlier[1] - a) / little
    return a, xp.concatenate([by_motor, by_delay[:, None]], axis=1)


def renewed(xp: Any, states: States, belief: tuple[Any, ...], duration: Any) -> tuple[Any, ...]:
    """Let some time pass in which the state of the craft may have been drawn anew."""
    means, covariances, weights = belief
    same = xp.exp(-duration / states.lasting)
    mean, covariance = mixed(xp, belief)
    # Where it was drawn anew, nothing that was known of the actuation holds.
    known = np.concatenate([np.ones(9), np.zeros(means.shape[1] - 9)])
    fresh = covariance * known[:, None] * known + _padded(states.covariance)
    away = means - mean * known
    after = same * weights + (1 - same) * states.weight
    keeps = (same * weights / xp.maximum(after, 1e-300))[:, None, None]
    between = keeps * (1 - keeps) * away[:, :, None] * away[:, None, :]
    means = mean * known + keeps[:, :, 0] * away
    return means, keeps * covariances + (1 - keeps) * fresh + between, after


def mixed(xp: Any, belief: tuple[Any, ...]) -> tuple[Any, Any]:
    """Return mean and covariance of the mixture of all states."""
    means, covariances, weights = belief
    mean = xp.sum(weights[:, None] * means, axis=0)
    away = means - mean
    spread = covariances + away[:, :, None] * away[:, None, :]
    return mean, xp.sum(weights[:, None, None] * spread, axis=0)


def advance(
    xp: Any,
    dynamics: Dynamics,
    states: States,
    noise: Noise,
    belief: tuple[Any, ...],
    speed: Any,
    durations: Any,
    commands: Any,
) -> tuple[tuple[Any, ...], Any]:
    """Move all beliefs through pieces of time with one command each."""
    total = xp.sum(durations)
    means, covariances, weights = renewed(xp, states, belief, total)
    path = xp.sum(weights[:, None] * means, axis=0)
    transition, offset, speed = drift(xp, dynamics, path, speed, durations, commands)
    half = _times(xp, transition, covariances)
    moved = _times(xp, transition, xp.swapaxes(half, 1, 2))
    densities = np.square(noise.acceleration), np.square(noise.disturbance)
    added = process_noise(xp, total, *densities)
    # From a matrix for each axis to one of all: the axis is the inner index.
    by_axis = xp.eye(3)[None, :, None, :] * xp.moveaxis(added, 0, 1)[:, :, :, None]
    by_axis = xp.reshape(by_axis, (9, 9))
    covariances = moved + xp.pad(by_axis, (0, means.shape[1] - 9))
    means = xp.sum(transition * means[:, None, :], axis=2) + offset
    return (means, covariances, weights), speed


def measure(
    xp: Any,
    states: States,
    belief: tuple[Any, ...],
    rows: Any,
    innovations: Any,
    variances: Any,
) -> tuple[Any, ...]:
    """Use measurements y = Hx + noise, one component after the other."""
    means, covariances, weights = belief
    reference = xp.sum(weights[:, None] * means, axis=0)
    unknown = np.zeros(means.shape[1])
    unknown[VELOCITY] = INITIAL_VELOCITY**2
    deviations = innovations - xp.sum((means - reference)[:, None] * rows, axis=2)
    plain = xp.sum(_times(xp, rows, covariances) * rows, axis=2) + variances
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
    return means, covariances, weights / xp.sum(weights)


def _times(xp: Any, matrix: Any, other: Any) -> Any:
    """Multiply a small matrix with a vector or a stack of matrices, without calling a library."""
    if other.ndim == 1:
        return xp.sum(matrix * other, axis=-1)
    return xp.sum(matrix[:, :, None] * other[..., None, :, :], axis=-2)


def _padded(covariance: Float[np.ndarray, "H m m"]) -> Float[np.ndarray, "H k k"]:
    """Put covariances of e where e is."""
    return np.pad(covariance, ((0, 0), (9, 0), (9, 0)))
