"""Noise of the motion capture and of what the model does not explain, by maximum likelihood.

Along a given motion the filter's three axes are linear and do not know of each other, and their
gains depend only on two ratios of variances, λ₁ = q₁h³/r and λ₂ = q₂h⁵/r with the variance r of the
pose, the squared densities q of w₁ and w₂ and the sample period h; r itself follows in closed form
(concentrated likelihood). So the search is in two dimensions, for all axes and many candidates at
once.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.compute.compiled import for_samples
from airpuck.estimate.axis_filter import Noise, correct, spread

#: Ranges of log₁₀ λ₁ and λ₂; at the lower end a noise is none.
_LOWEST, _HIGHEST = np.array([-14.0, -22.0]), np.array([3.0, 3.0])
#: Candidates of each ratio in the first look, and when to stop [decades].
_GRID, _FINEST = 9, 0.02
#: A better likelihood is better by at least this much.
_GAIN = 1e-3
#: Standard deviation of the speed at the first pose of a stretch, in pose noise per sample period:
#: practically unknown.
_UNSURE = 1e3


def most_likely_noise(
    pose: Float[np.ndarray, "N 3"],
    added: Float[np.ndarray, "N 3 2"],
    period: Float[np.ndarray, " N"],
    restart: Bool[np.ndarray, " N"],
    used: Bool[np.ndarray, " N"],
    typical: float,
    near: Noise | None = None,
) -> tuple[Noise, tuple[int, int, int]]:
    """Find the noise with the largest likelihood, and how many of its numbers are not zero.

    `added` is what the model adds to position and velocity of each axis from one sample to the
    next; `typical` is the sample period [s]; `near` is where to search, if that is known.
    """
    given = pose, added, period, restart, used.astype(float)
    point, step = _begin(near, typical, given)
    axis, least = np.arange(3), np.full(3, np.inf)
    around = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1], indexing="ij"), axis=-1).reshape(-1, 2)
    while (step > _FINEST).any():
        candidates = np.clip(point + around[:, None] * step, _LOWEST, _HIGHEST)
        cost = _costs(candidates, typical, given)[0]
        best = cost.argmin(axis=0)
        better = cost[best, axis] < least - _GAIN
        point = np.where(better[:, None], candidates[best, axis], point)
        least = np.where(better, cost[best, axis], least)
        step = np.where(better[:, None], step, step / 2)
    # A noise that does not pay for itself is none: Akaike's criterion, among those left away. As
    # many candidates as in the search, for one program.
    candidates = np.repeat(point[None], len(around), axis=0)
    candidates[1::2, :, 0], candidates[2:, :, 1] = _LOWEST[0], _LOWEST[1]
    cost, variance = _costs(candidates, typical, given)
    ratios = _ratios(candidates)
    best = (cost + (ratios > 0).sum(axis=2)).argmin(axis=0)
    ratios, scale = ratios[best, axis], variance[best, axis]
    densities = ratios * scale[:, None] / typical ** np.array([3, 5])
    parts: Any = (tuple(np.sqrt(part).tolist()) for part in (scale, *densities.T))
    counts: Any = tuple((1 + (ratios > 0).sum(axis=1)).tolist())
    return Noise(*parts), counts


def _begin(
    near: Noise | None, typical: float, given: tuple[np.ndarray, ...]
) -> tuple[Float[np.ndarray, "3 2"], Float[np.ndarray, "3 2"]]:
    """Return where the search begins, and its first step."""
    if near is not None:
        densities = np.square([near.acceleration, near.disturbance]).T
        ratios = densities * typical ** np.array([3, 5]) / np.square(near.pose)[:, None]
        return np.clip(np.log10(ratios + 1e-300), _LOWEST, _HIGHEST), np.full((3, 2), 0.2)
    axes = [np.linspace(_LOWEST[k], _HIGHEST[k], _GRID) for k in range(2)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    candidates = np.repeat(grid[:, None], 3, axis=1)
    best = _costs(candidates, typical, given)[0].argmin(axis=0)
    step = (_HIGHEST - _LOWEST) / (_GRID - 1) / 2
    return candidates[best, np.arange(3)], np.repeat(step[None], 3, axis=0)


def _ratios(point: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Return λ from its logarithm; the lowest is none."""
    return np.where(point > _LOWEST, 10.0**point, 0.0)


def _costs(
    candidates: Float[np.ndarray, "C 3 2"], typical: float, given: tuple[np.ndarray, ...]
) -> tuple[Float[np.ndarray, "C 3"], Float[np.ndarray, "C 3"]]:
    """Return minus the concentrated log-likelihood, up to a constant, and r."""
    ratios = _ratios(candidates).reshape(-1, 2) / typical ** np.array([3, 5])
    none, one = np.zeros(len(ratios)), np.ones(len(ratios))
    start = initial_covariance(np, one, ratios[:, 1], typical)
    carry = np.zeros((len(ratios), 3)), start, none, none
    *_, squares, logs = _compiled()((*ratios.T, start), carry, given)[0]
    variance = squares.reshape(-1, 3) / (count := given[-1].sum())
    return 0.5 * (count * np.log(variance) + logs.reshape(-1, 3)), variance


@cache
def _compiled() -> Any:
    """Compile the pass over the samples: sums of squares and of logarithms."""
    import jax.numpy as jnp

    def advance(known: Any, carry: Any, now: Any) -> Any:
        (acceleration, disturbance, start), (mean, covariance, squares, logs) = known, carry
        pose, added, h, restart, used = now
        count, one = len(acceleration) // 3, jnp.ones_like(acceleration)
        pose, added = jnp.tile(pose, count), jnp.tile(added, (count, 1))
        p, v, d = mean[:, 0], mean[:, 1], mean[:, 2]
        p = p + h * v + h * h / 2 * d + added[:, 0]
        mean = jnp.stack([p, v + h * d + added[:, 1], d], axis=1)
        covariance = spread(jnp, covariance, h, acceleration, disturbance)
        innovation, variance = pose - p, covariance[:, 0, 0] + 1.0
        mean, covariance = correct(mean, covariance, 0, innovation, one)
        squares = squares + used * innovation**2 / variance
        logs = logs + used * jnp.log(variance)
        fresh = jnp.stack([pose, 0 * pose, 0 * pose], axis=1)
        mean = jnp.where(restart, fresh, mean)
        covariance = jnp.where(restart, start, covariance)
        return (mean, covariance, squares, logs), None

    return for_samples(advance)


def initial_covariance(xp: Any, pose_variance: Any, disturbance: Any, period: Any) -> Any:
    """Return the covariance of each axis at the first pose of a stretch."""
    zero = xp.zeros_like(pose_variance)
    speed = pose_variance * (_UNSURE / period) ** 2
    rows = [[pose_variance, zero, zero], [zero, speed, zero], [zero, zero, disturbance]]
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)
