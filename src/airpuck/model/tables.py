"""The parameters of a model as labelled tables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from airpuck.boundary.notebook import frame, html_table

if TYPE_CHECKING:
    from airpuck.model.model_file import Model

_HEADINGS = ("value", "unit", "standard_error", "lower_95", "upper_95", "learned")


def parameter_rows(model: Model) -> dict[str, dict[str, Any]]:
    """List every parameter by its label; without a standard error nan."""
    values, known = model.parameters.to_vector(), model.known
    columns = np.full((3, len(values)), np.nan)
    if known is not None:
        columns = np.stack([known.standard_errors, *known.intervals.T])
    units = []
    for quantity in model.parameters.quantities:
        size, own = np.size(getattr(model.parameters, quantity.name)), quantity.unit.split(", ")
        units += [own[entry * len(own) // size] for entry in range(size)]
    labels = model.parameters.labels(model.vehicle.propeller_names)
    rows = zip(values.tolist(), units, *columns.tolist(), model.free.tolist(), strict=True)
    return {
        label: dict(zip(_HEADINGS, row, strict=True))
        for label, row in zip(labels, rows, strict=True)
    }


def covariance_frame(model: Model) -> Any:
    """Return the covariance of the parameters that were learned, with labels on both sides."""
    labels = model.parameters.labels(model.vehicle.propeller_names)
    size = len(labels)
    covariance = np.full((size, size), np.nan) if model.known is None else model.known.covariance
    learned = np.flatnonzero(model.free).tolist()
    return frame(
        {
            labels[row]: {labels[column]: float(covariance[row, column]) for column in learned}
            for row in learned
        }
    )


def model_html(model: Model, title: str) -> str:
    """Show a model's parameters in a notebook."""
    rows = ((label, *row.values()) for label, row in parameter_rows(model).items())
    return html_table(title, ("", *(heading.replace("_", " ") for heading in _HEADINGS)), rows)
