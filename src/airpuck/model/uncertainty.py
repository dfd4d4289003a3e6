"""What the data leave unknown: errors of parameters and derived quantities, noise of cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pydantic
from jaxtyping import Bool, Float

from airpuck.boundary.files import NonNegative, Positive, Section
from airpuck.boundary.results import Brief, html_table
from airpuck.model.parameters import Parameters

#: Columns of a table of parameters.
_HEADINGS = ("value", "unit", "standard_error", "lower_95", "upper_95", "learned")


class Cameras(Section):
    """Rate, noise and time stamps of the poses that a model was learned from."""

    #: Poses per second, on average between gaps.
    rate_hz: Positive
    #: Standard deviations of the white noise of a pose.
    position_noise_m: NonNegative
    yaw_noise_rad: NonNegative
    #: Standard deviation of the stamps' errors, which show as noise in proportion to speed.
    stamp_jitter_s: NonNegative = 0.0


#: Step of a finite difference, in standard errors: small enough that a product of parameters is
#: linear, large enough for double precision.
_STEP = 1e-3
#: Standard error, relative to its value, of an undetermined entry that is rounding.
_ROUNDING = 1e-9
#: Component of a gradient along an undetermined direction above which the quantity counts as
#: undetermined. Finite differences are exact to about 1e-6.
_ALONG = 1e-4


class DelayJitter(Section):
    """Spread of the transport delay between packets; a table of a model file."""

    #: Standard deviation of the delays of single packets.
    standard_deviation_s: NonNegative
    #: Standard error of that standard deviation.
    standard_error_s: NonNegative
    #: Number of packets behind it.
    packets: int = pydantic.Field(ge=1)


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Percentile intervals from fits to resampled data."""

    #: Number of fits that converged.
    replicates: int
    #: Seed of the resampling.
    seed: int
    #: 95 % intervals, from the 2.5th and 97.5th percentile; nan where there is none.
    lower: Float[np.ndarray, " P"]
    upper: Float[np.ndarray, " P"]


