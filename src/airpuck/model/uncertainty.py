"""How well learned parameters are known, and what follows for quantities made from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pydantic
from jaxtyping import Bool, Float

from airpuck.boundary.files import NonNegative, Section

#: Step of a finite difference, in standard errors: small enough that a product of parameters is
#: linear, large enough for double precision.
_STEP = 1e-3
#: Share of a gradient along a direction that the data do not determine, above which the quantity
#: is not determined. Finite differences are exact to about 1e-6.
_ALONG = 1e-4


class DelayJitter(Section):
    """How much the transport delay differs from packet to packet; a table of a model file."""

    #: Of the delays of single packets.
    standard_deviation_s: NonNegative
    #: Of that standard deviation.
    standard_error_s: NonNegative
    #: Packets behind it.
    packets: int = pydantic.Field(ge=1)


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Percentile intervals from fits to resampled data."""

    #: Fits that came to an end.
    replicates: int
    #: Seed of the resampling.
    seed: int
    #: 95 % intervals, from the 2.5th and 97.5th percentile; nan where there is none.
    lower: Float[np.ndarray, " P"]
    upper: Float[np.ndarray, " P"]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of the learned parameters, over all P entries of ``Parameters.to_vector()``.

    Attributes
    ----------
    estimate : array, shape (P,)
        The parameters.
    covariance : array, shape (P, P)
        In the units of the parameters. Zero for what was not learned or is held by a constraint.
    standard_errors : array, shape (P,)
        Nan where there is none: not learned, at a bound, or not determined by the data alone.
    undetermined : array, shape (K, P)
        Orthonormal directions in which the loss does not change; `covariance` holds on what is
        orthogonal to them in scaled coordinates.
    clusters : int
        Blocks of time G behind the covariance.
    quantile : float
        97.5 % quantile of Student's t with G - 1 degrees of freedom.
    notes : tuple of str
        What to know before using it.
    warnings : tuple of str
        Those notes that say not to rely on any standard error; files do not keep which these are.
    bootstrap : Bootstrap or None
        Intervals by resampling, where there are any (`airpuck.bootstrap`).
    """

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
        """95 % intervals, lower and upper ends; nan where there is no standard error."""
        reach = self.quantile * self.standard_errors
        return np.stack([self.estimate - reach, self.estimate + reach], axis=1)

    @property
    def correlation(self) -> Float[np.ndarray, "P P"]:
        """Correlation of the estimates; nan where there is no standard error."""
        return self.covariance / np.outer(self.standard_errors, self.standard_errors)

    def propagate(
        self, quantity: Callable[[Float[np.ndarray, " P"]], Any]
    ) -> Float[np.ndarray, "*shape"]:
        """Compute the standard error of a quantity made from the parameters (delta method).

        Parameters
        ----------
        quantity : callable
            ``(vector of shape (P,)) -> number or array``, smooth near the estimate.

        Returns
        -------
        array
            Standard errors, of the quantity's shape; nan where it depends on what the data do not
            determine, or where there is no covariance.
        """
        spread = np.sqrt(np.diag(self.covariance))
        shape = np.shape(quantity(self.estimate))
        gradient = np.zeros((len(spread), int(np.prod(shape, dtype=int))))
        # Entries of a gauge direction may have no variance, but must be varied, too.
        moved = np.abs(self.undetermined).max(axis=0, initial=0.0) * np.abs(self.estimate)
        for entry in np.flatnonzero((spread > 0) | (moved > 0)):
            step = np.zeros_like(spread)
            step[entry] = _STEP * (spread[entry] or moved[entry])
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
            √(∇fᵀ V ∇f); nan where a quantity depends on what the data do not determine.
        """
        variance = np.sum(gradient * (self.covariance @ gradient), axis=0)
        error = np.sqrt(np.maximum(variance, 0.0))
        error[_touches(gradient, self.undetermined)] = np.nan
        return error

    @property
    def moved(self) -> Bool[np.ndarray, " P"]:
        """Shape (P,): what was learned, or is part of a direction that is not determined."""
        return (np.diag(self.covariance) > 0) | (self.undetermined != 0).any(axis=0)


def _touches(gradient: Float[np.ndarray, "P M"], undetermined: Float[np.ndarray, "K P"]) -> Any:
    """Mark the quantities that change along directions which the data do not determine."""
    if not len(undetermined):
        return np.zeros(gradient.shape[1], dtype=bool)
    # Entries differ in their units: compare each sum with the sum of its terms' sizes, the
    # largest of all directions, since a direction can have nothing to do with a quantity.
    most = (np.abs(undetermined) @ np.abs(gradient)).max(axis=0)
    return (np.abs(undetermined @ gradient) > _ALONG * most).any(axis=0)
