"""What changed between two models of one craft: each quantity against its standard errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.evaluation.main_quantities import main_quantities
from airpuck.evaluation.statistical_tests import holm
from airpuck.model.model_file import Model

#: Chance of any false alarm among all quantities.
LEVEL = 0.05
#: What is written of a change.
_FIGURES = ("label", "unit", "before", "after", "standard_error", "z", "p_value", "moved")


@dataclass(frozen=True)
class Change:
    """One quantity in two models."""

    #: Which quantity.
    label: str
    words: str
    unit: str
    #: In the earlier and the later model.
    before: float
    after: float
    #: Of the difference.
    standard_error: float
    #: Difference over standard error.
    z: float
    #: Two-sided, by Student's t with Welch and Satterthwaite's degrees of freedom, adjusted for the
    #: number of quantities (Holm).
    p_value: float
    #: Whether a percentage says something.
    relative: bool

    @property
    def moved(self) -> bool:
        """Whether it changed by more than chance explains."""
        return self.p_value < LEVEL

    @property
    def verdict(self) -> str:
        """One sentence."""
        by, error = abs(self.after - self.before), self.standard_error
        way = "rose" if self.after > self.before else "fell"
        amount = f"{by:.2g} ± {error:.1g} {self.unit}"
        if self.relative and self.before > 0:
            amount = f"{100 * by / self.before:.1f} % ± {100 * error / self.before:.1f} %"
        return f"{self.words} {way} by {amount} (z = {self.z:.1f})"


@dataclass(frozen=True)
class Drift:
    """Two models of one craft.

    Attributes
    ----------
    changes : tuple of Change
        What both models learned and know the error of.
    notes : tuple of str
        What to know before believing it.
    """

    changes: tuple[Change, ...]
    notes: tuple[str, ...]

    @property
    def verdicts(self) -> list[str]:
        """Sentences: what moved, the surest first, or that nothing did; none without changes."""
        if not self.changes:
            return []
        moved = sorted((c for c in self.changes if c.moved), key=lambda c: -abs(c.z))
        if moved:
            return [change.verdict for change in moved]
        widest = max(self.changes, key=lambda change: abs(change.z))
        return [
            f"nothing moved: of {len(self.changes)} quantities the largest difference is that of "
            f"{widest.words}, {abs(widest.z):.1f} standard errors"
        ]

    def to_json(self) -> dict[str, Any]:
        """Return the figures.

        Returns
        -------
        dict
            ``verdicts``, ``notes`` and a list ``changes`` of ``label, unit, before, after,
            standard_error, z, p_value, moved``.
        """
        return {
            "verdicts": self.verdicts,
            "notes": list(self.notes),
            "changes": [{name: getattr(c, name) for name in _FIGURES} for c in self.changes],
        }


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
        If they are of different crafts, or have no quantity in common whose errors are known.
    """
    from scipy.stats import t

    if earlier.vehicle.propeller_names != later.vehicle.propeller_names:
        raise InputError("the models are of crafts with different propellers", field="MODEL")
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
        p_values.append(2 * t.sf(abs(z), _degrees(errors, earlier, later)))
        found.append((quantity, before, after, joint, z))
    if not found:
        raise InputError(
            "there is no quantity that both learned and know the error of; identify both with "
            "airpuck identify",
            field="MODEL",
        )
    changes = tuple(
        Change(q.label, q.words, q.unit, before, after, joint, z, float(p), q.positive)
        for (q, before, after, joint, z), p in zip(found, holm(np.array(p_values)), strict=True)
    )
    return Drift(changes, tuple(_notes(earlier, later)))


def _degrees(errors: np.ndarray, *models: Model) -> float:
    """Return the degrees of freedom of a difference (Welch 1947)."""
    clusters = [m.uncertainty.clusters if m.uncertainty else 2 for m in models]
    degrees = np.maximum(np.array(clusters) - 1, 1)
    variance = errors**2
    return float(variance.sum() ** 2 / np.sum(variance**2 / degrees))


def _notes(earlier: Model, later: Model) -> list[str]:
    """Name what the standard errors do not account for."""
    notes = []
    if set(earlier.data.values()) & set(later.data.values()):
        notes.append("both models learned from some of the same files: errors are not independent")
    if earlier.name != later.name:
        notes.append(
            f"{earlier.name} and {later.name} have different terms: a difference may be theirs"
        )
    delays = 1e3 * earlier.transport_delay, 1e3 * later.transport_delay
    if abs(delays[0] - delays[1]) > 0.05:
        notes.append(
            f"the transport delay went from {delays[0]:.1f} to {delays[1]:.1f} ms: where it is "
            "found by whole samples, lag and inertia take up the rest"
        )
    return notes
