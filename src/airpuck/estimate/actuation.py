"""An encoder that asks what the motors really do.

Over a window's past the accelerations are linear in the effectiveness of each motor, the share of
its modelled thrust that it gives. Which effectiveness explains the measured poses is a linear
regression with a prior, solved in closed form for all windows at once; a few priors, of a healthy
craft, of a common loss (radio, battery, motors not armed) and of single motors that fail, compete
by their evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from airpuck.data.windows import Past
from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics, motor_accelerations
from airpuck.physics.thrust import thrust_slope


@dataclass(frozen=True)
class EffectivenessPrior:
    """What is thought of the motors before looking: normal deviations from full effectiveness."""

    #: How probable this state of the craft is.
    weight: float
    #: Standard deviations of what all motors share, and of what each has for itself.
    common: float
    single: float
    #: What it is called.
    name: str = ""

    def covariance(self, n: int) -> Float[np.ndarray, "n n"]:
        """Return the prior covariance."""
        return self.common**2 * np.ones((n, n)) + self.single**2 * np.eye(n)


#: Healthy, all motors at a loss, single motors failing. Widths of the first by maximum likelihood
#: on the paper's training experiment; of the others, wide enough for a motor that stands.
PRIORS = (
    EffectivenessPrior(0.9, 0.07, 0.05, "healthy"),
    EffectivenessPrior(0.05, 0.5, 0.05, "common loss"),
    EffectivenessPrior(0.05, 0.05, 0.5, "single motors"),
)

#: By how much motors may differ from the first command of a window, standard deviation: by 0.4 if
#: that command had just changed from any to any, which it had in one window of four.
_FIRST_SPEED = 0.2


@dataclass(frozen=True, eq=False)
class Actuation:
    """What the past says about a batch of windows."""

    #: x, y, γ, vx, vy, ω and motor speeds at the present.
    state: Float[np.ndarray, "z B"]
    #: Share of the modelled thrust that each motor gives, 1: all.
    effectiveness: Float[np.ndarray, "n B"]
    #: Its standard deviation.
    deviation: Float[np.ndarray, "n B"]
    #: Of each prior.
    probability: Float[np.ndarray, "H B"]


@dataclass(frozen=True)
class ActuationEncoder:
    """Estimates state and effectiveness of each motor from poses and commands.

    Attributes
    ----------
    velocity : {"smoothed", "causal"}
        Whether the smoothed velocity of the present, which looks some samples ahead, is a
        measurement, as in the paper's encoder; or poses up to the present are all there is.
    pose_noise : (float, float)
        Standard deviation of measured positions [m] and yaw [rad].
    velocity_noise : (float, float)
        Standard deviation of smoothed velocities [m/s] and spin [rad/s].
    disturbance : (float, float)
        Density of the white accelerations that the model does not explain [m/s²/√Hz, rad/s²/√Hz];
        found by maximum likelihood on the paper's training experiment.
    priors : tuple of EffectivenessPrior
        States of the craft that compete.
    tail : float
        Degrees of freedom of the Student distribution of the residuals.
    tempering : float
        Power of the likelihood by which priors compete, below one since the noise is not white
        (a power posterior: Grünwald and van Ommen, Bayesian Analysis 12, 2017).
    """

    velocity: Literal["smoothed", "causal"] = "smoothed"
    pose_noise: tuple[float, float] = (5e-5, 6e-4)
    velocity_noise: tuple[float, float] = (2e-3, 2e-2)
    disturbance: tuple[float, float] = (0.086, 2.1)
    priors: tuple[EffectivenessPrior, ...] = PRIORS
    tail: float = 8.0
    tempering: float = 0.3

    @property
    def name(self) -> str:
        """What it is called on the command line."""
        return "actuation"

    @property
    def causal(self) -> bool:
        """Whether it uses nothing that was measured after the present."""
        return self.velocity == "causal"

    def begin(self, dynamics: Dynamics, past: Past) -> tuple[Any, Dynamics]:
        """Estimate state and dynamics to predict with; see `Encoder.begin`."""
        found = self.estimate(dynamics, past)
        thrust = np.asarray(dynamics.thrust)[..., None] * found.effectiveness[:, None]
        return found.state, replace(
            dynamics,
            thrust=thrust,
            configuration=np.asarray(dynamics.configuration)[..., None],
            center_of_mass=np.asarray(dynamics.center_of_mass)[..., None],
        )

    def estimate(self, dynamics: Dynamics, past: Past) -> Actuation:
        """Estimate what the past says.

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

        a the modelled accelerations along the measured yaw, a_i those of motor i, both integrated
        backwards from the present; the noise is that of the poses plus twice integrated white
        accelerations. p and v have no prior.
        """
        speed = _motor_speeds(dynamics, past)
        by_motor, rest = _accelerations(dynamics, past, speed, self.causal)
        basis = twice_integrated(by_motor, past.duration)
        present = np.asarray(past.state)[-1]
        residual = (
            past.state[:, :3]
            - present[:3]
            - twice_integrated(rest, past.duration)
            - basis.sum(axis=-2)
        )
        elapsed = np.cumsum(np.insert(past.duration, 0, 0.0, axis=0), axis=0)
        regression = _regression(basis, elapsed - elapsed[-1])
        step = float(np.median(past.duration))
        inverse = precisions(
            len(basis),
            step,
            self.pose_noise,
            self.disturbance,
            _unknown_start(dynamics),
            float(dynamics.motor_time_constant),
        )
        information, score, square = _normal_equations(regression, residual, inverse)
        if not self.causal:
            linear, angular = self.velocity_noise
            precise = np.array([linear, linear, angular]) ** -2.0
            information[:, [3, 4, 5], [3, 4, 5]] += precise
            score[:, 3:6] += precise * present[3:].T
            square += (precise * present[3:].T ** 2).sum(axis=1)
        measured = residual[:, :, 0].size + (0 if self.causal else 3) - 6
        solution, covariance, probability = self._compete(information, score, square, measured)
        state = np.concatenate([present[:3] + solution[:, :3].T, solution[:, 3:6].T, speed[-1]])
        spread = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))[:, 6:].T
        return Actuation(state, 1 + solution[:, 6:].T, spread, probability)

    def _compete(
        self,
        information: Float[np.ndarray, "B m m"],
        score: Float[np.ndarray, "B m"],
        square: Float[np.ndarray, " B"],
        measured: int,
    ) -> tuple[Float[np.ndarray, "B m"], Float[np.ndarray, "B m m"], Float[np.ndarray, "H B"]]:
        """Solve the regression with each prior; return their mean by evidence."""
        n = score.shape[1] - 6
        solutions, covariances, evidence = [], [], []
        for prior in self.priors:
            before = prior.covariance(n)
            whole = information.copy()
            whole[:, 6:, 6:] += np.linalg.inv(before)
            solution = np.linalg.solve(whole, score[..., None])[..., 0]
            misfit = square - (score * solution).sum(axis=1)
            likelihood = -(self.tail + measured) / 2 * np.log1p(misfit / self.tail)
            volume = np.linalg.slogdet(whole)[1] + np.linalg.slogdet(before)[1]
            solutions.append(solution)
            covariances.append(np.linalg.inv(whole))
            evidence.append(np.log(prior.weight) + self.tempering * (likelihood - volume / 2))
        weight = np.exp(np.array(evidence) - np.max(evidence, axis=0))
        weight /= weight.sum(axis=0)
        mean = np.einsum("hb,hbm->bm", weight, np.array(solutions))
        apart = np.array(solutions) - mean
        spread = np.array(covariances) + apart[..., :, None] * apart[..., None, :]
        return mean, np.einsum("hb,hbmk->bmk", weight, spread), weight


def _motor_speeds(dynamics: Dynamics, past: Past) -> Float[np.ndarray, "E n B"]:
    """Return the motor speeds over the past, from the first command on."""
    speeds = [np.asarray(past.command[0])]
    for command, duration in zip(past.command[:-1], past.duration, strict=True):
        speeds.append(motor_step(np, speeds[-1], command, duration, dynamics.motor_time_constant))
    return np.array(speeds)


def _accelerations(
    dynamics: Dynamics, past: Past, speed: Float[np.ndarray, "E n B"], causal: bool
) -> tuple[Float[np.ndarray, "E 3 n B"], Float[np.ndarray, "E 3 B"]]:
    """Return the accelerations that each motor gives along the measured yaw, and all others."""
    state = np.asarray(past.state)
    yaw, velocity, spin = state[:, 2], state[:, 3:5], state[:, 5]
    if causal:
        rates = np.diff(state[:, :3], axis=0) / np.asarray(past.duration)[:, None]
        rates = np.concatenate([rates, rates[-1:]])
        velocity, spin = rates[:, :2], rates[:, 2]
    motion = yaw, velocity[:, 0], velocity[:, 1], spin
    by_motor, rest = motor_accelerations(np, dynamics, motion, np.moveaxis(speed, 1, 0))
    return np.moveaxis(by_motor, 2, 0), np.moveaxis(rest, 1, 0)


def twice_integrated(
    acceleration: Float[np.ndarray, "E ... B"], duration: Float[np.ndarray, "e #B"]
) -> Float[np.ndarray, "E ... B"]:
    """Integrate backwards from the present twice, linear between samples."""
    position = np.zeros_like(acceleration)
    velocity = np.zeros_like(acceleration[0])
    for k in range(len(duration) - 1, -1, -1):
        h, here, there = duration[k], acceleration[k], acceleration[k + 1]
        velocity = velocity - h / 2 * (here + there)
        position[k] = position[k + 1] - h * velocity - h**2 / 6 * (2 * here + there)
    return position


def _unknown_start(dynamics: Dynamics) -> tuple[float, float]:
    """Return how far accelerations may be off since nobody knows the motors' first speeds."""
    slope = thrust_slope(np.asarray(dynamics.thrust), np.full(len(dynamics.thrust), 0.5))
    spread = np.sqrt(((np.asarray(dynamics.configuration) * slope) ** 2).sum(axis=1))
    return float(_FIRST_SPEED * spread[:2].mean()), float(_FIRST_SPEED * spread[2])


