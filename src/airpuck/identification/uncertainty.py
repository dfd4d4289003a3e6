"""The parameters that the data determine, and a covariance that respects overlapping windows.

Windows that begin within one prediction length of each other share samples, and unmodelled effects
(a tilted table, air, flow between propellers) last even longer. Residuals are therefore far from
independent, and s²(JᵀJ)⁻¹ would be much too small. The sandwich estimator (White 1980; Liang and
Zeger 1986) only needs blocks of time that are nearly independent of each other. Scores are
corrected for the leverage of their block; with a few dozen blocks and two dozen parameters this is
the larger part (Bell and McCaffrey 2002; MacKinnon, Nielsen and Webb 2023). So few blocks cannot
determine a covariance well: it is shrunk towards the covariance of equal, independent residuals, as
far as its own scatter says (Ledoit and Wolf, Journal of Multivariate Analysis 88, 2004).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.results import Result
from airpuck.data.windows import Windows
from airpuck.identification.objective import BATCH, PredictionLoss, Quadratic
from airpuck.model.parameters import LAG, Parameters, gauge_constraints, gauge_directions
from airpuck.model.uncertainty import Uncertainty
from airpuck.physics.thrust import FLAT, slope_rows, thrust_slope

#: Eigenvalue of the information matrix, scaled to a unit diagonal and relative to the largest,
#: below which its direction is undetermined: rounding leaves about 1e-15.
UNDETERMINED = 1e-11
#: Curvature of the loss, relative to the largest, below which a parameter has no influence. Units
#: differ by less; a lag much shorter than the sample period leaves 1e-200.
_INFLUENCE = 1e-24
#: Largest leverage of a block; a block that alone determines a direction has leverage 1.
_LEVERAGE = 0.999
#: Length of a block [s]. Neighbouring blocks share the windows that cross their border
#: (`shared_at_borders`): shorter blocks share more, longer ones are too few in a minute of flight.
BLOCK = 2.0
#: A block is at least this many windows long, for the same reason.
_LENGTHS = 5
#: Correlation above which two parameters are hard to separate.
_ALIKE = 0.95
#: Component of a direction, relative to its largest, above which a parameter is named.
_MAIN = 0.5
#: Largest number of parameters to name at once.
_NAMED = 4
#: Error, relative to the largest value of its kind, above which a parameter without bounds is
#: undetermined.
_HOPELESS = 100.0
#: Factor by which a nonlinear interval of the motor lag must be wider than the linear one to
#: replace it.
_BENT = 1.1
#: Condition number of the scaled information above which a fit counts as poorly determined: a
#: factor of 1000 between the standard errors of its best and its worst direction.
_POOR = 1e6


def cluster_windows(windows: Windows, fewest: int = 1) -> Int[np.ndarray, " W"]:
    """Group windows into at least `fewest` blocks of time, none shorter than a window."""
    trajectory, stride = _steps(windows)
    period = float(np.median(np.diff(windows.time)))
    length = period * (windows.encoder_length + windows.prediction_length)
    size = max(1, round(max(BLOCK, _LENGTHS * length) / (stride * period)))
    # Use whole batches if that length is close: half-filled ones would cost as much as full ones.
    if size > 0.75 * BATCH:
        size = BATCH * round(size / BATCH)
    size = min(size, max(len(windows) // fewest, math.ceil(length / (stride * period))))
    clusters, first = np.zeros(len(windows), dtype=int), 0
    for number in np.unique(trajectory):
        members = np.flatnonzero(trajectory == number)
        for block in np.array_split(members, -(-len(members) // size)):
            clusters[block] = first
            first += 1
    return clusters


def shared_at_borders(loss: PredictionLoss) -> float:
    """Return the fraction of the scores' variance that blocks of windows miss at their borders.

    Scores of windows of length L that begin ℓ apart have the correlation 1 - ℓ/L, since they share
    that much of the disturbances. Pairs across the ends of a block of length B are a fraction (2/B)
    ∫₀ᴸ ℓ (1 - ℓ/L) dℓ / L = L/(3 B) of all.
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

    #: Directions that the data determine and no constraint fixes: θ = basis @ z. The information
    #: about z is close to the identity.
    basis: Float[np.ndarray, "P R"]
    #: Orthonormal directions without information.
    undetermined: Float[np.ndarray, "K P"]
    #: Entries without an error of their own: they are not free, fixed by constraints, or part of a
    #: direction without information.
    unknown: Bool[np.ndarray, " P"]
    #: Number of active bounds and thrust-curve constraints.
    binding: int = 0


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
        unknown=~free | (reach < 1e-6) | large.any(axis=0),
    )


