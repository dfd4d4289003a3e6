"""Do commands still explain the innovations? Correlation, and a test that tells motors apart.

Commands of a pair exclude each other and are held over many samples, so that the correlations with
one motor hold some of the others', and of its own at other lags. The bands account for the latter
(Ljung 1999, equation 16.69); the test is Wald's in one regression on all motors' past commands,
with a covariance that does not mind that innovations are larger where commands change (HC3: White
1980, MacKinnon and White 1985).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.results import Result
from airpuck.evaluation.statistical_tests import (
    BAND,
    LEVEL,
    beyond_least,
    holm,
    share_text,
    with_pauses,
)

#: Share of the largest eigenvalue of a regression below which a direction is not in the data.
_NONE = 1e-10


@dataclass(frozen=True, eq=False)
class CrossCorrelation(Result):
    """What one motor's command still says about one channel."""

    JSON = (
        "channel passed statistic p_value share band degrees_of_freedom=degrees "
        "motor tested early correlation"
    )

    #: Which.
    channel: str
    motor: str
    #: Of the innovation at t with the command in force at t − k, for lags k = −M … M.
    correlation: Float[np.ndarray, " K"]
    #: 99 % lie within ±band, pointwise, where the command explains nothing; from the
    #: autocorrelations of both.
    band: float
    #: Wald's, that the coefficients of the command at lags 1 … M in a regression on all motors'
    #: commands are zero.
    statistic: float
    #: Of the χ² that it follows then.
    degrees: int
    #: Probability of so large a statistic if the motor explains no more than `LEAST_SHARE` of the
    #: variance, adjusted for the number of motors (Holm).
    p_value: float
    #: Share of the variance that it explains, estimated.
    share: float
    #: Summed coefficients of the first third of the lags, in standard errors, positive where the
    #: motor does more than modelled: how the innovations answer to a step of the command.
    early: float
    #: False where the commands do not tell this motor from the others.
    tested: bool

    @property
    def passed(self) -> bool:
        """Whether it was not tested, or independence is not rejected at the 1 % level."""
        return not self.tested or self.p_value >= LEVEL

    @property
    def peak(self) -> tuple[int, float]:
        """Positive lag with the largest correlation, in samples, and the correlation there."""
        middle = len(self.correlation) // 2
        lag = middle + 1 + int(np.abs(self.correlation[middle + 1 :]).argmax())
        return lag - middle, float(self.correlation[lag])

    @property
    def verdict(self) -> str:
        """One sentence; of what is not rejected, too."""
        explained = share_text(self.share)
        if self.passed:
            return f"{self.motor} explains nothing more of {self.channel}: {explained}"
        lag, value = self.peak
        return (
            f"{self.motor} still explains part of {self.channel}, {explained}: the correlation is "
            f"{value:.2g} after {lag} samples, and chance keeps it within ±{self.band:.2g}"
        )


def cross_correlations(
    channel: str,
    values: Float[np.ndarray, " N"],
    used: Bool[np.ndarray, " N"],
    command: Float[np.ndarray, "N n"],
    motors: Sequence[str],
    effect: Float[np.ndarray, " n"],
    lags: int,
    told: Collection[str] | None = None,
) -> list[CrossCorrelation]:
    """Test one channel against all motors; only those `told` apart by the commands, if given."""
    moved: list[int] = np.flatnonzero(np.ptp(command[used], axis=0) > 0).tolist()
    if not moved:
        return []
    inputs = with_pauses(command - command[used].mean(axis=0), used, lags)
    row = with_pauses(values[:, None], used, lags)[:, 0]
    at = np.flatnonzero(with_pauses(np.ones((len(used), 1)), used, lags)[:, 0] > 0)
    at = at[at >= lags]
    past = np.stack([inputs[at - k] for k in range(1, lags + 1)], axis=2)
    blocks, covariance = _regress(past[:, moved].reshape(len(at), -1), row[at])
    blocks = blocks.reshape(len(moved), lags)
    statistics, degrees, early = [], [], []
    for k, motor in enumerate(moved):
        part = slice(k * lags, (k + 1) * lags)
        own = covariance[part, part]
        inverse, rank = _pseudo_inverse(own)
        statistics.append(float(blocks[k] @ inverse @ blocks[k]))
        degrees.append(rank)
        first = np.arange(lags) < lags // 3
        spread = np.sqrt(max(float(first @ own @ first), 1e-300))
        early.append(float(np.sign(effect[motor]) * blocks[k] @ first / spread))
    tested = np.array([told is None or motors[motor] in told for motor in moved])
    given = zip(statistics, degrees, strict=True)
    p_values, shares = np.array([beyond_least(q, d, len(at)) for q, d in given]).T
    adjusted = np.ones(len(moved))
    adjusted[tested] = holm(p_values[tested])
    return [
        CrossCorrelation(
            channel,
            motors[motor],
            *_correlate(row, inputs[:, motor], lags),
            statistics[k],
            degrees[k],
            float(adjusted[k]),
            float(shares[k]),
            early[k],
            bool(tested[k]),
        )
        for k, motor in enumerate(moved)
    ]


def _correlate(
    row: Float[np.ndarray, " L"], command: Float[np.ndarray, " L"], lags: int
) -> tuple[Float[np.ndarray, " K"], float]:
    """Return the correlations at all lags, and half their 99 % band."""
    from scipy.signal import correlate

    size = len(row)

    def products(left: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Sum left(t) right(t - k), for k = -M … M."""
        return correlate(left, right)[size - 1 - lags : size + lags]

    own, theirs = products(row, row), products(command, command)
    scale = np.sqrt(own[lags] * theirs[lags])
    # The triangle keeps the sum of estimated products from going below zero.
    triangle = 1 - np.abs(np.arange(-lags, lags + 1)) / (lags + 1)
    inflation = float(np.sum(triangle * own / own[lags] * theirs / theirs[lags]))
    count = int(np.count_nonzero(row))
    return products(row, command) / scale, BAND * float(np.sqrt(max(inflation, 0.0) / count))


def _regress(
    regressors: Float[np.ndarray, "L F"], row: Float[np.ndarray, " L"]
) -> tuple[Float[np.ndarray, " F"], Float[np.ndarray, "F F"]]:
    """Return least-squares coefficients and their covariance."""
    inverse, _ = _pseudo_inverse(regressors.T @ regressors)
    coefficients = inverse @ (regressors.T @ row)
    leverage = np.einsum("lf,lf->l", regressors @ inverse, regressors)
    left = (row - regressors @ coefficients) / np.maximum(1 - leverage, 0.1)
    scores = regressors * left[:, None]
    return coefficients, inverse @ (scores.T @ scores) @ inverse


def _pseudo_inverse(matrix: Float[np.ndarray, "F F"]) -> tuple[Float[np.ndarray, "F F"], int]:
    """Invert a symmetric matrix in the directions that the data show, and count them."""
    rank = np.linalg.matrix_rank(matrix, rtol=_NONE, hermitian=True)
    return np.linalg.pinv(matrix, rtol=_NONE, hermitian=True), int(rank)
