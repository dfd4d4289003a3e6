"""Figures of the reports in a user's axes: `airpuck.plot`.

Without axes, a function creates a pyplot figure, which a notebook displays.

Examples
--------
>>> axes = airpuck.plot.thrust(model)
>>> axes.get_ylabel()
'thrust [N]'
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from airpuck.boundary.errors import InputError
from airpuck.report import style
from airpuck.report.fit_figures import draw_thrusts
from airpuck.report.plan_figures import path_figure as path_figure
from airpuck.report.plan_figures import plan_figure as plan_figure
from airpuck.report.plan_figures import race_figure as race_figure
from airpuck.report.prediction_figures import (
    draw_error_distribution,
    draw_horizon,
    draw_path,
    draw_predictions,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

    from airpuck.craft.vehicle import Vehicle
    from airpuck.data.trajectory import Trajectory
    from airpuck.evaluation.evaluate import Evaluation
    from airpuck.model.model_file import Model


def thrust(model: Model, axes: Axes | None = None) -> Axes:
    """Draw the thrust of every propeller over its speed, with 95 % bands if known.

    Parameters
    ----------
    model : Model
        The model, such as ``fit.model``.
    axes : matplotlib Axes, optional
        Where to draw; by default in a new figure.

    Returns
    -------
    matplotlib Axes
        With the drawing.
    """
    (axes,) = _axes(axes, 1)
    axes.legend(handles=draw_thrusts(axes, model))
    return axes


def horizon(evaluations: Evaluation | Sequence[Evaluation], axes: Any = None) -> list[Axes]:
    """Draw the RMS error of predictions over the prediction horizon.

    Parameters
    ----------
    evaluations : Evaluation or sequence of Evaluation
        From `airpuck.evaluate` or `airpuck.compare`.
    axes : three matplotlib Axes, optional
        For x, y and yaw; by default in a new figure.

    Returns
    -------
    list of matplotlib Axes
        With the drawing.
    """
    panels = _axes(axes, 3)
    panels[-1].legend(handles=draw_horizon(panels, _several(evaluations)))
    return panels


def errors(evaluations: Evaluation | Sequence[Evaluation], axes: Any = None) -> list[Axes]:
    """Draw the distribution of the prediction errors of all windows.

    Parameters
    ----------
    evaluations : Evaluation or sequence of Evaluation
        From `airpuck.evaluate` or `airpuck.compare`.
    axes : three matplotlib Axes, optional
        For x, y and yaw; by default in a new figure.

    Returns
    -------
    list of matplotlib Axes
        With the drawing.
    """
    panels = _axes(axes, 3)
    panels[-1].legend(handles=draw_error_distribution(panels, _several(evaluations)))
    return panels


def predictions(
    trajectory: Trajectory,
    evaluations: Evaluation | Sequence[Evaluation],
    figure: Figure | SubFigure | None = None,
) -> Any:
    """Draw measured and predicted poses over a typical stretch of a flight.

    Parameters
    ----------
    trajectory : Trajectory
        The recording that was evaluated.
    evaluations : Evaluation or sequence of Evaluation
        Its evaluations.
    figure : matplotlib Figure or SubFigure, optional
        Where to draw; by default a new figure.

    Returns
    -------
    matplotlib Figure or SubFigure
        With the drawing.
    """
    if figure is None:
        from matplotlib import pyplot

        figure = pyplot.figure(figsize=(style.PAGE_WIDTH, 5.6), layout="constrained")
    draw_predictions(figure, trajectory, _several(evaluations))
    return figure


def path(trajectory: Trajectory, vehicle: Vehicle, axes: Axes | None = None) -> Axes:
    """Draw the path of a flight from above.

    Parameters
    ----------
    trajectory : Trajectory
        The flight.
    vehicle : Vehicle
        The craft, drawn at its start.
    axes : matplotlib Axes, optional
        Where to draw; by default in a new figure.

    Returns
    -------
    matplotlib Axes
        With the drawing.
    """
    (axes,) = _axes(axes, 1)
    draw_path(axes, trajectory, vehicle)
    return axes


def _several(evaluations: Any) -> list[Evaluation]:
    """Return a list of evaluations."""
    return list(evaluations) if isinstance(evaluations, Sequence) else [evaluations]


def _axes(given: Any, count: int) -> list[Axes]:
    """Check the given axes, or create a figure with axes."""
    if given is None:
        from matplotlib import pyplot

        size = (style.PAGE_WIDTH, 3.4) if count > 1 else (6.4, 4.4)
        return style.panels(pyplot.figure(figsize=size, layout="constrained"), count, count)
    axes = np.ravel(given).tolist()
    if len(axes) != count or not all(isinstance(one, Axes) for one in axes):
        raise InputError(f"needs {count} matplotlib axes, not {len(axes)} objects", field="axes")
    return axes
