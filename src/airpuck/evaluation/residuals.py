"""Residual tests on one-step innovations (Ljung 1999, ch. 16.6).

The tests ask two questions. Are the innovations white, or do past ones predict the next? Do the
motor commands still explain them, so that the model has not used all of their information? Both
tests use the body frame, where a motor pushes in one direction whatever the yaw. A third
test asks which error of the model would explain the innovations. Late packets and feedback are part
of the null hypothesis.

The commands of a pair exclude each other and are held over many samples. So the correlations with
one motor contain some of the other motors' correlations, and some of its own at other lags. The
bands account for the latter (Ljung 1999, equation 16.69). To separate the motors, a Wald test uses
one regression on the past commands of all motors. Its covariance is robust against innovations that
are larger when commands change (HC3: White 1980, MacKinnon and White 1985).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result
from airpuck.data.sampling import hold
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.motor_regression import block_regression
from airpuck.deviation.packet_delays import delay_for
from airpuck.deviation.significance import (
    BAND,
    IN_RECORDING,
    LEVEL,
    ModelError,
    holm,
    tested_errors,
    verdicts,
)
from airpuck.evaluation.innovations import Innovations, innovations
from airpuck.evaluation.late_packets import LatePackets, late_packets
from airpuck.evaluation.statistical_tests import (
    Whiteness,
    beyond_least,
    ljung_box,
    share_text,
    with_pauses,
)
from airpuck.evaluation.structure import Structure, cut, find_structure, missing_accelerations
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import to_body

#: Fraction of the largest eigenvalue of a regression below which a direction is not in the data.
_NONE = 1e-10
#: Channels of the innovations in the body frame.
BODY_CHANNELS = ("forward", "left", "yaw")
#: Largest lag [samples].
LAGS = 25
#: Length of a block of time behind standard errors [s]: the effect of a late packet lasts.
_BLOCK_S = 0.5
#: A push below this fraction of the strongest one counts as none.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class CrossCorrelation(Result):
    """The share of one channel that one motor's command still explains."""

    JSON = (
        "channel passed statistic p_value share band degrees_of_freedom=degrees "
        "motor tested early correlation"
    )

    #: Channel and motor.
    channel: str
    motor: str
    #: Correlation of the innovation at t with the command in force at t − k, for lags k = −M … M.
    correlation: Float[np.ndarray, " K"]
    #: 99 % lie within ±band, pointwise, if the command explains nothing; from the autocorrelations
    #: of both.
    band: float
    #: Wald statistic for zero coefficients of the command at lags 1 … M, in a regression on all
    #: motors' commands.
    statistic: float
    #: Degrees of freedom of its χ² distribution.
    degrees: int
    #: P-value if the motor explains no more than `LEAST_SHARE` of the variance, adjusted for the
    #: number of motors (Holm).
    p_value: float
    #: Estimated fraction of the variance that it explains.
    share: float
    #: Sum of the coefficients over the first third of the lags, in standard errors. Positive if the
    #: motor's effect exceeds the model's: the response of the innovations to a step of the command.
    early: float
    #: False if the commands do not separate this motor from the others.
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
        """One sentence, also if nothing is rejected."""
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
    """Test one channel against all motors, or only those that commands separate (`told`)."""
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
    tests = adjusted.tolist(), shares.tolist(), early, tested.tolist()
    judged = zip(statistics, degrees, *tests, strict=True)
    return [
        CrossCorrelation(channel, motors[motor], *_correlate(row, inputs[:, motor], lags), *figures)
        for motor, figures in zip(moved, judged, strict=True)
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
    # The triangular window keeps the sum of estimated products non-negative.
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


@dataclass(frozen=True, eq=False)
class ResidualTests(Result):
    """Residual tests of one model on one trajectory.

    Attributes
    ----------
    model : str
        Name of the rung.
    samples : int
        Innovations used.
    sample_period : float
        [s].
    whiteness : tuple of Whiteness
        One for each of `BODY_CHANNELS`.
    correlations : tuple of CrossCorrelation
        For each channel, each motor that moved.
    errors : tuple of ModelError
        Errors of each motor, the mass and the delay.
    structure : tuple of Structure
        Dependence of residuals on each regressor, for each channel.
    innovations : Innovations
        Innovations of the filter without late packets.
    late : LatePackets
        Innovations of the filter that allows for late packets, which the tests use.

    Examples
    --------
    >>> tests = airpuck.resid(model, trajectory)
    >>> isinstance(tests, airpuck.ResidualTests), tests.passed
    (True, True)
    """

    SHOWN = "model samples sample_period_s=sample_period passed jitter_s=late.jitter verdicts"
    JSON = (
        "model samples sample_period_s=sample_period passed verdicts noise=innovations.noise "
        "jitter_s=late.jitter whiteness cross_correlation=correlations model_errors=errors "
        "structure"
    )

    model: str
    samples: int
    sample_period: float
    whiteness: tuple[Whiteness, ...]
    correlations: tuple[CrossCorrelation, ...]
    errors: tuple[ModelError, ...]
    structure: tuple[Structure, ...]
    innovations: Innovations
    late: LatePackets

    @property
    def passed(self) -> bool:
        """Whether nothing was rejected."""
        tests = *self.whiteness, *self.correlations, *self.errors, *self.structure
        return all(test.passed for test in tests)

    @property
    def verdicts(self) -> list[str]:
        """Sentences: whiteness of each channel, motors that explain part of it, and why."""
        said = [test.verdict for test in self.whiteness]
        for channel in BODY_CHANNELS:
            tests = [t for t in self.correlations if t.channel == channel and t.tested]
            failed = [test for test in tests if not test.passed]
            said += [test.verdict for test in sorted(failed, key=lambda test: test.p_value)]
            if tests and not failed:
                most = 100 * max(test.share for test in tests)
                said.append(f"no motor explains more of {channel} (at most {most:.1f} %)")
        shown = sorted((s for s in self.structure if s.shown), key=lambda s: -s.share)
        said += verdicts(self.errors) + [one.verdict for one in shown]
        if not shown:
            names = ", ".join(dict.fromkeys(one.regressor for one in self.structure))
            said.append(f"residuals depend on none of {names}")
        return said


def resid(model: Model, trajectory: Trajectory, *, lags: int = LAGS) -> ResidualTests:
    """Test the one-step innovations of a model.

    Parameters
    ----------
    model : Model
        The model.
    trajectory : Trajectory
        Data, preferably not those that the model was learned from.
    lags : int, default 25
        Largest lag M [samples].

    Returns
    -------
    ResidualTests
        Whiteness and cross-correlation with the commands, each at the 1 % level.

    Raises
    ------
    InputError
        If the trajectory is of another craft, or too short for this number of lags.

    Examples
    --------
    >>> airpuck.resid(model, trajectory).passed
    True
    """
    n, usable = len(trajectory.propellers), int(trajectory.usable.sum())
    if lags < 5 or usable < 4 * lags * n:
        raise InputError(
            f"{lags} lags of {n} motors need at least {4 * max(lags, 5) * n} usable poses, but "
            f"there are {usable}; lags can be from 5 to {usable // (4 * n)}",
            field="lags",
        )
    found = innovations(model, trajectory)
    bins = cut(trajectory, found)
    others = missing_accelerations(bins, trajectory.state)
    late = late_packets(model, trajectory, found, others)
    motors, used = trajectory.propellers, found.used
    # A delay that the model did not learn comes from the recording, in whole samples.
    period = trajectory.sample_period
    known = 0.0 if model.delay_learned else period
    errors = model_errors(motors, late, used, period, known)
    told = {error.name for error in errors if error.tested}
    # The mean delay of the packets is judged separately.
    late_by = errors[0].value
    structure = find_structure(model, trajectory, found, late, bins, late_by)
    body = to_body(late.values, trajectory.state[:, 2])
    whiteness = tuple(
        ljung_box(name, body[:, k], used, lags, found.noise_parameters[k] - 1)
        for k, name in enumerate(BODY_CHANNELS)
    )
    acts = trajectory.command_time + delay_for(model, trajectory)
    held, effects = hold(acts, trajectory.command, trajectory.time), _effects(model)
    correlations = [
        test
        for k, name in enumerate(BODY_CHANNELS)
        for test in cross_correlations(name, body[:, k], used, held, motors, effects[k], lags, told)
    ]
    return ResidualTests(
        model=model.name,
        samples=int(found.used.sum()),
        sample_period=trajectory.sample_period,
        whiteness=whiteness,
        correlations=tuple(correlations),
        errors=errors,
        structure=tuple(structure),
        innovations=found,
        late=late,
    )


def model_errors(
    motors: Sequence[str],
    late: LatePackets,
    used: Bool[np.ndarray, " N"],
    period: float,
    delay_known: float = 0.0,
) -> tuple[ModelError, ...]:
    """Estimate the errors of timing, all motors and the mass together, and test them.

    A delay estimated from the recording has the standard error `delay_known` [s].
    """
    translation = late.directions[..., 2:].sum(axis=2, keepdims=True) * [[1.0], [1.0], [0.0]]
    regressors = np.concatenate([late.directions, translation], axis=2)[used]
    names = "delay", "lag", *motors, "mass"
    # In units of negligible errors, so that all columns have similar scales.
    unit, time = IN_RECORDING.least
    units = np.array([time, time, *[unit] * (len(names) - 2)])
    given = regressors * units, late.steady[used], period, _BLOCK_S
    value, covariance, blocks = block_regression(*given)
    error = units * np.sqrt(np.diag(covariance))
    return tested_errors(
        names, units * value, error, blocks - 1, IN_RECORDING, delay_known=delay_known
    )


def _effects(model: Model) -> Float[np.ndarray, "3 n"]:
    """Return each motor's push on `BODY_CHANNELS` [1/kg].

    Rounding in the cosine of a right angle is not a push.
    """
    effects = model.propeller_effects
    return np.where(np.abs(effects) > _ROUNDING * np.abs(effects).max(), effects, 0.0)
