"""Which parameters the data determine, in numbers and words.

The information matrix JᵀJ at a point tells, before a fit as after one: directions without
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
    """Which parameters of a model data determine."""

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
    #: What is not determined, or hard to tell apart, in sentences.
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
    """Tell which combinations of the free parameters an information matrix determines."""
    labels = np.array(parameters.labels(propellers))[free].tolist()
    scale = scaling(hessian, free)
    information = (hessian * scale * scale[:, None])[np.ix_(free, free)]
    if not labels or not np.isfinite(information).all():
        return Identifiability(len(labels), 0, float("inf"), (), (), ("no information",))
    value, vector = np.linalg.eigh(information)
    known = value > UNDETERMINED * max(value[-1], 1e-300)
    rank, undetermined = int(known.sum()), vector[:, ~known]
    gauges = {}
    for motor, direction in gauge_directions(parameters, free).items():
        scaled = direction[free] / scale[free]
        gauges[propellers[motor]] = scaled / np.linalg.norm(scaled)
    notes = _undetermined_notes(undetermined, labels, gauges)
    condition = float(value[-1] / value[known][0]) if rank else float("inf")
    weakest = _main(vector[:, known][:, 0], labels) if rank else ()
    if condition > _POOR:
        notes.append(f"poorly determined: {', '.join(weakest)} trade off against each other")
    correlation = _correlation(vector[:, known], value[known], undetermined)
    rows, columns = np.nonzero(np.triu(np.abs(correlation) > _ALIKE, 1))
    pairs = [
        (labels[i], labels[j], float(correlation[i, j])) for i, j in zip(rows, columns, strict=True)
    ]
    notes += _lag_against_delay(correlation, labels)
    if pairs:
        first, second, size = max(pairs, key=lambda pair: abs(pair[2]))
        notes.append(
            f"{len(pairs)} pairs of parameters correlate by more than {_ALIKE}, most {first} and "
            f"{second} ({size:.3f}): judge what they make up together, such as a thrust curve"
        )
    return Identifiability(len(labels), rank, condition, weakest, tuple(pairs), tuple(notes))


def _main(direction: Float[np.ndarray, " F"], labels: list[str]) -> tuple[str, ...]:
    """Name the main parameters of a direction, the largest first."""
    size = np.abs(direction)
    order = np.argsort(-size)[:_NAMED].tolist()
    return tuple(labels[k] for k in order if size[k] >= _MAIN * size.max())


def _correlation(
    vector: Float[np.ndarray, "F R"],
    value: Float[np.ndarray, " R"],
    undetermined: Float[np.ndarray, "F K"],
) -> Float[np.ndarray, "F F"]:
    """Return the correlation of the estimates; zero where data determine combinations only."""
    covariance = vector / value @ vector.T
    spread = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(spread, spread).clip(1e-300)
    alone = np.abs(undetermined).max(axis=1, initial=0.0) < 1e-6
    return np.where(np.outer(alone, alone), correlation, 0.0)


def _lag_against_delay(correlation: Float[np.ndarray, "F F"], labels: list[str]) -> list[str]:
    """Tell how motor lag and transport delay trade off: both shift every response."""
    names = ("motor_time_constant", "transport_delay")
    if not set(names) <= set(labels):
        return []
    size = float(correlation[labels.index(names[0]), labels.index(names[1])])
    if abs(size) < _TRADED:
        return []
    return [
        f"motor lag and transport delay trade off (correlation {size:.3f}): the data know their "
        "sum better than either; only how a response is rounded tells them apart"
    ]


def _undetermined_notes(
    undetermined: Float[np.ndarray, "F K"],
    labels: list[str],
    gauges: Mapping[str, Float[np.ndarray, " F"]],
) -> list[str]:
    """Name what the data do not determine: products, single parameters, other combinations."""
    notes, left, named = [], undetermined, []
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
    """Return an orthonormal basis of a space of directions, less those that are explained."""
    rest = directions - explained @ (explained.T @ directions)
    left, size, _ = np.linalg.svd(rest, full_matrices=False)
    return left[:, size > 1e-3]
