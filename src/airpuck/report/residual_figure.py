"""Residual tests as a figure: autocorrelation, and correlation with the commands."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from airpuck.craft.vehicle import Vehicle
from airpuck.evaluation.residuals import ResidualTests
from airpuck.report.style import (
    BLUE,
    GREY,
    LIGHT,
    PAGE_WIDTH,
    VERMILLION,
    new_figure,
    propeller_colors,
    styled,
    top_legend,
)


@styled
def residual_figure(tests: ResidualTests, vehicle: Vehicle) -> Figure:
    """Draw the correlations of the innovations with their 99 % bands.

    Shows in the upper row whether past innovations say something about the next, in the lower row
    whether commands do: at positive lags those that act already, at negative ones those to come,
    which can only be seen where there is feedback, or where the model lets commands act too late.
    """
    figure = new_figure(PAGE_WIDTH, 5.2)
    rows = figure.subplots(2, len(tests.whiteness), squeeze=False)
    colors = dict(zip(vehicle.propeller_names, propeller_colors(vehicle), strict=True))
    styles, seen = {}, set()
    for name, color in colors.items():
        styles[name] = (0, (3, 1.2)) if color in seen else "-"
        seen.add(color)
    for axes, white in zip(rows[0], tests.whiteness, strict=True):
        lags = np.arange(1, len(white.autocorrelation) + 1)
        _draw_band(axes, white.band)
        color = BLUE if white.passed else VERMILLION
        axes.vlines(lags, 0, white.autocorrelation, color=color, lw=1.2)
        axes.plot(lags, white.autocorrelation, ".", color=color, ms=4)
        axes.set_title(f"{white.channel}: {'white' if white.passed else 'not white'}", loc="left")
        axes.set(xlabel="lag [samples]", xlim=(0, lags[-1] + 1))
    for axes, white in zip(rows[1], tests.whiteness, strict=True):
        mine = [test for test in tests.correlations if test.channel == white.channel]
        if mine:
            _draw_band(axes, max(test.band for test in mine))
        for test in mine:
            reach = len(test.correlation) // 2
            axes.plot(
                np.arange(-reach, reach + 1),
                test.correlation,
                color=colors[test.motor],
                ls=styles[test.motor],
                lw=0.9 if test.passed else 1.9,
                alpha=0.6 if test.passed else 1.0,
            )
            axes.set_xlim(-reach, reach)
        axes.axvline(0, color=GREY, lw=0.7)
        failed = sum(not test.passed for test in mine)
        told = f"{failed} of {len(mine)} motors fail" if failed else "all motors pass"
        axes.set_title(f"{white.channel}: {told}", loc="left")
        axes.set(xlabel="lag behind the command [samples]")
    rows[0, 0].set_ylabel("autocorrelation [–]")
    rows[1, 0].set_ylabel("correlation with commands [–]")
    for row in rows:
        reach = max(np.abs(axes.get_ylim()).max() for axes in row)
        for axes in row:
            axes.set_ylim(-reach, reach)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=color, ls=styles[name], label=name) for name, color in colors.items()
    ]
    top_legend(
        figure, [Patch(color=LIGHT, label="99 % band"), *handles], columns=min(len(handles) + 1, 7)
    )
    return figure


def _draw_band(axes: Axes, band: float) -> None:
    """Shade where 99 % of the correlations lie if there is nothing to find."""
    axes.axhspan(-band, band, color=LIGHT, lw=0)
    axes.axhline(0, color=GREY, lw=0.7)
