"""Fitted and reference parameters as tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from airpuck.evaluation.main_quantities import (
    largest_accelerations,
    main_quantities,
    thrust_scale,
)
from airpuck.evaluation.presentation import NOT_IDENTIFIED
from airpuck.model.model_file import Model
from airpuck.model.quantities import IN_MATRIX, QUANTITIES
from airpuck.report.page import PageTable

#: Quantities in the order of the paper's table:models.
_LADDER = [quantity for quantity in QUANTITIES if quantity.rungs]


class Cell(NamedTuple):
    """One value in a table of parameters."""

    #: Value ± standard error, if known; a dash if the model does not use the quantity.
    text: str = "–"
    #: Whether it was learned.
    free: bool = False


class Row(NamedTuple):
    """One line of a table of parameters."""

    label: str
    unit: str
    #: One cell for each model.
    cells: list[Cell]


def parameter_table(
    caption: str,
    headings: Sequence[str],
    rows: Sequence[Row],
    groups: Sequence[tuple[str, int]] = (),
) -> PageTable:
    """Return rows as a table of a page, with learned values in bold."""
    texts = [[row.label, row.unit, *(cell.text for cell in row.cells)] for row in rows]
    learned = frozenset(
        (i, j + 2) for i, row in enumerate(rows) for j, cell in enumerate(row.cells) if cell.free
    )
    return PageTable(caption, headings, texts, groups, learned)


def ladder_table(models: Sequence[Model]) -> PageTable:
    """Tabulate the free parameters of each rung (table:models)."""
    rows = []
    for model in models:
        rung, cells = model.rung, []
        for quantity in _LADDER:
            if quantity.name in rung.free:
                cells.append(Cell("free", True))
            elif rung.direct and quantity.in_matrix:
                cells.append(Cell())
            elif quantity.name == "configuration_matrix":
                cells.append(Cell("from the others"))
            else:
                value = np.ravel(getattr(model.parameters, quantity.name))
                cells.append(Cell(", ".join(f"{x:.3g}" for x in value)))
        rows.append(Row(model.name, rung.summary, cells))
    caption = (
        "Table 1 of the paper: free and fixed parameters of each rung. A dash: not used. Π “from "
        "the others”: by first principles."
    )
    headings = [q.symbol if "," in q.unit else f"{q.symbol} [{q.unit}]" for q in _LADDER]
    return parameter_table(caption, ["model", "", *headings], rows)


def main_rows(models: Sequence[Model]) -> list[Row]:
    """Tabulate the main quantities; thrusts come last."""
    listed = {q.label: q for model in models for q in main_quantities(model)}
    rows = [
        row
        for q in listed.values()
        for row in _rows(models, [q.label], q.unit, q.parameter, q.value, q.form)
    ]
    return sorted(rows, key=lambda row: row.label.startswith("F("))


def coefficient_rows(models: Sequence[Model]) -> list[Row]:
    """Tabulate every thrust coefficient at the learned scale."""
    degree = max(np.shape(model.parameters.thrust)[1] for model in models)
    letters = [chr(ord("a") + power) for power in range(degree)]
    labels = [f"{a} {name}" for name in models[0].vehicle.propeller_names for a in letters]

    def coefficients(model: Model) -> Any:
        thrust = model.parameters.thrust
        return np.pad(thrust, ((0, 0), (0, degree - thrust.shape[1])))

    return _rows(models, labels, "N", "thrust", coefficients, ".4f")


def effect_rows(models: Sequence[Model]) -> list[Row]:
    """Tabulate the effect of each propeller at full speed, which does not depend on scale."""

    def rows(label: str, unit: str, values: Callable[[Model], Any], form: str) -> list[Row]:
        labels = [f"{label} {name}" for name in models[0].vehicle.propeller_names]
        return _rows(models, labels, unit, "thrust", values, form)

    return [
        *rows("m‖Π_xy‖", "–", thrust_scale, ".3f"),
        *rows("‖Π_xy‖ F(1)", "m/s²", lambda model: largest_accelerations(model)[0], ".3f"),
        *rows("Π_yaw F(1)", "rad/s²", lambda model: largest_accelerations(model)[1], ".1f"),
    ]


def _rows(
    models: Sequence[Model],
    labels: Sequence[str],
    unit: str,
    quantity: str,
    values: Callable[[Model], Any],
    form: str,
) -> list[Row]:
    """Tabulate values derived from a parameter: a row for each value, a cell for each model."""
    columns = [_cells(model, len(labels), quantity, values, form) for model in models]
    return [Row(label, unit, cells) for label, *cells in zip(labels, *columns, strict=True)]


def _cells(
    model: Model, count: int, quantity: str, values: Callable[[Model], Any], form: str
) -> list[Cell]:
    """Format the values of one model, with standard errors if known."""
    direct = model.parameters.configuration_matrix is not None
    unused = direct and quantity in IN_MATRIX
    if unused or getattr(model.parameters, quantity) is None:
        return [Cell()] * count
    free = bool(model.free[model.parameters.mask(frozenset({quantity}))].any())
    cells = []
    errors = np.ravel(model.standard_error(values))
    for value, error in zip(np.ravel(values(model)), errors, strict=True):
        known = np.isfinite(error) and error > 0
        if free and model.known is not None and not np.isfinite(error):
            cells.append(Cell(NOT_IDENTIFIED, free))
            continue
        cells.append(Cell(f"{value:{form}}" + f" ± {error:{form}}" * bool(known), free))
    return cells