@lru_cache(maxsize=32)
def precisions(
    length: int,
    step: float,
    pose_noise: tuple[float, float],
    disturbance: tuple[float, float],
    start: tuple[float, float],
    time_constant: float,
) -> tuple[Float[np.ndarray, "E E"], ...]:
    """Return the inverse covariances of the residuals of x, y and γ."""
    integral = twice_integrated(np.eye(length), np.full((length - 1, 1), step))
    fading = np.exp(-np.arange(length) * step / time_constant) if time_constant > 0 else 0.0
    found = []
    for noise, density, first in zip(pose_noise, disturbance, start, strict=True):
        accelerations = density**2 / step * np.eye(length)
        # An error of the first speeds lasts, fading like the motors' lag.
        accelerations += first**2 * np.outer(fading, fading)
        covariance = noise**2 * np.eye(length) + integral @ accelerations @ integral.T
        found.append(np.linalg.inv(covariance))
    return found[0], found[0], found[1]


def _regression(
    basis: Float[np.ndarray, "E 3 n B"], elapsed: Float[np.ndarray, "E B"]
) -> Float[np.ndarray, "B 3 E m"]:
    """Return the matrix from p, v (x, y, γ each) and the motors' deviations to the residuals."""
    length, _, n, batch = basis.shape
    matrix = np.zeros((batch, 3, length, 6 + n))
    for c in range(3):
        matrix[:, c, :, c] = 1.0
        matrix[:, c, :, 3 + c] = elapsed.T
        matrix[:, c, :, 6:] = np.moveaxis(basis[:, c], -1, 0)
    return matrix


def _normal_equations(
    regression: Float[np.ndarray, "B 3 E m"],
    residual: Float[np.ndarray, "E 3 B"],
    precisions: tuple[Float[np.ndarray, "E E"], ...],
) -> tuple[Float[np.ndarray, "B m m"], Float[np.ndarray, "B m"], Float[np.ndarray, " B"]]:
    """Return XᵀSX, XᵀSr and rᵀSr of each window, summed over the channels."""
    information, score, square = 0.0, 0.0, 0.0
    for c, precision in enumerate(precisions):
        matrix, error = regression[:, c], residual[:, c].T
        weighted = precision @ matrix
        information = information + np.swapaxes(matrix, 1, 2) @ weighted
        score = score + (error[:, None] @ weighted)[:, 0]
        square = square + np.einsum("be,bf,ef->b", error, error, precision, optimize=True)
    return np.asarray(information), np.asarray(score), np.asarray(square)