def scaling(
    hessian: Float[np.ndarray, "P P"], free: Bool[np.ndarray, " P"]
) -> Float[np.ndarray, " P"]:
    """Return the scale of each parameter, chosen so that all have the same effect on the loss.

    A parameter without influence keeps its unit.
    """
    diagonal = np.diag(hessian)
    least = _INFLUENCE * diagonal[free].max(initial=0.0)
    return np.where(free, 1 / np.sqrt(np.where(diagonal > least, diagonal, 1.0)), 0.0)


def spectrum(
    information: Float[np.ndarray, "R R"], unknown: float = UNDETERMINED
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, "R K"], Float[np.ndarray, " R"]]:
    """Return eigenvalues above `unknown`, and their vectors, of a matrix scaled to a unit diagonal.

    Also return the scale; 0 where the diagonal is 0.
    """
    diagonal = np.diag(information)
    scale = np.divide(1.0, np.sqrt(diagonal), out=np.zeros(len(diagonal)), where=diagonal > 0)
    value, vector = np.linalg.eigh(information * np.outer(scale, scale))
    known = value > unknown * max(value.max(initial=0.0), 1e-300)
    return value[known], vector[:, known], scale


def inverted(
    information: Float[np.ndarray, "R R"], unknown: float = UNDETERMINED
) -> Float[np.ndarray, "R R"]:
    """Invert information on its range, regardless of the units."""
    if not np.isfinite(information).all():
        return np.full_like(information, np.nan)
    value, vector, scale = spectrum(information, unknown)
    return (vector / value @ vector.T) * np.outer(scale, scale)


def binding_constraints(
    parameters: Parameters, free: Bool[np.ndarray, " P"]
) -> Float[np.ndarray, "C P"]:
    """Return the rows of the active constraints: bounds, and rising thrust."""
    vector = parameters.to_vector()
    lower, upper = parameters.bounds()
    # A step onto a bound may miss it by a rounding error.
    at_bound = np.isclose(vector, lower, 1e-9, 0) | np.isclose(vector, upper, 1e-9, 0)
    at_bounds = np.eye(len(vector))[free & (at_bound | (vector < lower) | (vector > upper))]
    curves = np.asarray(parameters.thrust, dtype=float)
    points = [(k, speed) for k in range(len(curves)) for speed in _flat_speeds(curves[k : k + 1])]
    rows = slope_rows(free[: curves.size].reshape(curves.shape), points)
    return np.concatenate([at_bounds, np.pad(rows, [(0, 0), (0, len(vector) - curves.size)])])


def varying(
    hessian: Float[np.ndarray, "P P"], parameters: Parameters, free: Bool[np.ndarray, " P"]
) -> Subspace:
    """Find the directions in which an estimate can vary along its active constraints."""
    binding, gauge = binding_constraints(parameters, free), gauge_constraints(parameters, free)
    known = hessian if np.isfinite(hessian).all() else np.zeros_like(hessian)
    return replace(subspace(known, free, np.concatenate([binding, gauge])), binding=len(binding))


def _flat_speeds(curve: Float[np.ndarray, "1 degree"]) -> list[float]:
    """Return the ends and minima of F' where the thrust constraints are active."""
    degree = curve.shape[1]
    slope = np.polynomial.Polynomial(curve[0] * np.arange(1, degree + 1))
    stationary = slope.deriv().roots() if degree > 2 else np.zeros(0)
    inside = np.real(stationary[np.abs(np.imag(stationary)) < 1e-9])
    candidates = [0.0, 1.0, *(float(x) for x in inside if 0.02 < x < 0.98)]
    return [x for x in candidates if thrust_slope(curve, np.array([x]))[0] < FLAT]


