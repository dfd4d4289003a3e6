"""Covariance of fitted parameters that respects overlapping windows.

Windows that begin within one prediction length of each other share samples, and what no model
describes (a tilted table, air, flow between propellers) lasts longer still: residuals are far from
independent, and s²(JᵀJ)⁻¹ would be much too small. The sandwich estimator (White 1980; Liang and
Zeger 1986) needs only that blocks of time are nearly independent of each other. Scores are
corrected for the leverage of their block, which with a few dozen blocks and two dozen parameters
is the larger part (Bell and McCaffrey 2002; MacKinnon, Nielsen and Webb 2023).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.data.windows import Windows
from airpuck.identification.objective import BATCH, PredictionLoss, Quadratic
from airpuck.model.gauge import gauge_constraints
from airpuck.model.parameters import Parameters
from airpuck.model.uncertainty import Uncertainty
from airpuck.physics.thrust import thrust_slope

#: Eigenvalue of the information matrix, scaled to a unit diagonal and relative to the largest,
#: below which its direction is not determined: rounding leaves about 1e-15.
UNDETERMINED = 1e-11
#: A thrust curve whose slope is below this is held by its constraint [N]; that has 1e-6.
_FLAT = 1e-5
#: Largest leverage of a block: one that alone determines something would have 1.
_LEVERAGE = 0.999
#: Length of a block [s]. Neighbouring blocks share what reaches across their border
#: (`shared_at_borders`): shorter blocks share more, longer ones are too few in a minute of flight.
BLOCK = 2.0
#: A block is at least this many windows long, for the same reason.
_LENGTHS = 5


def cluster_windows(windows: Windows) -> Int[np.ndarray, " W"]:
    """Group windows into blocks of time."""
    trajectory, stride = _steps(windows)
    period = float(np.median(np.diff(windows.time)))
    span = max(BLOCK, _LENGTHS * period * (windows.encoder_length + windows.prediction_length))
    size = max(1, round(span / (stride * period)))
    # Whole batches, where that is near: half-filled ones would cost as much as full ones.
    if size > 0.75 * BATCH:
        size = BATCH * round(size / BATCH)
    clusters, first = np.zeros(len(windows), dtype=int), 0
    for number in np.unique(trajectory):
        members = np.flatnonzero(trajectory == number)
        for block in np.array_split(members, -(-len(members) // size)):
            clusters[block] = first
            first += 1
    return clusters


def shared_at_borders(loss: PredictionLoss) -> float:
    """Return the share of the scores' variance that blocks of windows miss at their borders.

    Scores of windows of length L that begin ℓ apart have the correlation 1 - ℓ/L where they begin,
    since that much of what disturbs them is common. Pairs across the ends of a block of length B
    are a share (2/B) ∫₀ᴸ ℓ (1 - ℓ/L) dℓ / L = L/(3 B) of all.
    """
    windows, clusters = loss.windows, loss.clusters
    assert clusters is not None
    blocks = int(clusters.max()) + 1
    trajectory, stride = _steps(windows)
    inside = np.diff(trajectory) == 0
    length = windows.encoder_length + windows.prediction_length
    borders = int(np.sum(inside & (np.diff(clusters) != 0) & (np.diff(windows.starts) < length)))
    return borders / blocks * length / (3 * max(stride * len(windows) / blocks, length))


def _steps(windows: Windows) -> tuple[Int[np.ndarray, " W"], float]:
    """Return the trajectory of each window, and the usual stride in samples."""
    trajectory = np.searchsorted(windows.origins, windows.starts, side="right")
    steps = np.diff(windows.starts)[np.diff(trajectory) == 0]
    return trajectory, float(np.median(steps)) if len(steps) else 1.0


@dataclass(frozen=True, eq=False)
class Subspace:
    """Directions in which an estimate can vary."""

    #: What the data determine and no constraint holds: θ = basis @ z. The information about z is
    #: about the identity.
    basis: Float[np.ndarray, "P R"]
    #: Orthonormal directions without information.
    undetermined: Float[np.ndarray, "K P"]
    #: Free entries that constraints hold where they are.
    held: Bool[np.ndarray, " P"]


def subspace(
    hessian: Float[np.ndarray, "P P"],
    free: Bool[np.ndarray, " P"],
    constraints: Float[np.ndarray, "C P"],
) -> Subspace:
    """Find the directions in which an estimate can vary."""
    scale = scaling(hessian, free)
    entries = np.diag(scale)[:, free]
    rows = constraints @ entries
    rows = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300)
    _, values, right = np.linalg.svd(rows, full_matrices=True)
    inside = entries @ right[int((values > 1e-9).sum()) :].T
    value, vector = np.linalg.eigh(inside.T @ hessian @ inside)
    known = value > UNDETERMINED * max(value.max(initial=0.0), 1e-300)
    reach = np.linalg.norm(inside / np.where(scale > 0, scale, 1.0)[:, None], axis=1)
    undetermined = np.linalg.qr(inside @ vector[:, ~known])[0].T
    # Rounding leaves a trace of every parameter in every direction.
    size = np.abs(undetermined) / np.where(scale > 0, scale, 1.0)
    large = size > 1e-6 * size.max(axis=1, initial=0.0, keepdims=True)
    return Subspace(
        basis=inside @ vector[:, known] / np.sqrt(value[known]),
        undetermined=np.where(large, undetermined, 0.0),
        held=free & (reach < 1e-6),
    )


def scaling(
    hessian: Float[np.ndarray, "P P"], free: Bool[np.ndarray, " P"]
) -> Float[np.ndarray, " P"]:
    """Return the scale of each parameter: what moves the loss by as much as any other's."""
    diagonal = np.diag(hessian)
    return np.where(free, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)


