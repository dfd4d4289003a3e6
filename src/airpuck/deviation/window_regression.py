"""Regression of mean accelerations over windows on the thrusts of all motors.

Raw accelerations of a slow craft are nearly all noise. The mean acceleration over a window is the
curvature of the parabola through its poses, whose noise falls with the window's length to the power
2.5. Windows do not overlap, and poses are not smoothed, so their noise is independent: an F test
shows whether the commands explain anything, however small their fraction of the variance. Slow
disturbances correlate neighbouring windows, which then count as fewer windows, as for an
autoregression.

The curvature of a motion is its acceleration, averaged with the weight (1 - u²)², where u runs from
-1 to 1 over the window. The same regression finds the effects of the floor: a constant acceleration
in the table frame, caused by a slope; an acceleration linear in the position, if the table is not
flat; and dry friction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.polynomial.polynomial import polyvander

from airpuck.craft.vehicle import GRAVITY
from airpuck.data.trajectory import Trajectory
from airpuck.physics.effects import CREEP

#: Shortest and longest window [s]; the length that explains most clearly is used.
_SHORTEST, _LONGEST = 0.05, 3.2
#: Fewest samples of a window.
_FEWEST = 5
#: Fewest windows per motor.
_PER_MOTOR = 4
#: Largest number of delays to try.
_DELAYS = 7
#: Eigenvalue of XᵀX, relative to the largest, below which a direction is undetermined.
_RANK = 1e-12
#: Fraction of a column's direction that may be undetermined by rounding.
_WHOLE = 1e-6
#: Fraction of a regressor's square that others must leave: what a model lacks would otherwise be
#: taken for it, magnified. Excitations leave 13 % or more; a boat on a zigzag course, under 2 %.
_INDEPENDENT = 0.04
#: Probability of a wrong claim that commands explain the motion, over all delays and windows tried.
LEVEL = 1e-3
#: All windows but the last, and all but the first.
_FIRST, _LATER = slice(-1), slice(1, None)
#: Statistical power that a recommended flight should have: the normal quantile of 90 %.
_POWER = 1.2816


@dataclass(frozen=True, eq=False)
class _FTest:
    """One regression and its F test."""

    slope: Float[np.ndarray, " k"]
    error: Float[np.ndarray, " k"]
    explained: float
    #: Logarithm of the p-value.
    log_p: float
    #: Noncentrality of F if the slopes are as stated.
    stated: float
    #: Fraction of each column's square that neither nuisance nor other columns reproduce.
    alone: Float[np.ndarray, " k"]

    @classmethod
    def of(
        cls,
        columns: Float[np.ndarray, "M k"],
        values: Float[np.ndarray, " M"],
        nuisance: Float[np.ndarray, "M c"],
        stated: Float[np.ndarray, " k"],
        count: int,
    ) -> _FTest:
        """Regress values of `count` windows on columns and nuisance columns; test the columns."""
        basis, axes = np.linalg.qr(nuisance)[0], len(nuisance) // count
        squares = np.square(columns).sum(axis=0)
        columns = columns - basis @ (basis.T @ columns)
        values = values - basis @ (basis.T @ values)
        size, axes_of = np.linalg.eigh(columns.T @ columns)
        known = size > _RANK * max(squares.sum(), np.finfo(float).tiny)
        rank, directions = int(known.sum()), axes_of[:, known] / np.sqrt(size[known])
        slope = directions @ (directions.T @ (columns.T @ values))
        left = values - columns @ slope
        fitted = columns @ slope
        alike = _alike(left, axes) * _alike(fitted, axes)
        alike = max(alike, _alike(left * fitted, axes))
        grown = (1 + alike) / (1 - alike)
        degrees = len(values) / grown - basis.shape[1] - rank
        total, rest = float(values @ values), float(left @ left)
        variance = max(rest / max(degrees, 1.0), np.finfo(float).tiny)
        ratio = float(max(total - rest, 0.0) / max(rank, 1) / variance) if degrees > 0 else 0.0
        spread = variance * np.sum(directions**2, axis=1)
        # An effect is unknown if the data miss any part of its direction, as of idle motors.
        seen = np.sum(axes_of[:, known] ** 2, axis=1)
        error = np.where(seen > 1 - _WHOLE, np.sqrt(spread), np.inf)
        alone = np.where(np.isfinite(error), 1 / np.maximum(squares * spread / variance, 1.0), 0.0)
        free = len(values) - basis.shape[1]
        share = 1 - rest / max(free - rank, 1) / (total / free) if total > 0 else 0.0
        log_p = _log_p(ratio, rank, degrees) if rank and degrees > 0 else 0.0
        size = float(np.sum((columns @ stated) ** 2)) / variance
        return cls(slope, error, max(share, 0.0), log_p, size, alone)

    @property
    def independent_error(self) -> Float[np.ndarray, " k"]:
        """Standard errors, infinite where other regressors explain nearly the same."""
        return np.where(self.alone > _INDEPENDENT, self.error, np.inf)


def _alike(values: Float[np.ndarray, " N"], axes: int) -> float:
    """Return the correlation of neighbouring windows, which slow disturbances leave."""
    parts = np.split(values, axes)
    before, after = (np.concatenate([part[end] for part in parts]) for end in (_FIRST, _LATER))
    size = float(values @ values)
    return float(np.clip(before @ after / size, 0.0, 0.9)) if size > 0 else 0.0


def _log_p(ratio: float, above: int, below: float) -> float:
    """Return the logarithm of the p-value of an F ratio, also where the p-value underflows.

    The tail is an incomplete beta integral; its leading term is exact in the limit.
    """
    from scipy.special import betaln, fdtrc

    p_value = float(fdtrc(above, below, ratio))
    if p_value > 1e-300:
        return float(np.log(p_value))
    a, b, rest = above / 2, below / 2, 1 / (1 + above * ratio / below)
    return float(b * np.log(max(rest, 1e-300)) - np.log(b) - betaln(a, b))


@dataclass(frozen=True, eq=False)
class WindowRegression:
    """The effects of thrusts that explain the motion best."""

    #: Acceleration in the body frame per newton of each motor: forward, left [1/kg], yaw
    #: [1/(kg m)]; and standard errors.
    effect: Float[np.ndarray, "3 n"]
    error: Float[np.ndarray, "3 n"]
    #: Fraction of the variance that thrusts explain, beyond chance: mean of forces and moments.
    explained: float
    #: Probability that chance explains as much, over all delays and windows that were tried.
    p_value: float
    #: Transport delay at which thrusts explain most [s].
    delay: float
    #: Length of the windows [s].
    length: float
    #: Logarithm of the probability that chance explains forces and moments as well.
    evidence: float
    #: Whether thrusts of each motor change independently of the others, and of the motion.
    independent: Bool[np.ndarray, " n"]
    #: Computes `floor`, for the best regression only.
    judge_floor: Callable[[], dict[str, Any]]
    #: The regression (of forces or of moments) that would show the stated effects more clearly.
    clearer: _FTest
    #: Factor by which the recording must be longer if the motors have the stated effects.
    longer: float = np.inf
    #: Coefficients of `tilt`, `dish` and `friction` in SI units; standard errors, infinite if
    #: thrusts or drag can explain nearly the same; and the accelerations that they cause [m/s²].
    floor: dict[str, Any] = field(default_factory=dict)


def regress_windows(
    trajectory: Trajectory,
    forces: Float[np.ndarray, "n N"],
    stated: Float[np.ndarray, "3 n"],
    longest_delay: float,
    *,
    before: bool = False,
) -> WindowRegression | None:
    """Regress the motion on thrusts, with the delay and windows that explain it most clearly.

    Parameters
    ----------
    trajectory : Trajectory
        The recording.
    forces : array, shape (n, N)
        Modelled thrust of each motor at the samples, without delay [N].
    stated : array, shape (3, n)
        Accelerations per thrust by the vehicle file, the configuration matrix [1/kg, 1/(kg m)].
    longest_delay : float
        Largest delay that is tried [s].
    before : bool, default False
        Whether motion before its cause is possible, as between disagreeing clocks.

    Returns
    -------
    WindowRegression or None
        Effects, delay and share explained; None if the recording has too few windows.
    """
    period = trajectory.sample_period
    last = round(longest_delay / period)
    step = -(-(last + 1) // _DELAYS)
    first = -last if before else 0

    def of(lengths: list[int], shifts: list[int]) -> list[WindowRegression]:
        return [
            found
            for samples in lengths
            for found in _of_length(trajectory, forces, stated, samples, shifts, last)
        ]

    tried = of(_window_lengths(period), list(range(first, last + 1, step)))
    if not tried:
        return None
    best = min(tried, key=lambda one: one.evidence)
    near = round(best.delay / period)
    tried += of(
        [round(best.length / period)], list(range(max(near - step + 1, first), near + step))
    )
    best = min(tried, key=lambda one: one.evidence)
    longer = _longer(best.clearer, LEVEL / len(tried))
    chance = min(1.0, best.p_value * len(tried))
    return replace(best, p_value=chance, longer=longer, floor=best.judge_floor())


def _window_lengths(period: float) -> list[int]:
    """Return the lengths to try, in samples."""
    doubled = _SHORTEST * 2.0 ** np.arange(np.log2(_LONGEST / _SHORTEST) + 0.5)
    return sorted({max(round(length / period), _FEWEST) for length in doubled.tolist()})


def _of_length(
    trajectory: Trajectory,
    forces: Float[np.ndarray, "n N"],
    stated: Float[np.ndarray, "3 n"],
    samples: int,
    shifts: list[int],
    last: int,
) -> Iterator[WindowRegression]:
    """Yield the regressions with one length of windows, for each delay."""
    starts = trajectory.window_starts(samples, samples)
    # The same windows for all delays, up to the last, and one step beyond.
    starts = starts[starts >= 2 * last]
    if shifts[0] < 0:
        starts = starts[starts + samples + 2 * last <= len(trajectory)]
    count, n, period = len(starts), len(forces), trajectory.sample_period
    if count < _PER_MOTOR * n + 1:
        return
    index = starts[:, None] + np.arange(samples)
    measured = _curvatures(trajectory.time[index], trajectory.state[index, :3])
    weight = (1 - np.linspace(-1, 1, samples) ** 2) ** 2
    weight /= weight.sum()
    yaw, both = trajectory.state[index, 2], measured[:, :2].T.reshape(-1)
    cos, sin = weight * np.cos(yaw), weight * np.sin(yaw)
    others = _other_columns(trajectory.state[index], weight)
    spinning = np.hstack([np.ones((count, 1)), trajectory.state[index, 5] @ weight[:, None]])
    for shift in shifts:
        force = forces[:, index - shift]
        along, across = (np.einsum("nmw,mw->mn", force, by) for by in (cos, sin))
        linear = np.block([[along, -across], [across, along]])
        turning = np.einsum("nmw,w->mn", force, weight)
        steady = np.hstack([others["tilt"], others["body"]])
        forward = _FTest.of(linear, both, steady, stated[:2].reshape(-1), count)
        spin = _FTest.of(turning, measured[:, 2], spinning, stated[2], count)
        apart = np.vstack([forward.independent_error.reshape(2, n), spin.independent_error])
        yield WindowRegression(
            effect=np.vstack([forward.slope.reshape(2, n), spin.slope]),
            error=np.vstack([forward.error.reshape(2, n), spin.error]),
            explained=(forward.explained + spin.explained) / 2,
            p_value=min(1.0, 2 * float(np.exp(min(forward.log_p, spin.log_p)))),
            delay=shift * period,
            length=samples * period,
            evidence=forward.log_p + spin.log_p,
            independent=np.isfinite(apart.min(axis=0)),
            judge_floor=partial(_floor, others, linear, both, count),
            clearer=max((forward, spin), key=lambda one: one.stated / len(one.slope)),
        )


def _floor(
    columns: dict[str, Float[np.ndarray, "M2 _"]],
    thrusts: Float[np.ndarray, "M2 n2"],
    values: Float[np.ndarray, " M2"],
    count: int,
) -> dict[str, Any]:
    """Return the floor's coefficients, their errors, and the size of their accelerations."""
    body, table = columns["body"], columns["tilt"]

    def tested(name: str, *nuisance: Float[np.ndarray, "M2 _"]) -> _FTest:
        none = np.zeros(columns[name].shape[1])
        return _FTest.of(columns[name], values, np.hstack([thrusts, *nuisance]), none, count)

    causes = {"tilt": (body,), "dish": (body, table), "friction": (body, table)}
    found = {name: tested(name, *causes[name]) for name in causes}
    floor = {name: (one.slope, one.independent_error) for name, one in found.items()}
    # Without drag a slope is known better, unless drag explains it as well.
    (tilt, error), steep = floor["tilt"], tested("tilt").slope
    floor |= {"tilt": (steep, error + np.abs(steep - tilt))}
    size = {name: float(np.linalg.norm(columns[name] @ one[0])) for name, one in floor.items()}
    return {name: (*one, size[name] / count**0.5) for name, one in floor.items()}


