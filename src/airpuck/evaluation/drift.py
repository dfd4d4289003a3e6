"""Changes between two models of one craft: each quantity relative to its standard errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result
from airpuck.deviation.significance import holm
from airpuck.evaluation.presentation import MainQuantity, at_bounds, main_quantities
from airpuck.model.model_file import Model
from airpuck.physics.thrust import FLAT, lowest_slope

#: Chance of any false alarm among all quantities.
LEVEL = 0.05
#: Correlation above which a quantity absorbs what another cannot because it is at its bound: its
#: error there is too small by the factor √(1 − ρ²), 13 % at this correlation.
_TAKES_UP = 0.5


@dataclass(frozen=True)
class Change(Result):
    """One quantity in two models."""

    JSON = (
        "label=quantity.label unit=quantity.unit before after standard_error z p_value held moved"
    )

    quantity: MainQuantity
    #: Values in the earlier and the later model.
    before: float
    after: float
    #: Standard error of the difference.
    standard_error: float
    #: Difference divided by its standard error.
    z: float
    #: Two-sided, by Student's t with Welch and Satterthwaite's degrees of freedom, adjusted for the
    #: number of quantities (Holm).
    p_value: float
    #: Whether a bound or a flat thrust curve fixes it in one of the models. Its error there applies
    #: along the constraint, and is too small for a comparison.
    held: bool = False

    @property
    def differs(self) -> bool:
        """Whether the difference exceeds what the standard errors explain."""
        return self.p_value < LEVEL

    @property
    def moved(self) -> bool:
        """Whether it changed by more than chance explains."""
        return self.differs and not self.held

    @property
    def verdict(self) -> str:
        """One sentence."""
        by, error = abs(self.after - self.before), self.standard_error
        way = "rose" if self.after > self.before else "fell"
        amount = f"{by:.2g} ± {error:.1g} {self.quantity.unit}"
        if self.quantity.positive and self.before > 0:
            amount = f"{100 * by / self.before:.1f} % ± {100 * error / self.before:.1f} %"
        return f"{self.quantity.words} {way} by {amount} (z = {self.z:.1f})"


@dataclass(frozen=True)
class Drift(Result):
    """Two models of one craft.

    Attributes
    ----------
    changes : tuple of Change
        Quantities that both models learned with a known error.
    notes : tuple of str
        Caveats.

    Examples
    --------
    >>> found = airpuck.drift(fit.model, fit.model)
    >>> isinstance(found, airpuck.Drift), any(change.moved for change in found.changes)
    (True, False)
    """

    JSON = "verdicts notes changes"

    changes: tuple[Change, ...]
    notes: tuple[str, ...]

    @property
    def verdicts(self) -> list[str]:
        """Sentences on the quantities that moved, most significant first; empty without any."""
        if not self.changes:
            return []
        moved = sorted((c for c in self.changes if c.moved), key=lambda c: -abs(c.z))
        if moved:
            return [change.verdict for change in moved]
        judged = [change for change in self.changes if not change.held]
        if not judged:
            return [
                "nothing can be judged: constraints fix all quantities that both models learned"
            ]
        widest = max(judged, key=lambda change: abs(change.z))
        return [
            f"nothing moved: of {len(judged)} quantities {widest.quantity.words} changed most, "
            f"by {abs(widest.z):.1f} standard errors"
        ]


def drift(earlier: Model, later: Model) -> Drift:
    """Compare two models of one craft.

    Parameters
    ----------
    earlier, later : Model
        Both learned here, so that their uncertainty is known, from different recordings.

    Returns
    -------
    Drift
        Every quantity that both determined.

    Raises
    ------
    InputError
        If the craft differ, or no common quantity has known errors.

    Examples
    --------
    >>> airpuck.drift(fit.model, fit.model).verdicts[0].partition(":")[0]
    'nothing moved'
    """
    from scipy.special import stdtr

    if earlier.vehicle.propeller_names != later.vehicle.propeller_names:
        raise InputError("the models are of craft with different propellers", field="MODEL")
    found, p_values = [], []
    for quantity in main_quantities(earlier, speeds=(0.5, 1.0)):
        if not all(quantity.used(m) and quantity.learned(m) for m in (earlier, later)):
            continue
        errors = np.array([float(m.standard_error(quantity.value)) for m in (earlier, later)])
        if not (np.isfinite(errors).all() and (errors > 0).all()):
            continue
        before, after = (float(quantity.value(m)) for m in (earlier, later))
        joint = float(np.hypot(*errors))
        z = (after - before) / joint
        p_values.append(2 * stdtr(_degrees(errors, earlier, later), -abs(z)))
        found.append((quantity, before, after, joint, z))
    if not found:
        raise InputError(
            "no learned quantity has known errors in both models; identify both with "
            "airpuck identify",
            field="MODEL",
        )
    changes = tuple(
        Change(
            *(q, before, after, joint, z, float(p)),
            held=_holds(earlier, later, q) or _holds(later, earlier, q),
        )
        for (q, before, after, joint, z), p in zip(found, holm(np.array(p_values)), strict=True)
    )
    return Drift(changes, (*_notes(earlier, later), *_held_notes(changes)))


def _holds(model: Model, other: Model, quantity: MainQuantity) -> bool:
    """Return whether a constraint of `model` fixes a quantity, or a parameter correlated with it.

    The correlation comes from the other model, where the same parameter is not at its bound.
    """
    if quantity.motor is not None:
        slopes, _ = lowest_slope(model.parameters.thrust)
        if slopes[quantity.motor] < FLAT:
            return True
    held = set(at_bounds(model)) - set(at_bounds(other))
    return any(abs(_correlation(other, quantity, label)) > _TAKES_UP for label in held)


def _correlation(model: Model, quantity: MainQuantity, label: str) -> float:
    """Return the correlation of the estimates of a quantity and a parameter, or 0."""
    labels = model.parameters.labels(model.vehicle.propeller_names)
    if label not in labels:
        return 0.0

    def both(m: Model) -> np.ndarray:
        return np.array([quantity.value(m), m.parameters.to_vector()[labels.index(label)]])

    errors = model.standard_error(both)
    if not (np.isfinite(errors).all() and (errors > 0).all()):
        return 0.0
    # The variance of the sum of two unit-variance variables is 2 + 2ρ.
    return float(model.standard_error(lambda m: (both(m) / errors).sum())) ** 2 / 2 - 1


def _held_notes(changes: Sequence[Change]) -> list[str]:
    """Return notes on differences that constraints may cause."""
    held = [f"{change.quantity.words} (z = {change.z:.1f})" for change in changes if change.held]
    if not any(change.held and change.differs for change in changes):
        return []
    return [
        f"not judged: {', '.join(held)}. A bound or a flat thrust curve holds them in one of the "
        "models, so that their errors are too small"
    ]


def _degrees(errors: np.ndarray, *models: Model) -> float:
    """Return the degrees of freedom of a difference (Welch 1947)."""
    degrees = np.maximum(np.array([m.known.clusters if m.known else 2 for m in models]) - 1, 1)
    variance = errors**2
    return float(variance.sum() ** 2 / np.sum(variance**2 / degrees))


def _notes(earlier: Model, later: Model) -> list[str]:
    """Describe what the standard errors do not account for."""
    notes = []
    if set(earlier.data.values()) & set(later.data.values()):
        notes.append("both models learned from some of the same files: errors are not independent")
    if earlier.name != later.name:
        notes.append(
            f"{earlier.name} and {later.name} have different terms: they may cause a difference"
        )
    delays = 1e3 * earlier.transport_delay, 1e3 * later.transport_delay
    learned = earlier.delay_learned and later.delay_learned
    if abs(delays[0] - delays[1]) > 0.05 and not learned:
        notes.append(
            f"the transport delay went from {delays[0]:.1f} to {delays[1]:.1f} ms: where it is "
            "found in whole samples, lag and inertia absorb the rest"
        )
    return notes
