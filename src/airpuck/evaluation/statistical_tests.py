"""Whiteness by the test of Ljung and Box (1978), and multiple tests by Holm (1979).

With enough samples any model is wrong. So effects are tested against the smallest relevant effect,
a fraction of the variance, instead of zero (Murphy and Myors 1999).

Intervals of root mean square errors come from a moving-block bootstrap over time (Künsch 1989).
Predictions that start close together share samples and disturbances, so their errors are not
independent, but blocks of time are. Whole blocks are therefore drawn with replacement. With few
blocks, percentiles of the draws are too narrow. So intervals are Student's, about the logarithm of
the mean square, with the spread of the draws and one degree of freedom less than there are blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.results import Result
from airpuck.deviation.significance import BAND, LEVEL

#: Fraction of a channel's variance below which a residual effect does not count.
LEAST_SHARE = 0.01
#: Length of a block [s]. The rule of Politis and White (2004) gives 0.6 to 1.6 s for the squared
#: errors of seven real flights; faults and other disturbances last up to a few seconds.
BLOCK_S = 3.0
#: Fewest blocks from which their spread can be estimated.
FEWEST_BLOCKS = 4
#: Number of draws; the spread is then known within 2 %.
_DRAWS = 1000


@dataclass(frozen=True, eq=False)
class Whiteness(Result):
    """Autocorrelation of one channel."""

    JSON = "channel passed statistic p_value share band degrees_of_freedom=degrees autocorrelation"

    #: Name of the channel.
    channel: str
    #: r(1) … r(M).
    autocorrelation: Float[np.ndarray, " M"]
    #: 99 % of white noise's correlations lie within ±band, pointwise.
    band: float
    #: Q = N(N + 2) Σ r(k)²/(N − k) of Ljung and Box.
    statistic: float
    #: Degrees of freedom of the χ² that Q follows for white innovations: M minus the number of
    #: noise ratios fitted to these data.
    degrees: int
    #: P-value if past innovations explain no more than `LEAST_SHARE` of the variance.
    p_value: float
    #: Estimated fraction of the variance that past innovations explain: Q minus its expectation
    #: under chance, over N.
    share: float

    @property
    def passed(self) -> bool:
        """Whether whiteness is not rejected at the 1 % level."""
        return self.p_value >= LEVEL

    @property
    def verdict(self) -> str:
        """One sentence."""
        explained = f"past innovations explain {share_text(self.share)}"
        if self.passed:
            return f"{self.channel} innovations are white ({explained})"
        lag = int(np.abs(self.autocorrelation).argmax())
        return (
            f"{self.channel} innovations are not white: {explained}; the correlation is largest "
            f"after {lag + 1} samples, {self.autocorrelation[lag]:.2g}, and chance keeps it within "
            f"±{self.band:.2g}"
        )


def ljung_box(
    channel: str,
    values: Float[np.ndarray, " N"],
    used: Bool[np.ndarray, " N"],
    lags: int,
    fitted: int,
) -> Whiteness:
    """Test one channel by Ljung and Box."""
    row = with_pauses(values[:, None], used, lags)[:, 0]
    count = int(used.sum())
    correlation = np.array([row[k:] @ row[: len(row) - k] for k in range(lags + 1)])
    r = correlation[1:] / correlation[0]
    statistic = count * (count + 2) * float(np.sum(r**2 / (count - np.arange(1, lags + 1))))
    degrees = lags - fitted
    p_value, share = beyond_least(statistic, degrees, count)
    return Whiteness(channel, r, BAND / np.sqrt(count), statistic, degrees, p_value, share)


def beyond_least(statistic: float, degrees: int, count: int) -> tuple[float, float]:
    """Test a χ² of `count` samples against the smallest effect that counts.

    Returns the probability of such a large statistic under that effect (noncentral χ²), and the
    corresponding fraction of the variance.
    """
    from scipy.stats import ncx2

    p_value = float(ncx2.sf(statistic, degrees, LEAST_SHARE * count)) if degrees else 1.0
    return p_value, max(statistic - degrees, 0.0) / count


def with_pauses(
    values: Float[np.ndarray, "N C"], used: Bool[np.ndarray, " N"], lags: int
) -> Float[np.ndarray, "L C"]:
    """Put zeros between stretches, so that no product of two samples spans a gap.

    A single sample that is not used is a lost frame, not a gap.
    """
    values = np.where(used[:, None], values, 0.0)
    before = np.concatenate([[True, True], used])
    begins = np.flatnonzero(used & ~before[1:-1] & ~before[:-2])
    return np.insert(values, np.repeat(begins, lags), 0.0, axis=0)


def share_text(share: float) -> str:
    """Write a fraction of the variance next to the threshold."""
    return f"{100 * share:.1f} % of the variance (threshold {100 * LEAST_SHARE:g} %)"


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return Wilson's (1927) 95 % interval of a probability."""
    from scipy.stats import binomtest

    found = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def blocks(start: Float[np.ndarray, " W"]) -> float:
    """Return the number of blocks of time that the starts of predictions span."""
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
        Squared errors of W predictions, in C channels; several models are stacked.
    start : array, shape (W,)
        Increasing start times of the predictions [s]. Pauses do not matter: blocks are counted in
        predictions.

    Returns
    -------
    tuple of array, shape (C, C), and float
        NaN and 0 if there are fewer than four blocks.
    """
    drawn, count = redrawn_means(squares, start), blocks(start)
    if drawn is None:
        return np.full((len(squares), len(squares)), np.nan), 0.0
    return np.atleast_2d(np.cov(_log(drawn))) * count / (count - 1), count - 1


def redrawn_means(
    values: Float[np.ndarray, "C W"], start: Float[np.ndarray, " W"]
) -> Float[np.ndarray, "C D"] | None:
    """Return means over moving blocks of time that are drawn with replacement; None if too few.

    All rows are drawn together; see `log_mean_square_errors`.
    """
    count, length = blocks(start), _block_length(start)
    if count < FEWEST_BLOCKS:
        return None
    sums = np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=1)
    of_block = (sums[:, length:] - sums[:, :-length]) / length
    size = _DRAWS, round(count)
    chosen = np.random.default_rng(0).integers(of_block.shape[1], size=size)
    return np.array([each[chosen].mean(axis=1) for each in of_block])


def rmse_interval(
    errors: Float[np.ndarray, "C W"], start: Float[np.ndarray, " W"]
) -> Float[np.ndarray, "2 C"]:
    """Return the 95 % interval of each channel's root mean square error; NaN if too short."""
    from scipy.special import stdtrit

    squares = errors**2
    covariance, degrees = log_mean_square_errors(squares, start)
    half = stdtrit(degrees, 0.975) * np.sqrt(np.diag(covariance)) if degrees else np.nan
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
        Ratio of the second RMSE to the first, its 95 % interval, and the p-value of equality; NaN
        if the predictions are too few.
    """
    from scipy.special import stdtr, stdtrit

    n = len(first)
    squares = np.concatenate([first, second]) ** 2
    logs = _log(squares.mean(axis=1))
    difference = logs[n:] - logs[:n]
    covariance, degrees = log_mean_square_errors(squares, start)
    own = np.diag(covariance)
    variance = own[n:] + own[:n] - 2 * np.diag(covariance, n)
    # Equal errors differ by rounding only.
    spread = np.sqrt(np.maximum(variance, 1e-24))
    half = stdtrit(degrees, 0.975) * spread
    interval = np.exp([0.5 * (difference - half), 0.5 * (difference + half)])
    return np.exp(difference / 2), interval, 2 * stdtr(degrees, -np.abs(difference) / spread)


def _log(mean_squares: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Take logarithms; the error of an exact prediction is replaced by a tiny one."""
    return np.log(np.maximum(mean_squares, 1e-30))


def _block_length(start: Float[np.ndarray, " W"]) -> int:
    """Return how many predictions a block has."""
    return max(1, round(BLOCK_S / float(np.median(np.diff(start))))) if len(start) > 1 else 1
