"""One craft in several recordings: shared parameters, and parameters of each recording.

Each recording is fitted alone; near its optimum θᵢ its loss is quadratic, with the Hessian Hᵢ. The
shared parameters s and the parameters oᵢ of each recording minimise the sum of these losses,
Σᵢ eᵢᵀ Hᵢ eᵢ with eᵢ = θᵢ − (s, oᵢ). The result is linear in all θᵢ. So the fits' covariances
give its covariance, and the errors of the differences that show whether the recordings agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import stdtrit

from airpuck.boundary.arguments import chosen
from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory
from airpuck.identification.fit import identify
from airpuck.identification.fit_result import Fit
from airpuck.identification.objective import Quadratic
from airpuck.identification.problem import Exclusion
from airpuck.identification.uncertainty import inverted
from airpuck.model.model_file import Model, learns
from airpuck.model.parameters import Parameters
from airpuck.model.rungs import TERMS, Rung
from airpuck.model.sections import OfRecording
from airpuck.model.uncertainty import Uncertainty

#: Names for `each`, of which most are terms of a model, and their quantities.
_EACH = {
    "delay": "transport_delay",
    "lag": "motor_time_constant",
    "thrust": "thrust",
    "angle": "angle_offset",
    **TERMS,
}
#: Probability, for all shared parameters together, below which recordings disagree on one.
_DISAGREE = 1e-3
#: Directions in which a fit knows less than this fraction of the best known one count as unknown.
_UNKNOWN = 1e-12


def with_each(rung: Rung, each: Sequence[str]) -> tuple[Rung, frozenset[str]]:
    """Add the terms in `each` to a rung; return it, and the quantities of each recording."""
    for name in each:
        chosen(name, _EACH, "each")
        if name in TERMS and TERMS[name] not in rung.effects:
            rung = rung.with_term(name)
    return rung, frozenset(_EACH[name] for name in each)


def identify_each(
    trajectories: Sequence[Trajectory], rung: Rung, each: Sequence[str], **options: Any
) -> Fit:
    """Fit recordings of one craft that share all parameters but those named in `each`.

    The result is the last recording's; `Model.recordings` has all of them.
    """
    rung, own = with_each(rung, each)
    fits = [identify(one, rung, **options) for one in trajectories]
    last = fits[-1]
    free, mask = last.model.free, last.model.parameters.mask(own)
    for name in each:
        if not learns(last.model, _EACH[name]):
            problem = f"{name} is not learned from these recordings, so it cannot differ in them"
            raise InputError(problem, field="each")
    hessians = [fit.windows * _quadratic(fit, fit.model.parameters).hessian for fit in fits]
    joint = combined([fit.model for fit in fits], hessians, free & ~mask, free & mask)
    found = []
    for fit, vector, covariance in zip(fits, joint.vectors, joint.covariances, strict=True):
        parameters = fit.model.parameters.with_vector(vector)
        known = _uncertainty([one.model for one in fits], vector, covariance)
        found.append(OfRecording(fit.model.source, parameters, known))
    return _joined(fits, found, joint)


@dataclass(frozen=True, eq=False)
class Combined:
    """Parameters of several recordings."""

    #: Of each recording, with their covariances.
    vectors: list[Float[np.ndarray, " P"]]
    covariances: list[Float[np.ndarray, "P P"]]
    #: Largest difference of a shared parameter between a recording and all, in standard errors of
    #: it; and its index.
    apart: float
    entry: int


def combined(
    models: Sequence[Model],
    hessians: Sequence[Float[np.ndarray, "P P"]],
    shared: Bool[np.ndarray, " P"],
    own: Bool[np.ndarray, " P"],
) -> Combined:
    """Combine fits; `hessians` belong to their sums of squares."""
    learned, s, count = shared | own, int(shared.sum()), len(models)
    among = np.ix_(learned, learned)
    # The unknowns are the shared parameters, then those of each recording.
    common = shared[learned]
    places = np.empty((count, len(common)), dtype=int)
    places[:, common] = np.arange(s)
    places[:, ~common] = s + np.arange(count * own.sum()).reshape(count, -1)
    size = s + count * int(own.sum())
    picks = np.eye(size)[places]
    weights = np.array([hessian[among] for hessian in hessians])
    vectors = np.array([model.parameters.to_vector() for model in models])
    found = [model.uncertainty for model in models if model.uncertainty is not None]
    spreads = np.array([known.covariance[among] for known in found])
    normal = (picks.mT @ weights @ picks).sum(axis=0)
    inverse = inverted(normal, _UNKNOWN)
    # How the result moves with each estimate, whose covariances are known.
    moves = inverse @ picks.mT @ weights
    # Entries that nothing determines keep the last recording's values.
    start = np.append(vectors[-1, shared], vectors[:, own])
    solution = start + np.einsum("nup,np->u", moves, vectors[:, learned] - picks @ start)
    total = (moves @ spreads @ moves.mT).sum(axis=0)
    apart = np.zeros((count, s))
    for number in range(count):
        differences = -moves[:, :s]
        differences[number] += np.eye(len(common))[common]
        variance = np.sum(differences @ spreads * differences, axis=(0, 2))
        sure = variance > _UNKNOWN * np.diag(total)[:s]
        difference = np.abs(vectors[number, shared] - solution[:s])
        apart[number, sure] = difference[sure] / np.sqrt(variance[sure])
    vectors[:, learned] = picks @ solution
    covariances = np.zeros((count, len(learned), len(learned)))
    covariances[:, *among] = picks @ total @ picks.mT
    worst = int(apart.max(axis=0).argmax())
    entry = int(np.flatnonzero(shared)[worst])
    return Combined([*vectors], [*covariances], float(apart.max()), entry)


def _uncertainty(
    models: Sequence[Model], vector: Float[np.ndarray, " P"], covariance: Float[np.ndarray, "P P"]
) -> Uncertainty:
    """Return what all recordings together know about the parameters of one."""
    every = [model.uncertainty for model in models if model.uncertainty is not None]
    spread = np.sqrt(np.diag(covariance))
    clusters = sum(known.clusters for known in every)
    notes = tuple(dict.fromkeys(note for known in every for note in known.notes))
    quantile = float(stdtrit(max(clusters - 1, 1), 0.975))
    errors = np.where(spread > 0, spread, np.nan)
    nothing = np.zeros((0, len(vector)))
    return Uncertainty(vector, covariance, errors, nothing, clusters, quantile, notes)


def _joined(fits: Sequence[Fit], found: Sequence[OfRecording], joint: Combined) -> Fit:
    """Return one fit for all recordings."""
    last, here = fits[-1], found[-1]
    names = ", ".join(Path(one.source).name for one in found)
    warnings = list(dict.fromkeys(warning for fit in fits for warning in fit.warnings))
    entries = len(fits) * np.sum(last.model.free)
    fewest = min(one.model.uncertainty.clusters for one in fits if one.model.uncertainty)
    if joint.apart > -stdtrit(max(fewest - 1, 1), _DISAGREE / 2 / entries):
        label = last.model.parameters.labels(last.model.vehicle.propeller_names)[joint.entry]
        warnings.append(
            f"{names} do not agree on {label}: {joint.apart:.1f} standard errors apart; fit "
            "more parameters separately (each), or leave a recording out"
        )
    data = {key: digest for fit in fits for key, digest in fit.model.data.items()}
    model = replace(
        last.model,
        parameters=here.parameters,
        uncertainty=here.uncertainty,
        data=data,
        recordings=tuple(found),
    )
    left = [fit.exclusion for fit in fits if fit.exclusion is not None]
    exclusion = last.exclusion and Exclusion(
        tuple(one for part in left for one in part.trajectories),
        tuple(one for part in left for one in part.faults),
        sum(part.share for part in left) / len(left),
    )
    windows = [fit.windows for fit in fits]
    losses = [_quadratic(fit, one.parameters).loss for fit, one in zip(fits, found, strict=True)]
    return replace(
        last,
        model=model,
        loss=float(np.average(losses, weights=windows)),
        history=tuple(step for fit in fits for step in fit.history),
        converged=all(fit.converged for fit in fits),
        windows=sum(windows),
        wall_s=sum(fit.wall_s for fit in fits),
        warnings=tuple(warnings),
        exclusion=exclusion,
        packet_delays=tuple(one for fit in fits for one in fit.packet_delays),
    )


def _quadratic(fit: Fit, parameters: Parameters) -> Quadratic:
    """Return the loss of a recording at some parameters."""
    assert fit.objective is not None
    return fit.objective.quadratic(parameters)