def sandwich(
    quadratic: Quadratic, parameters: Parameters, space: Subspace, shared: float = 0.0
) -> Uncertainty:
    """Estimate the covariance of fitted parameters from the scores of independent clusters.

    `space` contains the directions in which they can vary; `shared` is the result of
    `shared_at_borders`.
    """
    from scipy.special import stdtrit

    vector, hessian = parameters.to_vector(), quadratic.hessian
    count, size = quadratic.scores.shape
    if count < 2 or not (np.isfinite(hessian).all() and np.isfinite(quadratic.scores).all()):
        reason = (
            "the data are a single block of time, too few to estimate errors from"
            if count < 2
            else "the loss or its derivatives are not finite at the optimum"
        )
        nothing, warnings = np.full((size, size), np.nan), (f"no standard errors: {reason}",)
        return Uncertainty(
            vector, nothing, nothing[0], np.zeros((0, size)), count, np.nan, warnings, warnings
        )
    # Change of the estimate when each cluster is left out; the Hessians add up to 1.
    value, vectors = np.linalg.eigh(space.basis.T @ quadratic.informations @ space.basis)
    turned = np.einsum("gij,gi->gj", vectors, quadratic.scores @ space.basis)
    turned /= 1 - np.minimum(value, _LEVERAGE)
    change = np.einsum("gij,gj->gi", vectors, turned)
    factor = (count - 1) / count / (1 - shared)
    covariance = factor * space.basis @ _shrunk(change) @ space.basis.T
    covariance = (covariance + covariance.T) / 2
    rank = space.basis.shape[1]
    rough = (
        f"{rank} parameters from {count} blocks of time: standard errors are rough; use a longer "
        "recording"
    )
    warnings = (rough,) if count <= rank else ()
    return Uncertainty(
        estimate=vector,
        covariance=covariance,
        standard_errors=np.where(space.unknown, np.nan, np.sqrt(np.diag(covariance))),
        undetermined=space.undetermined,
        clusters=count,
        quantile=float(stdtrit(count - 1, 0.975)),
        notes=(*warnings, *_notes(space)),
        warnings=warnings,
    )


def _shrunk(change: Float[np.ndarray, "G R"]) -> Float[np.ndarray, "R R"]:
    """Return the sum of the blocks' outer products, shrunk towards a multiple of the identity.

    In this basis equal, independent residuals give the identity. The weights minimise the expected
    square of the error, estimated from the scatter of the blocks.
    """
    count, size = change.shape
    total = change.T @ change
    alike = np.trace(total) / max(size, 1) * np.eye(size)
    scatter = np.sum(np.sum(change**2, axis=1) ** 2) - np.sum(total**2) / count
    share = min(scatter / max(float(np.sum((total - alike) ** 2)), 1e-300), 1.0)
    return share * alike + (1 - share) * total


def widened(
    uncertainty: Uncertainty, entries: Bool[np.ndarray, " P"], variance: float
) -> Uncertainty:
    """Add an error of single parameters that is independent of the clusters."""
    added = np.where(entries & np.isfinite(uncertainty.standard_errors), variance, 0.0)
    return _with_covariance(uncertainty, uncertainty.covariance + np.diag(added))


def with_held(
    uncertainty: Uncertainty, changes: Float[np.ndarray, "K P"], held: Bool[np.ndarray, " P"]
) -> Uncertainty:
    """Add the errors of values that a fit holds; `changes` are what one standard error causes."""
    errors = np.where(held, 0.0, uncertainty.standard_errors)
    wider = replace(uncertainty, standard_errors=errors)
    return _with_covariance(wider, uncertainty.covariance + changes.T @ changes)


def grown(uncertainty: Uncertainty, factor: Float[np.ndarray, "P P"]) -> Uncertainty:
    """Multiply errors by a matrix."""
    return _with_covariance(uncertainty, factor @ uncertainty.covariance @ factor.T)


def with_lag_squared(uncertainty: Uncertainty, parameters: Parameters) -> Uncertainty:
    """Widen the errors along the lag's trade-off with the delay, if it is far from linear.

    A step response of delay d and lag τ has the mean d + τ and the variance τ². Poses determine the
    mean well, and the lag by the variance alone: not τ but τ² has a symmetric interval. The errors
    of all parameters grow in proportion to how they change with the lag, so the error of d + τ
    barely changes.
    """
    tau, lag = float(parameters.motor_time_constant), parameters.mask(LAG)
    error = float(uncertainty.standard_errors[lag][0])
    reach = uncertainty.quantile * error
    if not (np.isfinite(reach) and reach > 0 and tau > 0):
        return uncertainty
    ends = np.sqrt(np.maximum(tau**2 + 2 * tau * reach * np.array([-1, 1]), 0.0))
    ratio = float(np.abs(ends - tau).max()) / reach
    if ratio < _BENT:
        return uncertainty
    along = uncertainty.covariance[:, lag][:, 0] / error
    added = (ratio**2 - 1) * np.outer(along, along)
    return _with_covariance(uncertainty, uncertainty.covariance + added)


def information_growth(
    hessian: Float[np.ndarray, "P P"],
    added: Float[np.ndarray, "P P"],
    basis: Float[np.ndarray, "P R"],
) -> Float[np.ndarray, "P P"]:
    """Return (H + added)⁻¹ H, the correction of errors that were computed from H alone."""
    return basis @ np.linalg.inv(basis.T @ (hessian + added) @ basis) @ basis.T @ hessian


