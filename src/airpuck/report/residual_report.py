"""Residual tests of a model on a recording: the page of `airpuck resid -o`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.fit_measures import FitMeasures
from airpuck.evaluation.prediction_bands import PredictionBands
from airpuck.evaluation.residuals import ResidualTests
from airpuck.evaluation.structure import Structure
from airpuck.model.model_file import Model
from airpuck.report import style
from airpuck.report.evaluation_report import sources_section
from airpuck.report.page import Origin, PageSection, PageTable, Picture, Text, write_page
from airpuck.report.tables import band_table, fit_table

_STRUCTURE = (
    "Mean acceleration that the model lacks, in bins of equal counts, with pointwise 99 % bands. "
    "A complete model gives zero everywhere. Effects of speeds, motor speed and time are shown in "
    "the body frame (forward, left), effects of position in the world frame (x, y). Red: "
    "significant at the 1 % level over all panels and at least 2 % of the motors' acceleration. "
    "Orange: significant but smaller."
)
#: Opacity of the total band and of the band from the parameters.
_TOTAL, _PARAMETERS = 0.35, 0.55
#: Largest half width of a band in a panel, in units of the largest error.
_MOST_SHOWN = 5.0


def residual_report(
    model: Model,
    trajectory: Trajectory,
    tests: ResidualTests,
    fit: FitMeasures,
    out: str | os.PathLike[str],
    bands: Sequence[PredictionBands] = (),
    origin: Origin | None = None,
) -> Path:
    """Write a page on the residual tests."""
    caption = (
        "Correlations of the one-step innovations in the body frame, corrected for late packets, "
        f"{tests.samples} samples. Top: autocorrelation. Bottom: correlation with the command at "
        "each lag; broad lines are motors whose test rejects at the 1 % level. Negative lags are "
        "future commands. Bands hold 99 % of the values pointwise if the model is complete."
    )
    residuals = Picture("residuals", residual_figure(tests, model.vehicle), caption)
    structure = Picture("structure", structure_figure(tests), _STRUCTURE)
    sections = [
        PageSection("tests", "Residual tests", (Text(tests.verdicts, bullets=True), residuals)),
        PageSection("structure", "Structure of the residuals", (structure,)),
        *([_bands_section(bands)] if bands else []),
        PageSection("fit", "Fit", (fit_table([model.name], [fit]), _noise_table(tests))),
        sources_section(trajectory),
    ]
    verdict = "all tests passed" if tests.passed else "some residuals remain unexplained"
    lead = (
        f"{model.name} on {trajectory.duration:.1f} s of flight: {verdict}. An innovation is a "
        "measured pose minus its one-step prediction; with the true model, innovations are white "
        "and independent of the commands."
    )
    return write_page(out, f"Residuals of {model.name}", lead, sections, origin)


def _bands_section(bands: Sequence[PredictionBands]) -> PageSection:
    """Show predicted and measured trajectories."""
    parameters = (
        "The dark part comes from the parameters' standard errors alone. "
        if bands[0].by_parameters is not None
        else "The model file has no standard errors, so the bands exclude parameter errors. "
    )
    caption = (
        "Predictions from the estimate of a filter that sees only the poses before; right columns: "
        f"measured minus predicted. Bands should hold 95 % of the measured poses. {parameters}The "
        "rest is pose noise and unmodelled motion, estimated from one-step innovations. The "
        "simulation shown has the median error. Errors are propagated linearly: once the band of "
        "yaw exceeds a radian, the bands of x and y are only orders of magnitude."
    )
    both = bands[0], bands[-1]
    panels = list(zip(both, _drawn_windows(*both), strict=True))
    if any(_cut_at(*panel, channel) for panel in panels for channel in range(3)):
        caption += (
            f" Bands wider than {_MOST_SHOWN:g} times the largest error are truncated; the table "
            "lists their widths."
        )
    picture = Picture("prediction_bands", prediction_bands_figure(bands[0], bands[-1]), caption)
    return PageSection("bands", "Predictions", (picture, band_table(bands)))


def _noise_table(tests: ResidualTests) -> PageTable:
    """Tabulate the estimated noise."""
    noise = tests.innovations.noise
    kinds = (
        ("pose", noise.pose, "m, m, rad"),
        ("white acceleration", noise.acceleration, "m/s²/√Hz, rad/s²/√Hz"),
        ("disturbance random walk", noise.disturbance, "m/s³/√Hz, rad/s³/√Hz"),
    )
    rows = [[name, *(f"{v:.3g}" for v in values), unit] for name, values, unit in kinds]
    caption = "Maximum-likelihood noise: standard deviation of the poses, and spectral densities."
    return PageTable(caption, ["", "x", "y", "γ", "unit"], rows)


@style.styled
def residual_figure(tests: ResidualTests, vehicle: Vehicle) -> Figure:
    """Draw the correlations of the innovations with their 99 % bands.

    The upper row is their autocorrelation, the lower row their correlation with commands. Positive
    lags are past commands. Negative lags are future ones, which correlate only under feedback or if
    the model's delay is too long.
    """
    figure = style.new_figure(style.PAGE_WIDTH, 5.2)
    rows = figure.subplots(2, len(tests.whiteness), squeeze=False)
    colors = style.propeller_colors(vehicle)
    styles = {}
    for i, (name, color) in enumerate(zip(vehicle.propeller_names, colors, strict=True)):
        # Dashed: the second propeller of a pair.
        styles[name] = {"color": color, "ls": "-" if colors.index(color) == i else (0, (3, 1.2))}
    for above, below, white in zip(*rows, tests.whiteness, strict=True):
        lags = np.arange(1, len(white.autocorrelation) + 1)
        _draw_white_band(above, white.band)
        color = style.BLUE if white.passed else style.VERMILLION
        above.vlines(lags, 0, white.autocorrelation, color=color, lw=1.2)
        above.plot(lags, white.autocorrelation, ".", color=color, ms=4)
        above.set_title(f"{white.channel}: {'white' if white.passed else 'not white'}", loc="left")
        above.set(xlabel="lag [samples]", xlim=(0, lags[-1] + 1))
        _draw_correlations(below, tests, white.channel, styles)
    rows[0, 0].set_ylabel("autocorrelation [–]")
    rows[1, 0].set_ylabel("correlation with commands [–]")
    for row in rows:
        reach = max(np.abs(axes.get_ylim()).max() for axes in row)
        for axes in row:
            axes.set_ylim(-reach, reach)
    handles: list[Artist] = [Patch(color=style.LIGHT, label="99 % band")]
    handles += [style.key(name, **line) for name, line in styles.items()]
    style.top_legend(figure, handles, columns=min(len(handles), 7))
    return figure


@style.styled
def structure_figure(tests: ResidualTests) -> Figure:
    """Draw the residuals over each regressor (columns) for each channel (rows)."""
    regressors = list(dict.fromkeys(one.regressor for one in tests.structure))
    figure = style.new_figure(style.PAGE_WIDTH, 5.4)
    grid = figure.subplots(3, len(regressors), squeeze=False, sharex="col", sharey="row")
    for k, column in enumerate(np.moveaxis(grid, 1, 0)):
        channels = [one for one in tests.structure if one.regressor == regressors[k]]
        for axes, one in zip(column, channels, strict=True):
            _draw_structure(axes, one)
        column[-1].set_xlabel(f"{regressors[k]}\n[{channels[0].regressor_unit}]")
    for axes, name in zip(
        grid[:, 0], ("forward, or x [m/s²]", "left, or y [m/s²]", "yaw [rad/s²]"), strict=True
    ):
        axes.set_ylabel(name)
    handles: list[Artist] = [
        style.key("mean in a bin, 99 % band", style.BLUE),
        style.key("significant, below 2 % of the motors' acceleration", style.ORANGE),
        style.key("significant", style.VERMILLION),
    ]
    style.top_legend(figure, handles)
    return figure


def _draw_structure(axes: Axes, one: Structure) -> None:
    """Draw the bin means of one channel over one regressor."""
    color = style.BLUE if not one.shown else style.ORANGE if one.passed else style.VERMILLION
    axes.axhline(0, color=style.GREY, lw=0.7)
    axes.errorbar(one.middle, one.mean, one.half_band, color=color, marker="o", ms=3, lw=1.1)
    axes.margins(x=0.08)


def _draw_correlations(
    axes: Axes, tests: ResidualTests, channel: str, styles: Mapping[str, Mapping[str, Any]]
) -> None:
    """Draw the correlation of one channel with each command; failed tests are bold."""
    correlations = [test for test in tests.correlations if test.channel == channel]
    if correlations:
        _draw_white_band(axes, max(test.band for test in correlations))
    for test in correlations:
        reach = len(test.correlation) // 2
        axes.plot(
            np.arange(-reach, reach + 1),
            test.correlation,
            **styles[test.motor],
            lw=0.9 if test.passed else 1.9,
            alpha=0.6 if test.passed else 1.0,
        )
        axes.set_xlim(-reach, reach)
    axes.axvline(0, color=style.GREY, lw=0.7)
    failed = sum(not test.passed for test in correlations)
    verdict = f"{failed} of {len(correlations)} motors fail" if failed else "all motors pass"
    axes.set_title(f"{channel}: {verdict}", loc="left")
    axes.set_xlabel("lag behind the command [samples]")


def _draw_white_band(axes: Axes, band: float) -> None:
    """Shade the band that holds 99 % of the correlations of white noise."""
    axes.axhspan(-band, band, color=style.LIGHT, lw=0)
    axes.axhline(0, color=style.GREY, lw=0.7)


def typical_window(bands: PredictionBands) -> int:
    """Return the window with the median error."""
    errors = (bands.predicted - bands.measured)[-1]
    scale = np.sqrt(np.mean(errors**2, axis=1, keepdims=True))
    size = np.sum((errors / np.where(scale > 0, scale, 1.0)) ** 2, axis=0)
    return int(np.argsort(size, kind="stable")[(len(size) - 1) // 2])


def _drawn_windows(
    ahead: PredictionBands, simulated: PredictionBands
) -> tuple[list[int], list[int]]:
    """Return the shorter predictions within a typical simulation, and that simulation."""
    whole = typical_window(simulated)
    begin, end = simulated.start[whole], simulated.time[-1, whole]
    return np.flatnonzero((ahead.start >= begin) & (ahead.time[-1] <= end + 1e-9)).tolist(), [whole]


def _cut_at(bands: PredictionBands, windows: list[int], channel: int) -> float | None:
    """Return the half width at which a panel truncates its bands; None if it need not."""
    error = (bands.measured - bands.predicted)[:, channel, windows]
    reach = _MOST_SHOWN * float(np.abs(error).max(initial=0.0))
    widest = np.nanmax(bands.total[:, channel, windows], initial=0.0)
    return reach if widest > reach > 0 else None


@style.styled
def prediction_bands_figure(ahead: PredictionBands, simulated: PredictionBands) -> Figure:
    """Draw predictions with their bands over a few seconds of a recording.

    Left: measured poses, short predictions and a simulation. Middle: errors and bands of the short
    predictions. Right: errors and bands of the simulation, which has the median error. Bands much
    wider than the errors are truncated.
    """
    figure = style.new_figure(style.PAGE_WIDTH, 6.4)
    shown, (whole,) = _drawn_windows(ahead, simulated)
    grid = figure.subplots(3, 3, sharex=True)
    for channel, (pose, left, right) in enumerate(grid):
        time = simulated.time[:, whole]
        pose.plot(time, simulated.measured[:, channel, whole], color=style.BLACK, lw=2.4, alpha=0.5)
        middle, half = simulated.predicted[:, channel, whole], simulated.total[:, channel, whole]
        pose.fill_between(time, middle - half, middle + half, color=style.SKY, alpha=_TOTAL, lw=0)
        pose.plot(time, middle, color=style.ORANGE, lw=1.1)
        for k in shown:
            short = ahead.predicted[:, channel, k]
            pose.plot(ahead.time[:, k], short, color=style.BLUE, lw=1.1, zorder=3)
            _draw_errors(left, ahead, k, channel)
        _draw_errors(right, simulated, whole, channel)
        if (reach := _cut_at(simulated, [whole], channel)) is not None:
            drawn = np.concatenate([line.get_ydata() for line in pose.lines])
            pose.set_ylim(drawn.min() - reach / 2, drawn.max() + reach / 2)
        name = "xyγ"[channel]
        pose.set_ylabel(f"{name} [{'rad' if channel == 2 else 'm'}]")
        for axes, bands, windows in ((left, ahead, shown), (right, simulated, [whole])):
            if (reach := _cut_at(bands, windows, channel)) is not None:
                reach *= style.ERRORS[channel][2]
                axes.set_ylim(-reach, reach)
            axes.set_ylabel(f"error of {name} [{style.ERRORS[channel][1]}]")
            held = f"{bands.coverage[channel]:.0f} % of {len(bands.start)} held"
            axes.set_title(f"{bands.horizon:.1f} s: {held}", loc="left")
    grid[0, 0].set_title("poses", loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
        axes.margins(x=0.01)
    handles: list[Artist] = [
        style.key("measured", lw=2.4, alpha=0.5),
        style.key(f"predicted {ahead.horizon:.1f} s ahead", style.BLUE),
        style.key(f"simulated for {simulated.horizon:.1f} s", style.ORANGE),
        Patch(color=style.SKY, alpha=_TOTAL, label="95 % band"),
    ]
    if ahead.by_parameters is not None:
        handles.append(Patch(color=style.BLUE, alpha=_PARAMETERS, label="from parameters"))
    style.top_legend(figure, handles)
    return figure


def _draw_errors(axes: Axes, bands: PredictionBands, window: int, channel: int) -> None:
    """Draw measured minus predicted for one window, with its bands around zero."""
    factor, time = style.ERRORS[channel][2], bands.time[:, window]
    parts = [(bands.total, style.SKY, _TOTAL)]
    if bands.by_parameters is not None:
        parts.append((bands.by_parameters, style.BLUE, _PARAMETERS))
    for band, color, alpha in parts:
        half = factor * band[:, channel, window]
        axes.fill_between(time, -half, half, color=color, alpha=alpha, lw=0)
    error = factor * (bands.measured - bands.predicted)[:, channel, window]
    axes.plot(time, error, color=style.BLACK, lw=1.0)
