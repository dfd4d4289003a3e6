"""Linear regression of poses on the contribution of each motor.

Along a measured motion the modelled accelerations are a sum over the motors. Integrated twice, they
give each motor's contribution to the poses. The strength of a motor, and when it began to turn,
follow by weighted least squares with priors, here for a batch of windows at once.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from airpuck.physics.motor import motor_step
from airpuck.physics.rigid_body import Dynamics, acceleration, motor_accelerations


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