def binding_constraints(
    parameters: Parameters, free: Bool[np.ndarray, " P"]
) -> Float[np.ndarray, "C P"]:
    """Return the rows of the constraints that hold an estimate: bounds, and rising thrust."""
    vector = parameters.to_vector()
    lower, upper = parameters.bounds()
    rows = list(np.eye(len(vector))[free & ((vector <= lower) | (vector >= upper))])
    coefficients = np.asarray(parameters.thrust, dtype=float)
    n, degree = coefficients.shape
    power = np.arange(1, degree + 1)
    for motor in range(n):
        for speed in _flat_speeds(coefficients[motor : motor + 1]):
            row = np.zeros(len(vector))
            row[motor * degree : (motor + 1) * degree] = power * speed ** (power - 1)
            # A slope that no free coefficient changes constrains nothing.
            if (np.abs(row) * free).any():
                rows.append(row)
    return np.array(rows).reshape(-1, len(vector))


def varying(
    hessian: Float[np.ndarray, "P P"], parameters: Parameters, free: Bool[np.ndarray, " P"]
) -> Subspace:
    """Find the directions in which an estimate can vary along the constraints that hold it."""
    rows = [binding_constraints(parameters, free), gauge_constraints(parameters, free)]
    return subspace(hessian, free, np.concatenate(rows))


def _flat_speeds(curve: Float[np.ndarray, "1 degree"]) -> list[float]:
    """Return the ends and minima of F' where it has come down to its constraint."""
    degree = curve.shape[1]
    slope = np.polynomial.Polynomial(curve[0] * np.arange(1, degree + 1))
    stationary = slope.deriv().roots() if degree > 2 else np.zeros(0)
    inside = np.real(stationary[np.abs(np.imag(stationary)) < 1e-9])
    candidates = [0.0, 1.0, *(float(x) for x in inside if 0.02 < x < 0.98)]
    return [x for x in candidates if thrust_slope(curve, np.array([x]))[0] < _FLAT]


