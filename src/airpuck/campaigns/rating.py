"""Ratings from games of pairs, and their uncertainty (Bradley and Terry, Biometrika 39, 1952)."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

#: Lead on the Elo scale at which the odds of a win are ten to one.
ELO = 400.0
#: Prior standard deviation of ratings [Elo]: even a player who won or lost all games gets a finite
#: rating. The odds of most pairs are then between 1 : 30 and 30 : 1. A guess.
_SPREAD = 420.0
#: Newton's method stops at changes below this [log odds].
_EXACT = 1e-9


def ratings(
    points: Float[np.ndarray, "p p"],
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    """Rate players by their points against each other.

    The probability that i beats j is 1 / (1 + 10^((R_j - R_i) / 400)); a draw is half a win. The
    ratings are the mode of the posterior for independent normal ratings, with the covariance of its
    normal approximation.

    Parameters
    ----------
    points : array, shape (p, p)
        Entry i, j: games that player i won against j, plus half of those drawn.

    Returns
    -------
    rating : array, shape (p,)
        Elo ratings with mean 0.
    covariance : array, shape (p, p)
        Covariance of the ratings [Elo²].
    """
    scale = ELO / math.log(10)
    games, count = points + points.T, len(points)
    prior, value, step = (scale / _SPREAD) ** 2, np.zeros(count), np.full(count, np.inf)
    hessian = prior * np.eye(count)
    while np.abs(step).max() > _EXACT:
        chance = 1 / (1 + np.exp(value[None, :] - value[:, None]))
        gradient = (points - games * chance).sum(axis=1) - prior * value
        weight = games * chance * (1 - chance)
        hessian = np.diag(weight.sum(axis=1) + prior) - weight
        # Far from the mode a full Newton step may overshoot.
        step = np.clip(np.linalg.solve(hessian, gradient), -1.0, 1.0)
        value = value + step
    # Relative to the mean, which games do not determine.
    centred = np.eye(count) - 1 / count
    covariance = centred @ np.linalg.inv(hessian) @ centred
    return scale * centred @ value, scale**2 * covariance
