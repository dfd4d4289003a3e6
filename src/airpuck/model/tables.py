"""The parameters of a model as labelled tables."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.results import html_table
from airpuck.model.parameters import Parameters
from airpuck.model.uncertainty import Uncertainty

_HEADINGS = ("value", "unit", "standard_error", "lower_95", "upper_95", "learned")


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


def covariance_rows(
    covariance: Float[np.ndarray, "P P"], labels: list[str], learned: Bool[np.ndarray, " P"]
) -> dict[str, dict[str, float]]:
    """Return the covariance of the learned parameters, with labels on both sides."""
    entries = np.flatnonzero(learned).tolist()
    return {
        labels[row]: {labels[column]: float(covariance[row, column]) for column in entries}
        for row in entries
    }


def parameters_html(title: str, rows: dict[str, dict[str, Any]]) -> str:
    """Show rows of `parameter_rows` in a notebook."""
    headings = ("", *(heading.replace("_", " ") for heading in _HEADINGS))
    return html_table(title, headings, ((label, *row.values()) for label, row in rows.items()))
