"""Tests of whether residuals depend on speed, yaw rate, motor speed, position or time.

For each regressor, its range is divided into bins. The model's missing acceleration, constant
within a bin, follows from the innovations by regression. It is the mean of the residuals in that
bin, in m/s² and rad/s², as efficiently as innovations allow. A Wald test with a covariance from
blocks of time checks that all bins are alike.

Unmodelled effects of air or motors act along the body, as do effects that change with time
(batteries and motors). Unmodelled effects of the table, a tilt or a dent, act along the world's
axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.results import Result, plain
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.motor_regression import (
    accelerations_along,
    block_regression,
    body_accelerations,
)
from airpuck.deviation.significance import LEVEL, holm
from airpuck.evaluation.innovations import Innovations
from airpuck.evaluation.late_packets import LatePackets
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import to_body

#: Number of bins, with equally many samples each.
BINS = 6
#: Fraction of the motors' effect, as root mean squares, below which a dependence does not count.
LEAST_SHARE = 0.02
#: Length of a block [s], and the fewest blocks: in short flights they are shorter.
_BLOCK_S, _FEWEST_BLOCKS = 1.0, 15
#: Regressors, each with its unit and the frame in which its effect would act.
REGRESSORS = (
    ("forward speed", "m/s", "body"),
    ("left speed", "m/s", "body"),
    ("spin", "rad/s", "body"),
    ("motor speed", "–", "body"),
    ("time", "s", "body"),
    ("x", "m", "world"),
    ("y", "m", "world"),
)
_CHANNELS = {"body": ("forward", "left", "yaw"), "world": ("x", "y", "yaw")}


@dataclass(frozen=True, eq=False)
class Structure(Result):
    """Means of one channel's residuals over the bins of one regressor."""

    JSON = "regressor regressor_unit channel passed shown p_value share middle"

    regressor: str
    regressor_unit: str
    #: Direction of the residual: forward, left, yaw; or x, y, yaw.
    channel: str
    #: Boundaries of the bins, and their medians.
    edges: Float[np.ndarray, " B1"]
    middle: Float[np.ndarray, " B"]
    #: Missing acceleration of the model [m/s² or rad/s²], and half its 99 % band, pointwise.
    mean: Float[np.ndarray, " B"]
    half_band: Float[np.ndarray, " B"]
    #: Root mean square of the means about their mean, minus the effect of chance.
    size: float
    #: `size` relative to the motors' effect in this channel.
    share: float
    #: P-value for equal means, adjusted for all regressors and channels (Holm).
    p_value: float

    @property
    def unit(self) -> str:
        """Unit of the means."""
        return "rad/s²" if self.channel == "yaw" else "m/s²"

    @property
    def shown(self) -> bool:
        """Whether the means differ significantly, at the 1 % level."""
        return self.p_value < LEVEL

    @property
    def passed(self) -> bool:
        """Whether the dependence is insignificant, or too small to count."""
        return not self.shown or self.share < LEAST_SHARE

    @property
    def verdict(self) -> str:
        """One sentence on a significant dependence."""
        low, high = int(self.mean.argmin()), int(self.mean.argmax())
        ends = " to ".join(
            f"{self.mean[k]:.2g} {self.unit} near {self.middle[k]:.2g} {self.regressor_unit}"
            for k in (low, high)
        )
        but = "" if not self.passed else ", too little to count"
        return (
            f"{self.channel} residuals depend on {self.regressor}: {ends}; root mean square "
            f"{self.size:.2g} {self.unit}, {100 * self.share:.1f} % of what the motors do{but}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``size``, ``mean`` and ``half_band`` of the bins, with their unit as suffix.
        """
        unit = "rad_s2" if self.channel == "yaw" else "m_s2"
        sizes = {name: getattr(self, name) for name in ("size", "mean", "half_band")}
        return super().to_json() | {f"{name}_{unit}": plain(v) for name, v in sizes.items()}


@dataclass(frozen=True, eq=False)
class Bins:
    """Division of one regressor into bins."""

    name: str
    unit: str
    frame: str
    edges: Float[np.ndarray, " B1"]
    middle: Float[np.ndarray, " B"]
    #: Bin of each sample.
    member: Bool[np.ndarray, "N B"]


def cut(trajectory: Trajectory, found: Innovations) -> list[Bins]:
    """Divide the range of each regressor into bins with equally many used samples.

    Regressors are the values one sample earlier, as estimated by the innovations' filter. Otherwise
    both would contain the noise of the pose under test, which looks like structure in a slow
    flight.
    """
    before = np.concatenate([found.mean[:1], found.mean[:-1]])
    x, y, yaw = before[:, :, 0].T
    speeds = found.motor_speed.mean(axis=1)
    values = *to_body(before[:, :, 1], yaw).T, speeds, trajectory.time, x, y
    bins = []
    for (name, unit, frame), value in zip(REGRESSORS, values, strict=True):
        edges = np.unique(np.quantile(value[found.used], np.linspace(0, 1, BINS + 1)))
        if len(edges) < 3:
            continue
        which = np.clip(np.searchsorted(edges, value, side="right") - 1, 0, len(edges) - 2)
        member = which[:, None] == np.arange(len(edges) - 1)
        middle = np.array([np.median(value[found.used & column]) for column in member.T])
        bins.append(Bins(name, unit, frame, edges, middle, member))
    return bins


def missing_accelerations(
    bins: Sequence[Bins], state: Float[np.ndarray, "N 6"]
) -> Float[np.ndarray, "N 3 S"]:
    """Return 1 m/s² or rad/s² along each channel in each bin, in the world: possible errors."""
    turn = body_accelerations(state)
    axes = {"body": turn, "world": np.broadcast_to(np.eye(3), turn.shape)}
    parts = [np.einsum("nac,nb->nacb", axes[one.frame], one.member) for one in bins]
    return np.concatenate([part.reshape(len(state), 3, -1) for part in parts], axis=2)


def find_structure(
    model: Model,
    trajectory: Trajectory,
    found: Innovations,
    late: LatePackets,
    bins: Sequence[Bins],
    late_by: float,
) -> list[Structure]:
    """Test every regressor and channel; `late.others` holds the effects of `missing_accelerations`.

    A delay longer by `late_by` [s] than the model's is compensated first.
    """
    left = late.steady - late.directions[..., 0] * late_by
    modelled = _rms_of_model(model, trajectory, found)
    structures, first = [], 0
    for one in bins:
        size = 3 * one.member.shape[1]
        columns = late.others[found.used][:, :, first : first + size]
        first += size
        structures += _tested(one, columns, left[found.used], trajectory.sample_period, modelled)
    adjusted = holm(np.array([one.p_value for one in structures]))
    return [replace(one, p_value=float(p)) for one, p in zip(structures, adjusted, strict=True)]


def _tested(
    bins: Bins,
    columns: Float[np.ndarray, "M 3 S"],
    values: Float[np.ndarray, "M 3"],
    period: float,
    modelled: dict[str, float],
) -> list[Structure]:
    """Regress on the bins of one regressor, all three channels together."""
    from scipy.special import fdtrc, stdtrit

    count = bins.member.shape[1]
    length = min(_BLOCK_S, period * len(values) / _FEWEST_BLOCKS)
    mean, covariance, blocks = block_regression(columns, values, period, length)
    weight = np.full(count, 1 / count)
    contrast = np.eye(count)[1:] - weight
    found = []
    for k, channel in enumerate(_CHANNELS[bins.frame]):
        part = slice(k * count, (k + 1) * count)
        own, spread = mean[part], covariance[part, part]
        apart = contrast @ own
        statistic = float(apart @ np.linalg.pinv(contrast @ spread @ contrast.T) @ apart)
        # Hotelling's T², since a covariance from few blocks is uncertain.
        degrees, rest = count - 1, max(blocks - count + 1, 1)
        p_value = float(fdtrc(degrees, rest, statistic * rest / degrees / (blocks - 1)))
        center = np.eye(count) - weight
        square = np.mean((center @ own) ** 2) - np.trace(center @ spread @ center.T) / count
        size = float(np.sqrt(max(square, 0.0)))
        half = stdtrit(blocks - 1, 1 - LEVEL / 2) * np.sqrt(np.diag(spread))
        share = size / modelled[channel]
        figures = bins.edges, bins.middle, own, half, size, share, p_value
        found.append(Structure(bins.name, bins.unit, channel, *figures))
    return found


def _rms_of_model(model: Model, trajectory: Trajectory, found: Innovations) -> dict[str, float]:
    """Return the root mean square of the modelled accelerations in each channel."""
    state, speed = trajectory.state[found.used], found.motor_speed[found.used]
    world = accelerations_along(model.dynamics, state, speed)
    frames = {"body": to_body(world, state[:, 2]), "world": world}
    sizes = {frame: np.sqrt(np.mean(rates**2, axis=0)) for frame, rates in frames.items()}
    return {
        name: max(float(size), 1e-12)
        for frame, names in _CHANNELS.items()
        for name, size in zip(names, sizes[frame], strict=True)
    }
