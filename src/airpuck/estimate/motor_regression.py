"""Linear regression of poses on the contribution of each motor.

Along a measured motion the modelled accelerations are a sum over the motors. Integrated twice, they
give each motor's contribution to the poses. The strength of a motor, and when it began to turn,
follow by weighted least squares with priors, here for a batch of windows at once.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from airpuck.physics.rigid_body import Dynamics, motor_accelerations


def with_effectiveness(dynamics: Dynamics, effectiveness: Float[np.ndarray, "n B"]) -> Dynamics:
    """Return a batch of craft whose motors deliver these fractions of their thrust."""
    return replace(
        dynamics,
        thrust=np.asarray(dynamics.thrust)[..., None] * effectiveness[:, None],
        configuration=np.asarray(dynamics.configuration)[..., None],
        center_of_mass=np.asarray(dynamics.center_of_mass)[..., None],
    )


def accelerations_by_motor(
    dynamics: Dynamics, state: Float[np.ndarray, "E z B"], speed: Float[np.ndarray, "E n B"]
) -> tuple[Float[np.ndarray, "E 3 n B"], Float[np.ndarray, "E 3 B"]]:
    """Return each motor's accelerations along measured states, and the remaining accelerations."""
    everything = np.moveaxis(np.asarray(state), 1, 0)
    motion = everything[2:6]
    if dynamics.of_place:
        motion = np.concatenate([motion, everything[:2]])
    by_motor, rest = motor_accelerations(np, dynamics, motion, np.moveaxis(speed, 1, 0))
    return np.moveaxis(by_motor, 2, 0), np.moveaxis(rest, 1, 0)


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
