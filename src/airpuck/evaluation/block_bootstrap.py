"""How sure is a root mean square error? Moving-block bootstrap over time (Künsch 1989).

Predictions that start close together share samples and disturbances, so their errors are no
independent draws. Blocks of time are: whole blocks are drawn with replacement. Few blocks make
percentiles of the draws too narrow, so intervals are Student's about the logarithm of the mean
square, with the spread of the draws and as many degrees of freedom as blocks less one.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

#: Length of a block [s]. The rule of Politis and White (2004) asks for 0.6 to 1.6 s on the squared
#: errors of seven real flights; faults and other disturbances last up to some seconds.
BLOCK_S = 3.0
#: Fewer blocks say nothing about their spread.
FEWEST_BLOCKS = 4
#: Draws; their spread is then known within 2 %.
_DRAWS = 1000


def blocks(start: Float[np.ndarray, " W"]) -> float:
    """Return how many blocks of time the starts of predictions fill."""
    return len(start) / _block_length(start)


def log_mean_square_errors(
    squares: Float[np.ndarray, "C W"], start: Float[np.ndarray, " W"]
) -> tuple[Float[np.ndarray, "C C"], float]:
    """Return the covariance of the logarithms of mean squares, and its degrees of freedom.

    All rows are drawn together, so rows of two models on the same predictions are compared in
    pairs: the variance of a difference of logarithms follows from the covariance.

    Parameters
    ----------
    squares : array, shape (C, W)
        Squared errors of W predictions, in C channels; of several models below each other.
    start : array, shape (W,)
        When each prediction starts, rising [s]. Pauses do not matter: blocks are counted in
        predictions.

    Returns
    -------
    tuple of array, shape (C, C), and float
        NaN and 0 where there are fewer than four blocks.
    """
    count = blocks(start)
    if count < FEWEST_BLOCKS:
        return np.full((len(squares), len(squares)), np.nan), 0.0
    length = _block_length(start)
    sums = np.cumsum(np.pad(squares, ((0, 0), (1, 0))), axis=1)
    of_block = sums[:, length:] - sums[:, :-length]
    chosen = np.random.default_rng(0).integers(of_block.shape[1], size=(_DRAWS, round(count)))
    drawn = _log(of_block[:, chosen].mean(axis=2))
    return np.atleast_2d(np.cov(drawn)) * count / (count - 1), count - 1


def rmse_interval(
    errors: Float[np.ndarray, "C W"], start: Float[np.ndarray, " W"]
) -> Float[np.ndarray, "2 C"]:
    """Return the 95 % interval of each channel's root mean square error; NaN if too short."""
    from scipy.stats import t

    squares = errors**2
    covariance, degrees = log_mean_square_errors(squares, start)
    half = t.ppf(0.975, degrees) * np.sqrt(np.diag(covariance)) if degrees else np.nan
    return np.sqrt(squares.mean(axis=1)) * np.exp(
        np.outer([-0.5, 0.5], half * np.ones(len(errors)))
    )


def rmse_ratio(
    first: Float[np.ndarray, "C W"],
    second: Float[np.ndarray, "C W"],
    start: Float[np.ndarray, " W"],
) -> tuple[Float[np.ndarray, " C"], Float[np.ndarray, "2 C"], Float[np.ndarray, " C"]]:
    """Compare two models on the same predictions.

    Returns
    -------
    tuple of array, shape (C,), array, shape (2, C), and array, shape (C,)
        Ratio of the second RMSE to the first, its 95 % interval, and the p-value of equality;
        NaN where the predictions are too few.
    """
    from scipy.stats import t

    n = len(first)
    squares = np.concatenate([first, second]) ** 2
    logs = _log(squares.mean(axis=1))
    difference = logs[n:] - logs[:n]
    covariance, degrees = log_mean_square_errors(squares, start)
    own = np.diag(covariance)
    variance = own[n:] + own[:n] - 2 * np.diag(covariance, n)
    # Equal errors differ by rounding only.
    spread = np.sqrt(np.maximum(variance, 1e-24))
    half = t.ppf(0.975, degrees) * spread
    interval = np.exp([0.5 * (difference - half), 0.5 * (difference + half)])
    return np.exp(difference / 2), interval, 2 * t.sf(np.abs(difference) / spread, degrees)


def _log(mean_squares: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Take logarithms; an exact prediction counts as an immeasurably small error."""
    return np.log(np.maximum(mean_squares, 1e-30))


def _block_length(start: Float[np.ndarray, " W"]) -> int:
    """Return how many predictions a block has."""
    return max(1, round(BLOCK_S / float(np.median(np.diff(start))))) if len(start) > 1 else 1