def _other_columns(
    state: Float[np.ndarray, "M W 6"], weight: Float[np.ndarray, " W"]
) -> dict[str, Float[np.ndarray, "M2 _"]]:
    """Return mean accelerations in x, then y, that are not thrusts, per coefficient.

    Constant forces along the body, and its drag, are no evidence of thrusts: in a feedback loop
    commands follow the motion.
    """
    x, y = np.einsum("mwi,w->im", state[..., :2], weight)
    cos, sin, velocity = np.cos(state[..., 2]), np.sin(state[..., 2]), state[..., 3:5]
    axes = np.array([np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)])
    pushes = *axes, *(axes * np.sum(axes * velocity, axis=-1)[..., None])
    direction = velocity / np.sqrt(np.sum(velocity**2, axis=-1) + CREEP**2)[..., None]
    none = np.zeros_like(x)
    return {
        "body": np.stack([np.einsum("mwi,w->im", p, weight).reshape(-1) for p in pushes], axis=1),
        "tilt": GRAVITY * np.kron(np.eye(2), np.ones((len(x), 1))),
        "dish": GRAVITY * np.hstack([[x, none, y], [none, y, x]]).T,
        "friction": -np.einsum("mwi,w->im", direction, weight).reshape(-1, 1),
    }


def _curvatures(
    time: Float[np.ndarray, "M W"], pose: Float[np.ndarray, "M W 3"]
) -> Float[np.ndarray, "M 3"]:
    """Return the second derivative of the parabola through the poses of each window."""
    middle = time.mean(axis=1, keepdims=True)
    half = (time[:, -1:] - time[:, :1]) / 2
    powers = polyvander((time - middle) / half, 2)
    moments, pose = np.swapaxes(powers, 1, 2), pose - pose[:, :1]
    # A pseudoinverse, since nearly all poses of a window may bear nearly the same time.
    inverse = np.linalg.pinv(moments @ powers, hermitian=True)
    return 2 * (inverse @ (moments @ pose))[:, 2] / half**2


def _longer(one: _FTest, level: float) -> float:
    """Return the factor by which a longer flight would reveal the stated effects.

    F times its degrees of freedom is approximately a noncentral χ², with mean k + λ and variance
    2 (k + 2 λ); λ grows with the duration.
    """
    from scipy.special import chdtri

    degrees = len(one.slope)
    needed = float(chdtri(degrees, level)) - degrees
    sizes = needed * 1.1 ** np.arange(60)
    found = sizes - _POWER * np.sqrt(2 * (degrees + 2 * sizes)) >= needed
    return float(sizes[np.argmax(found)] / max(one.stated, 1e-12))
