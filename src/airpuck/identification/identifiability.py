"""Which parameters the data determine, in words.

The information matrix JᵀJ at a point says it, before a fit as after one: directions without
information cannot be learned from these data, however long the optimiser runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.identification.uncertainty import UNDETERMINED, scaling
from airpuck.model.gauge import gauge_directions
from airpuck.model.parameters import Parameters

#: Correlation from which two parameters are hard to tell apart.
_ALIKE = 0.95
#: The same for motor lag and transport delay, of which one is so easily taken for the other.
_TRADED = 0.8
#: Part of a direction, relative to its largest, from which a parameter is named.
_MAIN = 0.5
#: Most parameters to name at once.
_NAMED = 4
#: Condition number of the scaled information from which a fit is said to be poorly determined: a
#: factor 1000 between the standard errors of its best and its worst direction.
_POOR = 1e6


@dataclass(frozen=True)
class Identifiability:
    """What data can say about the parameters of a model."""

    #: Number of free parameters.
    free: int
    #: How many combinations of them the data determine.
    rank: int
    #: Condition number of the information on these, scaled to a unit diagonal.
    condition: float
    #: Main parameters of the weakest direction that is determined.
    weakest: tuple[str, ...]
    #: Pairs whose estimates correlate by more than 0.95 in size, by the information alone.
    correlated: tuple[tuple[str, str, float], ...]
    #: What is not determined, and what is hard to tell apart.
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        condition = self.condition if np.isfinite(self.condition) else None
        return {**asdict(self), "condition": condition}


def identifiability_of(
    hessian: Float[np.ndarray, "P P"],
    parameters: Parameters,
    free: Bool[np.ndarray, " P"],
    propellers: tuple[str, ...],
) -> Identifiability:
    """Say what an information matrix determines."""
    labels = [label for label, is_free in zip(parameters.labels(propellers), free, strict=True)
              if is_free]  # fmt: skip
    scale = scaling(hessian, free)
    information = (hessian * scale * scale[:, None])[np.ix_(free, free)]
    if not labels or not np.isfinite(information).all():
        return Identifiability(len(labels), 0, float("inf"), (), (), ("no information",))
    value, vector = np.linalg.eigh(information)
    known = value > UNDETERMINED * max(value[-1], 1e-300)
    rank = int(known.sum())
    gauges = {}
    for motor, direction in gauge_directions(parameters, free).items():
        scaled = direction[free] / scale[free]
        gauges[propellers[motor]] = scaled / np.linalg.norm(scaled)
    notes = _undetermined_notes(vector[:, ~known], labels, gauges)
    condition = float(value[-1] / value[known][0]) if rank else float("inf")
    weakest = _main(vector[:, known][:, 0], labels) if rank else ()
    if condition > _POOR:
        notes.append(f"poorly determined: {', '.join(weakest)} trade off against each other")
    correlation = _correlation(vector[:, known], value[known], vector[:, ~known])
    pairs = _pairs(correlation, labels)
    notes += _lag_against_delay(correlation, labels)
    if pairs:
        first, second, size = max(pairs, key=lambda pair: abs(pair[2]))
        notes.append(
            f"{len(pairs)} pairs of parameters correlate by more than {_ALIKE}, most {first} and "
            f"{second} ({size:.3f}): judge what they make up together, such as a thrust curve"
        )
    return Identifiability(len(labels), rank, condition, weakest, pairs, tuple(notes))


def _main(direction: Float[np.ndarray, " F"], labels: list[str]) -> tuple[str, ...]:
    """Name the main parameters of a direction, the largest first."""
    size = np.abs(direction)
    order = np.argsort(-size)[:_NAMED].tolist()
    return tuple(labels[k] for k in order if size[k] >= _MAIN * size.max())


def _correlation(
    vector: Float[np.ndarray, "F R"],
    value: Float[np.ndarray, " R"],
    blind: Float[np.ndarray, "F K"],
) -> Float[np.ndarray, "F F"]:
    """Return the correlation of the estimates; zero for what the data do not determine alone."""
    covariance = vector / value @ vector.T
    own = np.abs(blind).max(axis=1, initial=0.0) < 1e-6
    spread = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(spread, spread).clip(1e-300)
    correlation[~own] = correlation[:, ~own] = 0.0
    return correlation


def _pairs(
    correlation: Float[np.ndarray, "F F"], labels: list[str]
) -> tuple[tuple[str, str, float], ...]:
    """List pairs of determined parameters whose estimates are hard to tell apart."""
    first, second = np.nonzero(np.triu(np.abs(correlation) > _ALIKE, 1))
    return tuple(
        (labels[i], labels[j], float(correlation[i, j]))
        for i, j in zip(first.tolist(), second.tolist(), strict=True)
    )


def _lag_against_delay(correlation: Float[np.ndarray, "F F"], labels: list[str]) -> list[str]:
    """Say how motor lag and transport delay trade off, which shift every response alike."""
    names = ("motor_time_constant", "transport_delay")
    if not all(name in labels for name in names):
        return []
    size = float(correlation[labels.index(names[0]), labels.index(names[1])])
    if abs(size) < _TRADED:
        return []
    return [
        f"motor lag and transport delay trade off (correlation {size:.3f}): the data know their "
        "sum better than either; only how a response is rounded tells them apart"
    ]


def _undetermined_notes(
    blind: Float[np.ndarray, "F K"],
    labels: list[str],
    gauges: Mapping[str, Float[np.ndarray, " F"]],
) -> list[str]:
    """Name what the data do not determine: products first, then what else there is."""
    notes, left, named = [], blind, []
    for name, direction in gauges.items():
        part = left.T @ direction
        if part @ part < 0.99:
            continue
        named.append(name)
        left = _without(left, direction[:, None])
    if named:
        notes.append(
            f"thrust and column of Π of {', '.join(named)} can only be determined as a product; "
            "their scale is fixed by Newton's law: a column's linear part has the length 1/m, and "
            "thrusts are in newtons"
        )
    silent = np.flatnonzero(np.linalg.norm(left, axis=1) > 1 - 1e-6)
    notes += [f"the data say nothing about {labels[k]}" for k in silent.tolist()]
    left = _without(left, np.eye(len(labels))[:, silent])
    rest = np.flatnonzero(np.linalg.norm(left, axis=1) > 0.1).tolist()
    if rest:
        notes.append(
            f"{left.shape[1]} combinations of {', '.join(labels[k] for k in rest)} are not "
            "determined"
        )
    return notes


def _without(
    directions: Float[np.ndarray, "F K"], explained: Float[np.ndarray, "F E"]
) -> Float[np.ndarray, "F L"]:
    """Return what is left of a space of directions without the ones that are explained."""
    rest = directions - explained @ (explained.T @ directions)
    left, size, _ = np.linalg.svd(rest, full_matrices=False)
    return left[:, size > 1e-3]
