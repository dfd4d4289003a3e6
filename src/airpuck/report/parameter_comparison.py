"""How far fitted parameters are from reference parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from airpuck.evaluation.gauge import largest_accelerations
from airpuck.model.model_file import Model
from airpuck.report.style import BLACK, PAGE_WIDTH, new_figure, rung_color, styled, top_legend


@styled
def parameter_figure(
    fitted: Sequence[Model],
    reference: Mapping[str, Model],
    *,
    reference_label: str = "published",
) -> Figure:
    """Draw relative differences between fitted and reference parameters.

    Shows, for each propeller at full speed, the linear and the angular acceleration that it causes,
    then inertia and time constant where they are learned. Accelerations are products of Π and
    thrust, so that models that learn Π can be compared too.
    """
    models = [model for model in fitted if model.name in reference]
    names = models[0].vehicle.propeller_names
    figure = new_figure(PAGE_WIDTH, 1.35 + 0.3 * len(names))
    linear, angular, scalars = figure.subplots(1, 3, width_ratios=(1, 1, 0.8))
    for axes, kind, title in (
        (linear, 0, "linear acceleration"),
        (angular, 1, "angular acceleration"),
    ):
        values = {}
        for model in models:
            own = largest_accelerations(model)[kind]
            other = largest_accelerations(reference[model.name])[kind]
            values[model.name] = 100 * (own / other - 1)
        _dots(axes, names, values)
        axes.set_title(f"{title} at φ = 1", loc="left")
    angular.set_yticklabels([])
    values = {}
    for model in models:
        values[model.name] = np.array(
            [
                _relative(model, reference[model.name], quantity)
                for quantity in ("inertia", "motor_time_constant")
            ]
        )
    _dots(scalars, ("inertia I", "lag τ"), values)
    scalars.set_title("where learned", loc="left")
    for axes in (linear, angular, scalars):
        axes.set_xlabel(f"fitted against {reference_label} [%]")
    handles = [
        Line2D([], [], ls="", marker="o", color=rung_color(model.name), label=model.name)
        for model in models
    ]
    top_legend(figure, handles)
    return figure


def _relative(model: Model, reference: Model, quantity: str) -> float:
    """Return the relative difference [%]; NaN where the model does not learn the quantity."""
    if not model.free[model.parameters.mask(frozenset({quantity}))].any():
        return float("nan")
    return 100 * (getattr(model.parameters, quantity) / getattr(reference.parameters, quantity) - 1)


def _dots(axes: Axes, labels: Sequence[str], values: Mapping[str, np.ndarray]) -> None:
    """Draw one line of dots for each label, from top to bottom."""
    rows = -np.arange(len(labels), dtype=float)
    spread = np.linspace(0.26, -0.26, max(len(values), 2))
    for offset, (name, differences) in zip(spread, values.items(), strict=False):
        axes.plot(differences, rows + offset, "o", color=rung_color(name), ms=4.5)
    for row in rows[:-1]:
        axes.axhline(row - 0.5, color="#e6e6e6", lw=0.6)
    axes.axvline(0, color=BLACK, lw=0.8)
    axes.grid(visible=False, axis="y")
    axes.set_yticks(rows, labels)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(rows[-1] - 0.5, 0.5)
