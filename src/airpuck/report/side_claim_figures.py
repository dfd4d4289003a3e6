"""Figures of the paper's side claims."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from airpuck.evaluation.gauge import physical_thrust
from airpuck.physics.thrust import lowest_slope, thrust_slope
from airpuck.report.full_trajectory import FullTrajectory
from airpuck.report.horizon import CHANNELS
from airpuck.report.side_claims import LargestThrusts
from airpuck.report.style import (
    BLACK,
    BLUE,
    GREY,
    PAGE_WIDTH,
    VERMILLION,
    new_figure,
    propeller_colors,
    rung_color,
    styled,
    top_legend,
)
from airpuck.report.trial import Trial


@styled
def degrees_figure(trials: Sequence[Trial]) -> Figure:
    """Draw training loss and validation error over the degree of the thrust polynomials.

    Shows that the training loss falls with every degree, as it must, while the errors on the
    validation experiment stop falling.
    """
    figure = new_figure(PAGE_WIDTH, 2.9)
    panels = figure.subplots(1, 4)
    degrees = [np.shape(trial.fit.model.parameters.thrust)[1] for trial in trials]
    losses = np.array([trial.fit.loss for trial in trials])
    series = [("loss", "10⁻⁴", 1e4 * losses, GREY)]
    rmse = np.array([trial.rmse for trial in trials])
    for channel, (name, unit, factor) in enumerate(CHANNELS):
        series.append((f"RMSE of {name}", unit, factor * rmse[:, channel], BLUE))
    for axes, (name, unit, values, color) in zip(panels, series, strict=True):
        axes.plot(degrees, values, "o-", color=color, ms=4.5)
        best = int(np.argmin(values))
        axes.plot(degrees[best], values[best], "o", color=VERMILLION, ms=7)
        axes.set(xlabel="degree [–]", ylabel=f"{name} [{unit}]", xticks=degrees)
        axes.set_title("training" if color == GREY else "validation", loc="left")
        axes.margins(x=0.1, y=0.12)
    handle = Line2D([], [], ls="", marker="o", color=VERMILLION, ms=7, label="lowest")
    top_legend(figure, [handle])
    return figure


@styled
def slopes_figure(trials: Sequence[Trial]) -> Figure:
    """Draw the slopes of thrust curves that were free to fall.

    Shows, for each fit, where the slope of a motor's thrust is below zero (shaded): there more
    speed would give less thrust, and the curve has no inverse.
    """
    columns = min(len(trials), 3)
    rows = -(-len(trials) // columns)
    figure = new_figure(PAGE_WIDTH, 0.5 + 2.3 * rows)
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    speed = np.linspace(0, 1, 401)
    vehicle = trials[0].fit.model.vehicle
    colors = propeller_colors(vehicle)
    first_of_color = [colors.index(color) == index for index, color in enumerate(colors)]
    for axes, trial in zip(panels.ravel(), trials, strict=False):
        coefficients = physical_thrust(trial.fit.model)
        slopes = thrust_slope(coefficients, np.tile(speed, (len(coefficients), 1)))
        for motor, slope in enumerate(slopes):
            style = "-" if first_of_color[motor] else (0, (4, 2))
            axes.plot(speed, slope, color=colors[motor], lw=1.2, ls=style)
        low, high = axes.get_ylim()
        low = min(low, -0.12)
        axes.axhspan(low, 0, color=VERMILLION, alpha=0.10, lw=0)
        axes.axhline(0, color=BLACK, lw=0.8)
        lowest = lowest_slope(coefficients)[0]
        falling = int((lowest < 0).sum())
        axes.set_title(f"{trial.label}: {falling} of {len(lowest)} fall", loc="left")
        axes.set(xlim=(0, 1), ylim=(low, high))
        axes.set(xlabel="motor speed φ [–]", ylabel="slope of thrust [N]")
    for axes in panels.ravel()[len(trials) :]:
        axes.set_visible(False)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=color, ls="-" if first else (0, (4, 2)), label=name)
        for name, color, first in zip(vehicle.propeller_names, colors, first_of_color, strict=True)
    ]
    handles.append(Patch(color=VERMILLION, alpha=0.15, label="falling"))
    top_legend(figure, handles)
    return figure


@styled
def landscape_figure(result: FullTrajectory) -> Figure:
    """Draw the loss along one parameter, for predictions of growing length.

    Shows how a smooth bowl becomes a rugged surface with many local minima (dots) when predictions
    span more of the recording.
    """
    landscapes = result.landscapes
    columns = min(len(landscapes), 2)
    rows = -(-len(landscapes) // columns)
    figure = new_figure(PAGE_WIDTH, 0.4 + 2.3 * rows)
    panels = figure.subplots(rows, columns, squeeze=False)
    for axes, landscape in zip(panels.ravel(), landscapes, strict=False):
        exponent = int(np.floor(np.log10(landscape.loss.min())))
        values = landscape.loss * 10.0**-exponent
        axes.plot(landscape.factor, values, color=BLUE, lw=1.1)
        minima = landscape.minima
        at_minima = values[np.isin(landscape.factor, minima)]
        axes.plot(minima, at_minima, "o", color=VERMILLION, ms=4)
        count = {0: "no minimum inside", 1: "one minimum"}.get(len(minima), f"{len(minima)} minima")
        predictions = (
            "1 prediction" if landscape.windows == 1 else f"{landscape.windows} predictions"
        )
        axes.set_title(f"{predictions} of {landscape.horizon:.2g} s: {count}", loc="left")
        axes.set(
            xlabel="inertia, relative to the batched fit [–]",
            ylabel="loss" + (f" [$10^{{{exponent}}}$]" if exponent else " [–]"),
        )
        axes.margins(x=0.01)
    for axes in panels.ravel()[len(landscapes) :]:
        axes.set_visible(False)
    return figure


@styled
def largest_thrust_figure(result: LargestThrusts) -> Figure:
    """Draw each motor's largest thrust by M3, by M4 as learned, and by M4 at the physical scale.

    Shows that M4's thrusts differ from M3's by a scale that means nothing: at the scale where a
    propeller's force accelerates the craft's mass, they agree.
    """
    figure = new_figure(PAGE_WIDTH, 3.1)
    kinds = list(result.first_principles)
    panels = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0]
    place = np.arange(len(result.propellers))
    for axes, kind in zip(panels, kinds, strict=True):
        scaled = result.direct_scaled[kind]
        axes.vlines(place + 0.2, scaled, result.direct[kind], color=GREY, lw=0.8)
        for offset, values, name, fill in (
            (-0.2, result.first_principles[kind], "M3", True),
            (0.2, result.direct[kind], "M4", False),
            (0.2, scaled, "M4", True),
        ):
            color = rung_color(name)
            axes.plot(
                place + offset, values, "o", ms=6.5, color=color, mfc=color if fill else "white"
            )
        axes.set_title(kind, loc="left")
        axes.set_xticks(place, result.propellers, rotation=35, ha="right")
        axes.set(ylabel="thrust at φ = 1 [N]")
        axes.grid(visible=False, axis="x")
        axes.label_outer()
    highest = max(
        float(values[kind].max())
        for kind in kinds
        for values in (result.first_principles, result.direct, result.direct_scaled)
    )
    panels[0].set_ylim(0, 1.06 * highest)
    blue, red = rung_color("M3"), rung_color("M4")
    handles = [
        Line2D([], [], ls="", marker="o", color=blue, label="M3"),
        Line2D([], [], ls="", marker="o", color=red, mfc="white", label="M4 as learned"),
        Line2D([], [], ls="", marker="o", color=red, label="M4 at the physical scale"),
    ]
    top_legend(figure, handles)
    return figure
