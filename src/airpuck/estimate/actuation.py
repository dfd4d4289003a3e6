"""An encoder that estimates what the motors actually do.

Over a window's past, the accelerations are linear in the effectiveness of each motor: the fraction
of its modelled thrust that it delivers. Finding the effectiveness that explains the measured poses
is a linear regression with a prior, solved in closed form for all windows at once. A few priors
compete by their evidence: a healthy craft, a common loss (radio, battery, motors not armed) and
single failing motors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from airpuck.data.windows import Past
from airpuck.deviation.motor_regression import (
    accelerations_by_motor,
    following,
    normal_equations,
    solved,
    twice_integrated,
    with_effectiveness,
)
from airpuck.physics.motor import lag_decay
from airpuck.physics.rigid_body import Dynamics
from airpuck.physics.thrust import thrust_slope


@dataclass(frozen=True)
class EffectivenessPrior:
    """A prior of the motors: normal deviations from full effectiveness."""

    #: Probability of this state of the craft.
    weight: float
    #: Standard deviations: common to all motors, and individual for each motor.
    common: float
    single: float
    #: Name of the state.
    name: str = ""

    def covariance(self, n: int) -> Float[np.ndarray, "n n"]:
        """Return the prior covariance."""
        return self.common**2 * np.ones((n, n)) + self.single**2 * np.eye(n)


#: Healthy, all motors weak, single motors failing. The widths of the first are fitted by maximum
#: likelihood to the paper's training experiment; the others are wide enough for a stopped motor.
PRIORS = (
    EffectivenessPrior(0.9, 0.07, 0.05, "healthy"),
    EffectivenessPrior(0.05, 0.5, 0.05, "common loss"),
    EffectivenessPrior(0.05, 0.05, 0.5, "single motors"),
)

#: Prior of what is learned in flight: the battery, mass and each motor may differ from the model.
LEARNED = EffectivenessPrior(0.9, 0.2, 0.1, "learned")

#: Uncertainty of the motor speeds relative to the first command of a window, as a standard
#: deviation: 0.4 if that command had just changed between arbitrary values, which happened in one
#: window of four.
_FIRST_SPEED = 0.2


@dataclass(frozen=True, eq=False)
class Actuation:
    """Estimates for a batch of windows, at the present of each."""

    #: x, y, γ, vx, vy, ω and motor speeds at the present.
    state: Float[np.ndarray, "z B"]
    #: Fraction of the modelled thrust that each motor delivers; 1: all of it.
    effectiveness: Float[np.ndarray, "n B"]
    #: Standard deviation of the effectiveness.
    deviation: Float[np.ndarray, "n B"]
    #: Probability of each prior.
    probability: Float[np.ndarray, "H B"]


@dataclass(frozen=True)
class ActuationEncoder:
    """Estimates state and effectiveness of each motor from poses and commands.

    Attributes
    ----------
    velocity : {"smoothed", "causal"}
        Whether to use the smoothed velocity of the present as a measurement, as the paper's encoder
        does; it looks a few samples ahead. Otherwise only poses up to the present are used.
    pose_noise : (float, float)
        Standard deviation of measured positions [m] and yaw [rad].
    velocity_noise : (float, float)
        Standard deviation of smoothed velocities [m/s] and angular velocities [rad/s].
    disturbance : (float, float)
        Density of the white accelerations that the model does not explain [m/s²/√Hz, rad/s²/√Hz];
        found by maximum likelihood on the paper's training experiment.
    priors : tuple of EffectivenessPrior
        Competing states of the craft.
    tail : float
        Degrees of freedom of the Student distribution of the residuals.
    tempering : float
        Exponent of the likelihood by which priors compete, below one because the noise is not white
        (a power posterior: Grünwald and van Ommen, Bayesian Analysis 12, 2017).
    """

    velocity: Literal["smoothed", "causal"] = "smoothed"
    pose_noise: tuple[float, float] = (5e-5, 6e-4)
    velocity_noise: tuple[float, float] = (2e-3, 2e-2)
    disturbance: tuple[float, float] = (0.086, 2.1)
    priors: tuple[EffectivenessPrior, ...] = PRIORS
    tail: float = 8.0
    tempering: float = 0.3
    #: The encoder's name on the command line.
    name = "actuation"

    @property
    def causal(self) -> bool:
        """Whether it uses only measurements up to the present."""
        return self.velocity == "causal"

    def begin(self, dynamics: Dynamics, past: Past) -> tuple[Any, Dynamics]:
        """Estimate the state and the dynamics for the prediction; see `Encoder.begin`."""
        found = self.estimate(dynamics, past)
        return found.state, with_effectiveness(dynamics, found.effectiveness)

    def estimate(self, dynamics: Dynamics, past: Past) -> Actuation:
        """Estimate state and effectiveness from the past.

        Parameters
        ----------
        dynamics : Dynamics
            The model.
        past : Past
            E samples of B windows.

        Returns
        -------
        Actuation
            State and effectiveness at the present.

        Notes
        -----
        With p, v at the present and e the deviations from full effectiveness, the pose at t_k is

            p_k = p + v (t_k - t) + ∬ a + Σ_i e_i ∬ a_i + noise,

        where a are the modelled accelerations along the measured yaw and a_i the contribution of
        motor i, both integrated backwards from the present. The noise is the poses' noise plus
        white accelerations integrated twice. p and v have no prior.
        """
        speed = following(dynamics, past.command[0], past.command[:-1], past.duration)
        by_motor, rest = accelerations_by_motor(dynamics, _motion(past, self.causal), speed)
        basis = twice_integrated(by_motor, past.duration)
        present = np.asarray(past.state)[-1]
        modelled = twice_integrated(rest, past.duration) + basis.sum(axis=2)
        residual = past.state[:, :3] - present[:3] - modelled
        rows, aim = self._weighted(dynamics, past, basis, residual)
        if not self.causal:
            linear, angular = self.velocity_noise
            precise = np.array([linear, linear, angular])[:, None] ** -1.0
            velocity = precise * np.eye(rows.shape[2])[3:6]
            velocity = np.broadcast_to(velocity, (len(rows), *velocity.shape))
            rows = np.concatenate([rows, velocity], axis=1)
            aim = np.concatenate([aim, (precise * present[3:]).T], axis=1)
        solution, covariance, probability = self._compete(rows, aim)
        state = np.concatenate([present[:3] + solution[:, :3].T, solution[:, 3:6].T, speed[-1]])
        spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))[:, 6:].T
        return Actuation(state, 1 + solution[:, 6:].T, spread, probability)

    def _weighted(
        self,
        dynamics: Dynamics,
        past: Past,
        basis: Float[np.ndarray, "E 3 n B"],
        residual: Float[np.ndarray, "E 3 B"],
    ) -> tuple[Float[np.ndarray, "B N m"], Float[np.ndarray, "B N"]]:
        """Return the regression on p, v (x, y, γ each) and e, in units of the noise."""
        length, _, n, batch = basis.shape
        elapsed = np.cumsum(np.insert(past.duration, 0, 0.0, axis=0), axis=0)
        step, lag = float(np.median(past.duration)), float(dynamics.motor_time_constant)
        noises = zip(self.pose_noise, self.disturbance, _unknown_start(dynamics), strict=True)
        covariances = (residual_covariance(length, step, noise, lag) for noise in noises)
        linear, angular = (_whitening(found, past.measured) for found in covariances)
        rows = []
        for c, whitening in enumerate((linear, linear, angular)):
            matrix = np.zeros((batch, length, 6 + n))
            matrix[..., c] = 1.0
            matrix[..., 3 + c] = (elapsed - elapsed[-1]).T
            matrix[..., 6:] = np.moveaxis(basis[:, c], -1, 0)
            rows.append(whitening @ np.append(matrix, residual[:, c].T[..., None], axis=2))
        joined = np.concatenate(rows, axis=1)
        return joined[..., :-1], joined[..., -1]

    def _compete(
        self, rows: Float[np.ndarray, "B N m"], aim: Float[np.ndarray, "B N"]
    ) -> tuple[Float[np.ndarray, "B m"], Float[np.ndarray, "B m m"], Float[np.ndarray, "H B"]]:
        """Solve the regression with each prior; return the mean, weighted by evidence."""
        information, score, square = normal_equations(rows, aim)
        measured = rows.any(axis=2).sum(axis=1) - 6  # rows of lost frames are zero
        solutions, covariances, evidence = [], [], []
        for prior in self.priors:
            before = prior.covariance(rows.shape[2] - 6)
            precision = np.pad(np.linalg.inv(before), (6, 0))
            solution, covariance = solved(information, score, precision)
            misfit = square - (score * solution).sum(axis=1)
            likelihood = -(self.tail + measured) / 2 * np.log1p(misfit / self.tail)
            volume = np.linalg.slogdet(before)[1] - np.linalg.slogdet(covariance)[1]
            solutions.append(solution)
            covariances.append(covariance)
            evidence.append(np.log(prior.weight) + self.tempering * (likelihood - volume / 2))
        weight = np.exp(np.array(evidence) - np.max(evidence, axis=0))
        weight /= weight.sum(axis=0)
        mean = np.einsum("hb,hbm->bm", weight, np.array(solutions))
        apart = np.array(solutions) - mean
        spread = np.array(covariances) + apart[..., :, None] * apart[..., None, :]
        return mean, np.einsum("hb,hbmk->bmk", weight, spread), weight


def _motion(past: Past, causal: bool) -> Float[np.ndarray, "E 6 B"]:
    """Return the past states; without look-ahead, velocities are differences of poses."""
    state = np.asarray(past.state)
    if not causal:
        return state
    rates = np.diff(state[:, :3], axis=0) / np.asarray(past.duration)[:, None]
    return np.concatenate([state[:, :3], np.concatenate([rates, rates[-1:]])], axis=1)


def _unknown_start(dynamics: Dynamics) -> tuple[float, float]:
    """Return the error of accelerations due to unknown initial speeds [m/s², rad/s²]."""
    slope = thrust_slope(np.asarray(dynamics.thrust), np.full(len(dynamics.thrust), 0.5))
    spread = np.sqrt(((np.asarray(dynamics.configuration) * slope) ** 2).sum(axis=1))
    return float(_FIRST_SPEED * spread[:2].mean()), float(_FIRST_SPEED * spread[2])


@lru_cache(maxsize=32)
def residual_covariance(
    length: int, step: float, noise: tuple[float, float, float], time_constant: float
) -> Float[np.ndarray, "E E"]:
    """Return the covariance of the residuals of an axis.

    `noise` contains the poses' noise, the density of the accelerations, and the initial uncertainty
    of the accelerations.
    """
    pose, density, first = noise
    integral = twice_integrated(np.eye(length), np.full((length - 1, 1), step))
    fading = lag_decay(np, np.arange(length) * step, time_constant)
    # An error of the initial speeds decays with the motors' lag.
    accelerations = density**2 / step * np.eye(length) + first**2 * np.outer(fading, fading)
    return pose**2 * np.eye(length) + integral @ accelerations @ integral.T


def _whitening(
    covariance: Float[np.ndarray, "E E"], measured: Bool[np.ndarray, "E B"] | None
) -> Float[np.ndarray, "*B E E"]:
    """Return the matrix that makes measured residuals white and others zero, for each window."""
    if measured is None or measured.all():
        return np.linalg.inv(np.linalg.cholesky(covariance))
    seen = measured.T
    alone = np.where(seen[:, :, None] & seen[:, None], covariance, np.eye(len(covariance)))
    return np.linalg.inv(np.linalg.cholesky(alone)) * seen[:, :, None]