@dataclass(frozen=True, eq=False)
class Uncertainty(Brief):
    """Covariance of the learned parameters, over all P entries of ``Parameters.to_vector()``.

    Attributes
    ----------
    estimate : array, shape (P,)
        The parameters.
    covariance : array, shape (P, P)
        Covariance in the units of the parameters. Zero for entries that were not learned or are
        fixed by a constraint.
    standard_errors : array, shape (P,)
        Standard errors; nan for entries that were not learned, are at a bound, or are undetermined
        by the data.
    undetermined : array, shape (K, P)
        Orthonormal directions in which the loss does not change; `covariance` is valid orthogonally
        to them, in scaled coordinates.
    clusters : int
        Number G of blocks of time behind the covariance.
    quantile : float
        97.5 % quantile of Student's t with G - 1 degrees of freedom.
    notes : tuple of str
        Caveats to know before using it.
    warnings : tuple of str
        The caveats that invalidate all standard errors; files do not distinguish them from the
        other notes.
    bootstrap : Bootstrap or None
        Intervals by resampling, if computed (`airpuck.bootstrap`).
    """

    SHOWN = "estimate standard_errors undetermined clusters notes bootstrap"
    estimate: Float[np.ndarray, " P"]
    covariance: Float[np.ndarray, "P P"]
    standard_errors: Float[np.ndarray, " P"]
    undetermined: Float[np.ndarray, "K P"]
    clusters: int
    quantile: float
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    bootstrap: Bootstrap | None = None

    @property
    def intervals(self) -> Float[np.ndarray, "P 2"]:
        """95 % intervals, lower and upper ends; nan without a standard error."""
        reach = self.quantile * self.standard_errors
        return np.stack([self.estimate - reach, self.estimate + reach], axis=1)

    @property
    def correlation(self) -> Float[np.ndarray, "P P"]:
        """Correlation of the estimates; nan without a standard error."""
        return self.covariance / np.outer(self.standard_errors, self.standard_errors)

    def propagate(
        self, quantity: Callable[[Float[np.ndarray, " P"]], Any]
    ) -> Float[np.ndarray, "*shape"]:
        """Compute the standard error of a quantity computed from the parameters (delta method).

        Parameters
        ----------
        quantity : callable
            ``(vector of shape (P,)) -> number or array``, smooth near the estimate.

        Returns
        -------
        array
            Standard errors, in the quantity's shape; nan if it depends on undetermined parameters,
            or if there is no covariance.
        """
        spread = np.sqrt(np.diag(self.covariance))
        shape = np.shape(quantity(self.estimate))
        gradient = np.zeros((len(spread), int(np.prod(shape, dtype=int))))
        # Entries of a gauge direction may have no variance, but must be varied, too.
        moved = np.abs(self.undetermined).max(axis=0, initial=0.0) * np.abs(self.estimate)
        for entry in np.flatnonzero((spread > 0) | (moved > 0)):
            step = np.zeros_like(spread)
            # Rounding may leave an undetermined entry a trace of variance, too small for a step.
            rounding = spread[entry] <= _ROUNDING * moved[entry]
            step[entry] = _STEP * (moved[entry] if rounding else spread[entry])
            above, below = (quantity(self.estimate + sign * step) for sign in (1, -1))
            gradient[entry] = np.ravel(np.subtract(above, below)) / (2 * step[entry])
        return self.errors_along(gradient).reshape(shape)

    def errors_along(self, gradient: Float[np.ndarray, "P M"]) -> Float[np.ndarray, " M"]:
        """Compute the standard errors of quantities whose gradients are known.

        Parameters
        ----------
        gradient : array, shape (P, M)
            Derivative of each quantity with respect to each parameter.

        Returns
        -------
        array, shape (M,)
            √(∇fᵀ V ∇f); nan if a quantity depends on undetermined parameters.
        """
        variance = np.sum(gradient * (self.covariance @ gradient), axis=0)
        error = np.sqrt(np.maximum(variance, 0.0))
        error[_touches(gradient, self.undetermined)] = np.nan
        return error

    @property
    def moved(self) -> Bool[np.ndarray, " P"]:
        """Shape (P,): entries that were learned, or are part of an undetermined direction."""
        return (np.diag(self.covariance) > 0) | (self.undetermined != 0).any(axis=0)


def _touches(gradient: Float[np.ndarray, "P M"], undetermined: Float[np.ndarray, "K P"]) -> Any:
    """Mark the quantities that change along undetermined directions."""
    if not len(undetermined):
        return np.zeros(gradient.shape[1], dtype=bool)
    # Entries differ in their units: compare each sum with the sizes of its own terms. Use the
    # largest size over all directions, since a direction can be unrelated to a quantity.
    most = (np.abs(undetermined) @ np.abs(gradient)).max(axis=0)
    return (np.abs(undetermined @ gradient) > _ALONG * most).any(axis=0)


def parameter_rows(
    parameters: Parameters,
    learned: Bool[np.ndarray, " P"],
    known: Uncertainty | None,
    propellers: tuple[str, ...],
) -> dict[str, dict[str, Any]]:
    """List every parameter by its label; nan without a standard error."""
    values = parameters.to_vector()
    columns = np.full((3, len(values)), np.nan)
    if known is not None:
        columns = np.stack([known.standard_errors, *known.intervals.T])
    units = []
    for quantity in parameters.quantities:
        size, own = np.size(getattr(parameters, quantity.name)), quantity.unit.split(", ")
        units += [own[entry * len(own) // size] for entry in range(size)]
    rows = zip(values.tolist(), units, *columns.tolist(), learned.tolist(), strict=True)
    return {
        label: dict(zip(_HEADINGS, row, strict=True))
        for label, row in zip(parameters.labels(propellers), rows, strict=True)
    }


def parameters_html(title: str, rows: dict[str, dict[str, Any]]) -> str:
    """Show rows of `parameter_rows` in a notebook."""
    headings = ("", *(heading.replace("_", " ") for heading in _HEADINGS))
    return html_table(title, headings, ((label, *row.values()) for label, row in rows.items()))
