"""The part of a model file that says how well its parameters are known."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Section
from airpuck.craft.vehicle import Vehicle
from airpuck.model.parameters import Parameters
from airpuck.model.uncertainty import Bootstrap, Uncertainty


def uncertainty_content(
    uncertainty: Uncertainty | None, parameters: Parameters, vehicle: Vehicle
) -> dict[str, Any]:
    """Return the table ``[uncertainty]`` of a model file."""
    if uncertainty is None or not np.array_equal(uncertainty.estimate, parameters.to_vector()):
        return {}
    labels = np.array(parameters.labels(vehicle.propeller_names))
    errors = parameters.with_vector(uncertainty.standard_errors)
    used = (np.abs(uncertainty.covariance) > 0).any(axis=0) | np.isfinite(
        uncertainty.standard_errors
    )
    used |= (uncertainty.undetermined != 0).any(axis=0)
    if uncertainty.bootstrap is not None:
        used |= np.isfinite(uncertainty.bootstrap.lower)
    content: dict[str, Any] = {
        "method": "sandwich",
        "clusters": uncertainty.clusters,
        "quantile_95": uncertainty.quantile,
        "notes": list(uncertainty.notes),
        "labels": labels[used].tolist(),
        "covariance": uncertainty.covariance[np.ix_(used, used)].tolist(),
        "undetermined": uncertainty.undetermined[:, used].tolist(),
        "standard_errors": {
            quantity.key: np.asarray(getattr(errors, quantity.name)).tolist()
            for quantity in parameters.quantities
            if np.isfinite(getattr(errors, quantity.name)).any()
        },
    }
    if uncertainty.bootstrap is not None:
        content["bootstrap"] = {
            "replicates": uncertainty.bootstrap.replicates,
            "seed": uncertainty.bootstrap.seed,
            "lower": uncertainty.bootstrap.lower[used].tolist(),
            "upper": uncertainty.bootstrap.upper[used].tolist(),
        }
    return {"uncertainty": content}


class DelayJitter(Section):
    """The table ``[delay_jitter]``: how much the delay differs from packet to packet."""

    #: Of the delay of single packets.
    standard_deviation_s: float = pydantic.Field(ge=0)
    #: Of that standard deviation.
    standard_error_s: float = pydantic.Field(ge=0)
    #: Packets behind it.
    packets: int = pydantic.Field(ge=1)


class _WithNan(Section):
    """A table where nan stands for what is not known."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=True)


class _StandardErrors(_WithNan):
    thrust_N: tuple[tuple[float, ...], ...] | None = None
    inertia_kg_m2: float | None = None
    motor_time_constant_s: float | None = None
    angle_offset_rad: float | None = None
    center_of_mass_m: tuple[float, float] | None = None
    configuration_matrix_SI: tuple[tuple[float, ...], ...] | None = None
    drag_SI: tuple[float, float, float, float] | None = None
    inflow_s_m: float | None = None
    pair_interaction_1_N: float | None = None
    voltage_sag_1_N: float | None = None
    tilt_rad: tuple[float, float] | None = None
    transport_delay_s: float | None = None


class _Bootstrap(_WithNan):
    replicates: int = pydantic.Field(ge=0)
    seed: int
    lower: tuple[float, ...]
    upper: tuple[float, ...]


class UncertaintySection(_WithNan):
    """The table ``[uncertainty]``; `labels` names rows and columns of the covariance."""

    method: Literal["sandwich"] = "sandwich"
    clusters: int = pydantic.Field(ge=0)
    quantile_95: float
    notes: tuple[str, ...] = ()
    labels: tuple[str, ...]
    covariance: tuple[tuple[float, ...], ...]
    undetermined: tuple[tuple[float, ...], ...] = ()
    standard_errors: _StandardErrors
    bootstrap: _Bootstrap | None = None

    def uncertainty(self, parameters: Parameters, vehicle: Vehicle) -> Uncertainty:
        """Return what the table says."""
        names = parameters.labels(vehicle.propeller_names)
        for label in self.labels:
            if label not in names:
                raise InputError(
                    f"has {label!r}, which is no parameter of this model",
                    field="uncertainty.labels",
                )
        at = np.array([names.index(label) for label in self.labels], dtype=int)
        covariance = np.zeros((len(names), len(names)))
        covariance[np.ix_(at, at)] = self._rows(self.covariance, "covariance", len(at))
        undetermined = np.zeros((len(self.undetermined), len(names)))
        undetermined[:, at] = self._rows(self.undetermined, "undetermined", len(self.undetermined))
        return Uncertainty(
            estimate=parameters.to_vector(),
            covariance=covariance,
            standard_errors=self._errors(parameters),
            undetermined=undetermined,
            clusters=self.clusters,
            quantile=self.quantile_95,
            notes=self.notes,
            bootstrap=self._bootstrap(at, len(names)),
        )

    def _rows(
        self, rows: tuple[tuple[float, ...], ...], key: str, count: int
    ) -> Float[np.ndarray, "R F"]:
        """Return a matrix with one column for each label."""
        if len(rows) != count or any(len(row) != len(self.labels) for row in rows):
            raise InputError(
                f"must have rows of {len(self.labels)} numbers, one for each label",
                field=f"uncertainty.{key}",
            )
        return np.array(rows, dtype=float).reshape(count, len(self.labels))

    def _errors(self, parameters: Parameters) -> Float[np.ndarray, " P"]:
        """Return standard errors of all entries."""
        errors = []
        for quantity in parameters.quantities:
            shape = np.shape(getattr(parameters, quantity.name))
            own = getattr(self.standard_errors, quantity.key)
            try:
                errors.append(np.ravel(np.broadcast_to(np.nan if own is None else own, shape)))
            except ValueError:
                raise InputError(
                    "must have the shape of the parameter",
                    field=f"uncertainty.standard_errors.{quantity.key}",
                ) from None
        return np.concatenate(errors)

    def _bootstrap(self, at: Any, size: int) -> Bootstrap | None:
        """Return the intervals by resampling."""
        if self.bootstrap is None:
            return None
        ends = np.full((2, size), np.nan)
        for end, values in zip(ends, (self.bootstrap.lower, self.bootstrap.upper), strict=True):
            if len(values) != len(at):
                raise InputError(
                    f"must have {len(at)} numbers, one for each label",
                    field="uncertainty.bootstrap",
                )
            end[at] = values
        return Bootstrap(self.bootstrap.replicates, self.bootstrap.seed, ends[0], ends[1])
