"""Figures of the paper's side claims."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from paper_claims.trials import Landscape, Trial

from airpuck.evaluation.presentation import physical_thrust
from airpuck.physics.thrust import lowest_slope, thrust_slope
from airpuck.report.style import (
    BLACK,
    BLUE,
    DASHED,
    ERRORS,
    GREY,
    PAGE_WIDTH,
    RUNG_COLORS,
    VERMILLION,
    key,
    new_figure,
    panels,
    propeller_colors,
    styled,
    top_legend,
)


@styled
def degrees_figure(trials: Sequence[Trial]) -> Figure:
    """Draw training loss and validation error over the degree of the thrust polynomials."""
    figure = new_figure(PAGE_WIDTH, 2.9)
    degrees = [np.shape(trial.fit.model.parameters.thrust)[1] for trial in trials]
    series = [("loss", "10⁻⁴", np.array([1e4 * trial.fit.loss for trial in trials]))]
    series += [
        (f"RMSE of {name}", unit, np.array([factor * trial.rmse[channel] for trial in trials]))
        for channel, (name, unit, factor) in enumerate(ERRORS)
    ]
    for axes, (name, unit, values) in zip(panels(figure, 4, 4), series, strict=True):
        training = name == "loss"
        axes.plot(degrees, values, "o-", color=GREY if training else BLUE, ms=4.5)
        best = int(np.argmin(values))
        axes.plot(degrees[best], values[best], "o", color=VERMILLION, ms=7)
        axes.set(xlabel="degree [–]", ylabel=f"{name} [{unit}]", xticks=degrees)
        axes.set_title("training" if training else "validation", loc="left")
        axes.margins(x=0.1, y=0.12)
    top_legend(figure, [key("lowest", VERMILLION, ls="", marker="o", ms=7)])
    return figure


@styled
def slopes_figure(trials: Sequence[Trial]) -> Figure:
    """Draw the slopes of thrust curves that were free to fall.

    Where the slope of a motor's thrust is below zero (shaded), more speed would give less thrust,
    and the curve has no inverse.
    """
    columns = min(len(trials), 3)
    figure = new_figure(PAGE_WIDTH, 0.5 + 2.3 * -(-len(trials) // columns))
    speed = np.linspace(0, 1, 401)
    vehicle = trials[0].fit.model.vehicle
    colors = propeller_colors(vehicle)
    # The second propeller of a pair is dashed.
    dashes = ["-" if colors.index(c) == i else DASHED for i, c in enumerate(colors)]
    for axes, trial in zip(panels(figure, len(trials), columns, sharex=True), trials, strict=True):
        coefficients = physical_thrust(trial.fit.model)
        slopes = thrust_slope(coefficients, np.tile(speed, (len(coefficients), 1)))
        for slope, color, dash in zip(slopes, colors, dashes, strict=True):
            axes.plot(speed, slope, color=color, lw=1.2, ls=dash)
        low, high = axes.get_ylim()
        low = min(low, -0.12)
        axes.axhspan(low, 0, color=VERMILLION, alpha=0.10, lw=0)
        axes.axhline(0, color=BLACK, lw=0.8)
        lowest = lowest_slope(coefficients)[0]
        axes.set_title(f"{trial.label}: {(lowest < 0).sum()} of {len(lowest)} fall", loc="left")
        axes.set(xlim=(0, 1), ylim=(low, high))
        axes.set(xlabel="motor speed φ [–]", ylabel="slope of thrust [N]")
    handles = [
        key(name, color, ls=dash)
        for name, color, dash in zip(vehicle.propeller_names, colors, dashes, strict=True)
    ]
    top_legend(figure, [*handles, Patch(color=VERMILLION, alpha=0.15, label="falling")])
    return figure


@styled
def landscape_figure(landscapes: Sequence[Landscape]) -> Figure:
    """Draw the loss along one parameter, for predictions of growing length; dots are minima."""
    columns = min(len(landscapes), 2)
    figure = new_figure(PAGE_WIDTH, 0.4 + 2.3 * -(-len(landscapes) // columns))
    for axes, one in zip(panels(figure, len(landscapes), columns), landscapes, strict=True):
        exponent = int(np.floor(np.log10(one.loss.min())))
        values, minima = one.loss * 10.0**-exponent, one.minima
        axes.plot(one.factor, values, color=BLUE, lw=1.1)
        axes.plot(minima, values[np.isin(one.factor, minima)], "o", color=VERMILLION, ms=4)
        count = {0: "no minimum inside", 1: "one minimum"}.get(len(minima), f"{len(minima)} minima")
        predictions = f"{one.windows} prediction" + "s" * (one.windows > 1)
        axes.set_title(f"{predictions} of {one.horizon:.2g} s: {count}", loc="left")
        axes.set_xlabel("inertia, relative to the batched fit [–]")
        axes.set_ylabel("loss" + (f" [$10^{{{exponent}}}$]" if exponent else " [–]"))
        axes.margins(x=0.01)
    return figure


@styled
def largest_thrust_figure(
    thrusts: Mapping[str, Mapping[str, Float[np.ndarray, " n"]]], propellers: Sequence[str]
) -> Figure:
    """Draw each motor's largest thrust by M3, by M4 as learned, and by M4 at the physical scale."""
    figure = new_figure(PAGE_WIDTH, 3.1)
    place = np.arange(len(propellers))
    shapes = (
        ("M3_N", "M3", "M3", -0.2, True),
        ("M4_as_learned_N", "M4 as learned", "M4", 0.2, False),
        ("M4_scaled_N", "M4 at the physical scale", "M4", 0.2, True),
    )
    grid = panels(figure, len(thrusts), len(thrusts), sharey=True)
    for axes, (kind, values) in zip(grid, thrusts.items(), strict=True):
        ends = values["M4_scaled_N"], values["M4_as_learned_N"]
        axes.vlines(place + 0.2, *ends, color=GREY, lw=0.8)
        for name, _, rung, offset, filled in shapes:
            color = RUNG_COLORS[rung]
            face = color if filled else "white"
            axes.plot(place + offset, values[name], "o", ms=6.5, color=color, mfc=face)
        axes.set_title(kind, loc="left")
        axes.set_xticks(place, propellers, rotation=35, ha="right")
        axes.set_ylabel("thrust at φ = 1 [N]")
        axes.grid(visible=False, axis="x")
        axes.label_outer()
    highest = max(value.max() for values in thrusts.values() for value in values.values())
    grid[0].set_ylim(0, 1.06 * float(highest))
    top_legend(
        figure,
        [
            key(label, RUNG_COLORS[rung], ls="", marker="o", mfc=None if filled else "white")
            for _, label, rung, _, filled in shapes
        ],
    )
    return figure