def without_meaningless(uncertainty: Uncertainty, parameters: Parameters) -> Uncertainty:
    """Count parameters as undetermined whose errors exceed the range of values they may take.

    Quantities that depend on them then have no standard error either, instead of an absurd one.
    """
    lower, upper = parameters.bounds()
    sizes = {q.name: np.max(np.abs(getattr(parameters, q.name))) for q in parameters.quantities}
    size = _HOPELESS * parameters.laid_out(sizes, 0.0)
    # Bounds of positive numbers only exclude nonsense.
    known = np.isfinite(upper - lower) & (lower <= 0)
    extent = np.where(known, upper - lower, size)
    meaningless = np.sqrt(np.diag(uncertainty.covariance)) > np.where(extent > 0, extent, np.inf)
    if not meaningless.any():
        return uncertainty
    keep = ~meaningless
    return replace(
        uncertainty,
        covariance=uncertainty.covariance * np.outer(keep, keep),
        standard_errors=np.where(meaningless, np.nan, uncertainty.standard_errors),
        undetermined=np.concatenate([uncertainty.undetermined, np.eye(len(keep))[meaningless]]),
    )


def _with_covariance(uncertainty: Uncertainty, covariance: Float[np.ndarray, "P P"]) -> Uncertainty:
    """Replace the covariance, and the standard errors with it."""
    covariance = (covariance + covariance.T) / 2
    known = np.isfinite(uncertainty.standard_errors)
    errors = np.where(known, np.sqrt(np.diag(covariance)), np.nan)
    return replace(uncertainty, covariance=covariance, standard_errors=errors)


def _notes(space: Subspace) -> list[str]:
    """Write the caveats of standard errors."""
    notes = []
    if space.binding:
        notes.append(
            f"binding constraints (bounds, rising thrust): {space.binding}; standard errors hold "
            "along them"
        )
    if len(space.undetermined):
        notes.append(
            f"the data do not determine {len(space.undetermined)} directions: the covariance "
            "covers the others (pseudo-inverse)"
        )
    return notes


@dataclass(frozen=True)
class Identifiability(Result):
    """The parameters and combinations that the data determine."""

    JSON = "free rank condition weakest correlated notes"

    #: Number of free parameters.
    free: int
    #: Number of combinations of parameters that the data determine.
    rank: int
    #: Condition number of the information on these combinations, scaled to a unit diagonal.
    condition: float
    #: Main parameters of the weakest direction that is still determined.
    weakest: tuple[str, ...]
    #: Pairs whose estimates correlate by more than 0.95 in absolute value, by the information
    #: alone.
    correlated: tuple[tuple[str, str, float], ...]
    #: Sentences on parameters that are undetermined or hard to separate.
    notes: tuple[str, ...]


def identifiability_of(
    hessian: Float[np.ndarray, "P P"],
    parameters: Parameters,
    free: Bool[np.ndarray, " P"],
    propellers: tuple[str, ...],
) -> Identifiability:
    """Return which combinations of the free parameters an information matrix determines.

    This holds before a fit as well as after: directions without information cannot be learned from
    these data.
    """
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
    covariance = vector[:, known] / value[known] @ vector[:, known].T
    spread = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(spread, spread).clip(1e-300)
    # Of others the data determine only combinations.
    alone = np.abs(undetermined).max(axis=1, initial=0.0) < 1e-6
    alike = np.outer(alone, alone) & (np.abs(correlation) > _ALIKE)
    rows, columns = np.nonzero(np.triu(alike, 1))
    pairs = [
        (labels[i], labels[j], float(correlation[i, j])) for i, j in zip(rows, columns, strict=True)
    ]
    if pairs:
        first, second, size = max(pairs, key=lambda pair: abs(pair[2]))
        notes.append(
            f"pairs of parameters that correlate by more than {_ALIKE}: {len(pairs)}, most {first} "
            f"and {second} ({size:.3f}); a combination of both is known better than either"
        )
    return Identifiability(len(labels), rank, condition, weakest, tuple(pairs), tuple(notes))


def _main(direction: Float[np.ndarray, " F"], labels: list[str]) -> tuple[str, ...]:
    """Name the main parameters of a direction, the largest first."""
    size = np.abs(direction)
    order = np.argsort(-size)[:_NAMED].tolist()
    return tuple(labels[k] for k in order if size[k] >= _MAIN * size.max())


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
    notes += [f"the data contain no information about {labels[k]}" for k in silent.tolist()]
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
    """Return an orthonormal basis of a space of directions, minus those already explained."""
    rest = directions - explained @ (explained.T @ directions)
    left, size, _ = np.linalg.svd(rest, full_matrices=False)
    return left[:, size > 1e-3]
