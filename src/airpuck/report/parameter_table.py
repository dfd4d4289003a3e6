"""Fitted and reference parameters as the rows of a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from airpuck.evaluation.gauge import largest_accelerations, thrust_scale
from airpuck.evaluation.main_quantities import UNUSED_WHERE_DIRECT, main_quantities
from airpuck.model.model_file import Model
from airpuck.model.rungs import named_rung

#: Quantities in the order of the paper's table:models.
_COLUMNS = (
    "thrust",
    "inertia",
    "motor_time_constant",
    "angle_offset",
    "center_of_mass",
    "configuration_matrix",
)


@dataclass(frozen=True)
class Cell:
    """One value in a table of parameters."""

    #: The formatted value, with its standard error where there is one; a dash where the model does
    #: not use the parameter.
    text: str
    #: Whether it was learned.
    free: bool


@dataclass(frozen=True)
class Row:
    """One line of a table of parameters."""

    #: What it is.
    label: str
    #: In which unit.
    unit: str
    #: One for each model.
    cells: tuple[Cell, ...]


def ladder_rows(names: Sequence[str], models: Sequence[Model]) -> tuple[list[str], list[Row]]:
    """Tabulate which parameters each rung has free (table:models)."""
    headings = ["thrust a, b, c [N]", "I [kg m²]", "τ [s]", "α [rad]", "r [m]", "Π"]
    rows = []
    for name, model in zip(names, models, strict=True):
        rung, cells = named_rung(name), []
        for column in _COLUMNS:
            if column in rung.free:
                cells.append(Cell("free", True))
            elif rung.direct and column in UNUSED_WHERE_DIRECT:
                cells.append(Cell("–", False))
            elif column == "configuration_matrix":
                cells.append(Cell("from the others", False))
            else:
                value = np.ravel(getattr(model.parameters, column))
                cells.append(Cell(", ".join(f"{x:.3g}" for x in value), False))
        rows.append(Row(name, rung.summary, tuple(cells)))
    return headings, rows


def main_rows(models: Sequence[Model]) -> list[Row]:
    """Tabulate what a person asks for first."""
    listed = {q.label: q for model in models for q in main_quantities(model)}
    rows = []
    for label, quantity in listed.items():
        rows.append(
            _row(models, label, quantity.unit, quantity.parameter, quantity.value, quantity.form)
        )
    # Thrusts last, whatever parameters only some of the models have.
    return sorted(rows, key=lambda row: row.label.startswith("F("))


def coefficient_rows(models: Sequence[Model]) -> list[Row]:
    """Tabulate every thrust coefficient as learned, without any change of scale."""
    degree = max(np.shape(model.parameters.thrust)[1] for model in models)
    return [
        _row(
            models,
            f"{chr(ord('a') + power)} {name}",
            "N",
            "thrust",
            lambda m, i=motor, k=power: (
                m.parameters.thrust[i][k] if k < np.shape(m.parameters.thrust)[1] else 0.0
            ),
            ".4f",
        )
        for motor, name in enumerate(models[0].vehicle.propeller_names)
        for power in range(degree)
    ]


def effect_rows(models: Sequence[Model]) -> list[Row]:
    """Tabulate what each propeller does at full speed, which no choice of scale changes."""
    kinds: tuple[tuple[str, str, Callable[..., Any], str], ...] = (
        ("m‖Π_xy‖", "–", lambda m, i: thrust_scale(m)[i], ".3f"),
        ("‖Π_xy‖ F(1)", "m/s²", lambda m, i: largest_accelerations(m)[0][i], ".3f"),
        ("Π_yaw F(1)", "rad/s²", lambda m, i: largest_accelerations(m)[1][i], ".1f"),
    )
    return [
        _row(models, f"{label} {name}", unit, "thrust", lambda m, v=value, i=motor: v(m, i), form)
        for label, unit, value, form in kinds
        for motor, name in enumerate(models[0].vehicle.propeller_names)
    ]


def _row(
    models: Sequence[Model],
    label: str,
    unit: str,
    quantity: str,
    value: Callable[[Model], Any],
    form: str,
) -> Row:
    """Make a row of values that belong to one quantity."""
    cells = []
    for model in models:
        direct = model.parameters.configuration_matrix is not None
        missing = getattr(model.parameters, quantity) is None
        if missing or (direct and quantity in UNUSED_WHERE_DIRECT):
            cells.append(Cell("–", False))
            continue
        mask = model.parameters.mask(frozenset({quantity}))
        text = format(float(value(model)), form)
        if model.uncertainty is not None:
            error = float(model.standard_error(value))
            if np.isfinite(error) and error > 0:
                text += f" ± {error:{form}}"
        cells.append(Cell(text, bool(model.free[mask].any())))
    return Row(label, unit, tuple(cells))