def sandwich(
    quadratic: Quadratic,
    parameters: Parameters,
    free: Bool[np.ndarray, " P"],
    constraints: Float[np.ndarray, "C P"] | None = None,
    gauge: Float[np.ndarray, "K P"] | None = None,
    shared: float = 0.0,
) -> Uncertainty:
    """Estimate the covariance of fitted parameters from the scores of independent clusters."""
    from scipy.special import stdtrit

    if constraints is None:
        constraints = binding_constraints(parameters, free)
    if gauge is None:
        gauge = gauge_constraints(parameters, free)
    vector, hessian = parameters.to_vector(), quadratic.hessian
    count, size = quadratic.scores.shape
    if count < 2 or not (np.isfinite(hessian).all() and np.isfinite(quadratic.scores).all()):
        reason = (
            "the data make up a single block of time: there is nothing to estimate errors from"
            if count < 2
            else "the loss or its derivatives are not finite at the optimum"
        )
        nothing = np.full(size, np.nan)
        return Uncertainty(
            vector, np.full((size, size), np.nan), nothing, np.zeros((0, size)), count, np.nan,
            (f"no standard errors: {reason}",),
        )  # fmt: skip
    space = subspace(hessian, free, np.concatenate([constraints, gauge]))
    change = _jackknife(
        quadratic.scores @ space.basis, space.basis.T @ quadratic.informations @ space.basis
    )
    factor = (count - 1) / count / (1 - shared)
    covariance = factor * space.basis @ (change.T @ change) @ space.basis.T
    covariance = (covariance + covariance.T) / 2
    # A part of a direction without information has no error by itself.
    unknown = ~free | space.held | (space.undetermined != 0).any(axis=0)
    return Uncertainty(
        estimate=vector,
        covariance=covariance,
        standard_errors=np.where(unknown, np.nan, np.sqrt(np.diag(covariance))),
        undetermined=space.undetermined,
        clusters=count,
        quantile=float(stdtrit(count - 1, 0.975)),
        notes=_notes(count, space, constraints),
    )


def widened(
    uncertainty: Uncertainty, entries: Bool[np.ndarray, " P"], variance: float
) -> Uncertainty:
    """Add an error of single parameters, independent of what clusters show."""
    known = entries & np.isfinite(uncertainty.standard_errors)
    added = np.where(known, variance, 0.0)
    return replace(
        uncertainty,
        covariance=uncertainty.covariance + np.diag(added),
        standard_errors=np.sqrt(uncertainty.standard_errors**2 + added),
    )


def grown(uncertainty: Uncertainty, factor: Float[np.ndarray, "P P"]) -> Uncertainty:
    """Multiply errors by a matrix."""
    covariance = factor @ uncertainty.covariance @ factor.T
    covariance = (covariance + covariance.T) / 2
    known = np.isfinite(uncertainty.standard_errors)
    errors = np.where(known, np.sqrt(np.diag(covariance)), np.nan)
    return replace(uncertainty, covariance=covariance, standard_errors=errors)


def _jackknife(
    scores: Float[np.ndarray, "G R"], hessian: Float[np.ndarray, "G R R"]
) -> Float[np.ndarray, "G R"]:
    """Return the change of the estimate when each cluster is left out; the Hessians add up to 1."""
    value, vector = np.linalg.eigh(hessian)
    turned = np.einsum("gij,gi->gj", vector, scores)
    return np.einsum("gij,gj->gi", vector, turned / (1 - np.minimum(value, _LEVERAGE)))


def _notes(count: int, space: Subspace, constraints: Float[np.ndarray, "C P"]) -> tuple[str, ...]:
    """Write the caveats of standard errors."""
    notes = []
    rank = space.basis.shape[1]
    if count <= rank:
        notes.append(
            f"{rank} parameters from {count} blocks of time: standard errors are rough, use a "
            "longer recording"
        )
    if len(constraints):
        notes.append(
            f"{len(constraints)} constraints bind (bounds, rising thrust): standard errors hold "
            "along them"
        )
    if len(space.undetermined):
        notes.append(
            f"the data do not determine {len(space.undetermined)} directions: the covariance is "
            "that of the others (pseudo-inverse)"
        )
    return tuple(notes)
