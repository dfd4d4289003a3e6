"""Figures and tables of a fit and of a proposed flight: thrusts, parameters, packet delays."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.deviation.packet_delays import PacketDelays
from airpuck.evaluation.presentation import (
    NOT_IDENTIFIED,
    main_quantities,
    physical_thrust,
    propeller_accelerations,
    thrust_scale,
)
from airpuck.experiment_design.design import Design
from airpuck.model.model_file import Model
from airpuck.model.quantities import IN_MATRIX, QUANTITIES
from airpuck.model.tolerances import bar
from airpuck.physics.thrust import thrust
from airpuck.report import style
from airpuck.report.page import PageTable

#: Quantities in the order of the paper's table:models.
_LADDER = [quantity for quantity in QUANTITIES if quantity.rungs]


class Cell(NamedTuple):
    """One value in a table of parameters."""

    #: Value ± standard error, if known; a dash if the model does not use the quantity.
    text: str = "–"
    #: Whether it was learned.
    free: bool = False


class TableRow(NamedTuple):
    """One line of a table of parameters."""

    label: str
    unit: str
    #: One cell for each model.
    cells: list[Cell]


def parameter_table(
    caption: str,
    headings: Sequence[str],
    rows: Sequence[TableRow],
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
        rows.append(TableRow(model.name, rung.summary, cells))
    caption = (
        "Table 1 of the paper: free and fixed parameters of each rung. A dash: not used. Π “from "
        "the others”: by first principles."
    )
    headings = [q.symbol if "," in q.unit else f"{q.symbol} [{q.unit}]" for q in _LADDER]
    return parameter_table(caption, ["model", "", *headings], rows)


def main_rows(models: Sequence[Model]) -> list[TableRow]:
    """Tabulate the main quantities; thrusts come last."""
    listed = {q.label: q for model in models for q in main_quantities(model)}
    rows = [
        row
        for q in listed.values()
        for row in _rows(models, [q.label], q.unit, q.parameter, q.value, q.form)
    ]
    return sorted(rows, key=lambda row: row.label.startswith("F("))


def coefficient_rows(models: Sequence[Model]) -> list[TableRow]:
    """Tabulate every thrust coefficient at the learned scale."""
    degree = max(np.shape(model.parameters.thrust)[1] for model in models)
    letters = [chr(ord("a") + power) for power in range(degree)]
    labels = [f"{a} {name}" for name in models[0].vehicle.propeller_names for a in letters]

    def coefficients(model: Model) -> Any:
        thrust = model.parameters.thrust
        return np.pad(thrust, ((0, 0), (0, degree - thrust.shape[1])))

    return _rows(models, labels, "N", "thrust", coefficients, ".4f")


def effect_rows(models: Sequence[Model]) -> list[TableRow]:
    """Tabulate the effect of each propeller at full speed, which does not depend on scale."""

    def rows(label: str, unit: str, values: Callable[[Model], Any], form: str) -> list[TableRow]:
        labels = [f"{label} {name}" for name in models[0].vehicle.propeller_names]
        return _rows(models, labels, unit, "thrust", values, form)

    return [
        *rows("m‖Π_xy‖", "–", thrust_scale, ".3f"),
        *rows("‖Π_xy‖ F(1)", "m/s²", lambda model: propeller_accelerations(model)[0], ".3f"),
        *rows("Π_yaw F(1)", "rad/s²", lambda model: propeller_accelerations(model)[1], ".1f"),
    ]


def _rows(
    models: Sequence[Model],
    labels: Sequence[str],
    unit: str,
    quantity: str,
    values: Callable[[Model], Any],
    form: str,
) -> list[TableRow]:
    """Tabulate values derived from a parameter: a row for each value, a cell for each model."""
    columns = [_cells(model, len(labels), quantity, values, form) for model in models]
    return [TableRow(label, unit, cells) for label, *cells in zip(labels, *columns, strict=True)]


def _cells(
    model: Model, count: int, quantity: str, values: Callable[[Model], Any], form: str
) -> list[Cell]:
    """Format the values of one model, with standard errors if known."""
    unused = model.parameters.configuration_matrix is not None and quantity in IN_MATRIX
    if unused or getattr(model.parameters, quantity) is None:
        return [Cell()] * count
    free = quantity in model.learned
    cells = []
    errors = np.ravel(bar(model, values))
    for value, error in zip(np.ravel(values(model)), errors, strict=True):
        known = np.isfinite(error) and error > 0
        if free and model.known is not None and not np.isfinite(error):
            cells.append(Cell(NOT_IDENTIFIED, free))
            continue
        cells.append(Cell(f"{value:{form}}" + f" ± {error:{form}}" * bool(known), free))
    return cells


#: Width of a bin of commands, and upper end of the scale of shares [%].
_BIN, _TOP = 0.05, 30.0
#: Bins of the histogram of packet delays.
_DELAY_BINS = 24


#: Drawing style of a 95 % band.
BAND: dict[str, Any] = {"alpha": 0.18, "lw": 0, "zorder": 1.5}


@style.styled
def thrust_figure(
    models: Sequence[Model],
    trajectory: Trajectory | None = None,
    reference: Sequence[Model] = (),
    label: str = "published",
    commands: str = "commands in training",
) -> Figure:
    """Draw the thrust of every motor over its speed, and which speeds were commanded.

    Broad: fitted, with 95 % bands where a model stores its uncertainty; dashed: the reference. Grey
    bars are a histogram of the commands, the bracket is their range. All curves are in newtons, at
    the physical scale.
    """
    vehicle = models[0].vehicle
    order, columns = _arrangement(vehicle)
    rows = -(-len(order) // columns)
    colors = style.model_colors(model.name for model in (*models, *reference))
    figure = style.new_figure(style.PAGE_WIDTH if columns > 2 else 6.4, 0.6 + 2.25 * rows)
    grid = style.panels(figure, len(order), columns, sharex=True, sharey=True)
    speed = np.linspace(0, 1, 201)
    broad, dashed = {"lw": 3.0, "alpha": 0.45, "zorder": 2}, {"lw": 1.1, "ls": style.DASHED}
    curves = [(model, thrust_curves(model, speed), broad) for model in models]
    curves += [(model, thrust_curves(model, speed), {**dashed, "zorder": 3}) for model in reference]
    bands = [(m, thrust_band(m, speed)) for m in models if m.known is not None]
    for axes, motor in zip(grid, order, strict=True):
        for model, curve, line in curves:
            axes.plot(speed, curve[motor], color=colors[model.name], **line)
        for model, band in bands:
            axes.fill_between(speed, *band[:, motor], color=colors[model.name], **BAND)
        axes.set_title(vehicle.propeller_names[motor], loc="left", fontsize=9)
    # A very wide band must not compress the scale of the curves.
    highest = max(float(curve.max()) for _, curve, _ in curves)
    widest = max((np.nanmax(band[1], initial=0.0) for _, band in bands), default=0.0)
    highest = max(highest, min(widest, 1.3 * highest))
    for number, (axes, motor) in enumerate(zip(grid, order, strict=True)):
        axes.set(xlim=(0, 1), ylim=(0, 1.08 * highest))
        axes.set(xlabel="motor speed φ, command u [–]", ylabel="thrust [N]")
        axes.label_outer()
        if trajectory is not None:
            used = trajectory.input[trajectory.usable, motor]
            _draw_commands(axes, used, last=number % columns == columns - 1)
    handles: list[Artist] = [
        style.key(_label(model), colors[model.name], lw=3, alpha=0.6) for model in models
    ]
    if bands:
        color = colors[models[0].name] if len(models) == 1 else style.SKY
        handles.append(Patch(color=color, alpha=0.25, lw=0, label="95 % interval"))
    if reference:
        handles.append(style.key(label, **dashed))
    if trajectory is not None:
        handles.append(Patch(color=style.LIGHT, label=commands))
    style.top_legend(figure, handles)
    return figure


def thrust_curves(model: Model, speed: Float[np.ndarray, " K"]) -> Float[np.ndarray, "n K"]:
    """Compute the thrust of every motor over its speed, at the physical scale [N]."""
    coefficients = physical_thrust(model)
    return thrust(coefficients, np.broadcast_to(speed, (len(coefficients), len(speed))))


def thrust_band(model: Model, speed: Float[np.ndarray, " K"]) -> Float[np.ndarray, "2 n K"]:
    """Return the 95 % bands of all thrust curves; the model must store its uncertainty."""
    assert model.known is not None
    reach = model.known.quantile * model.standard_error(lambda m: thrust_curves(m, speed))
    middle = thrust_curves(model, speed)
    return np.stack([middle - reach, middle + reach])


def _label(model: Model) -> str:
    """Name a model, and note a scale that was fixed after the fit."""
    direct = model.parameters.configuration_matrix is not None
    return f"{model.name} (scale fixed)" if direct else model.name


def _arrangement(vehicle: Vehicle) -> tuple[list[int], int]:
    """Return the order of the motors in a grid and its columns; up to four pairs form columns."""
    groups = style.propeller_groups(vehicle)
    if len(groups) <= 4 and {len(group) for group in groups} == {2}:
        return [group[row] for row in (0, 1) for group in groups], len(groups)
    return list(range(vehicle.n_propellers)), min(vehicle.n_propellers, 4)


def _draw_commands(axes: Axes, commands: Float[np.ndarray, " N"], *, last: bool) -> None:
    """Draw a histogram of commands on a second scale."""
    share, edges = np.histogram(commands, bins=np.arange(0, 1 + _BIN / 2, _BIN))
    share = 100 * share / max(len(commands), 1)
    scale = axes.twinx()
    scale.set_zorder(axes.get_zorder() - 1)
    axes.patch.set_visible(False)
    scale.grid(False)
    scale.bar(edges[:-1], share, _BIN, align="edge", color=style.LIGHT, edgecolor="white", lw=0.6)
    scale.set(ylim=(0, _TOP), yticks=(0, 5, 10))
    scale.tick_params(colors=style.GREY, labelright=last, right=last)
    if last:
        scale.set_ylabel("samples [%]", color=style.GREY, loc="bottom")
    small = {"fontsize": 7.5, "color": style.GREY}
    for left, value in zip(edges[:-1], share, strict=True):
        if value > _TOP:
            scale.text(left + 1.2 * _BIN, 0.97 * _TOP, f"{value:.0f} %", va="top", **small)
    low, high = float(commands.min()), float(commands.max())
    axes.set_title(f"u from {low:.2g} to {high:.2g}", loc="right", fontweight="normal", **small)
    style.draw_arrow(scale, (low, 0.0), (high, 0.0), arrowstyle="|-|", mutation_scale=3)


@style.styled
def parameter_figure(
    fitted: Sequence[Model], reference: Mapping[str, Model], label: str = "published"
) -> Figure:
    """Draw relative differences between fitted and reference parameters, with 95 % intervals.

    Shows the linear and angular acceleration of each propeller at full speed, then inertia and time
    constant where learned. Accelerations are products of Π and thrust, so models that learn Π
    compare, too. The fits give the intervals.
    """
    models = [model for model in fitted if model.name in reference]
    names = models[0].vehicle.propeller_names
    figure = style.new_figure(style.PAGE_WIDTH, 1.35 + 0.3 * len(names))
    linear, angular, scalars = figure.subplots(1, 3, width_ratios=(1, 1, 0.8))
    full = {m.name: _ratios(m, reference[m.name], propeller_accelerations) for m in models}
    for kind, axes, quantity in ((0, linear, "linear"), (1, angular, "angular")):
        _draw_ratios(axes, names, {name: ratio[:, kind] for name, ratio in full.items()})
        axes.set_title(f"{quantity} acceleration at φ = 1", loc="left")
    angular.set_yticklabels([])
    ratios = {m.name: _ratios(m, reference[m.name], _scalars) for m in models}
    for m in models:
        ratios[m.name][:, [name not in m.learned for name in _SCALARS]] = np.nan
    _draw_ratios(scalars, ("inertia I", "lag τ"), ratios)
    scalars.set_title("where learned", loc="left")
    for axes in (linear, angular, scalars):
        axes.set_xlabel(f"fitted against {label} [%]")
    colors = style.model_colors(ratios)
    handles = [style.key(n, color, ls="", marker="o") for n, color in colors.items()]
    style.top_legend(figure, handles)
    return figure


#: Quantities shown next to the accelerations.
_SCALARS = ("inertia", "motor_time_constant")


def _scalars(model: Model) -> Float[np.ndarray, " 2"]:
    """Return the quantities shown next to the accelerations."""
    return np.array([float(getattr(model.parameters, name)) for name in _SCALARS])


def _ratios(
    model: Model, reference: Model, quantity: Callable[[Model], Any]
) -> Float[np.ndarray, "2 *shape"]:
    """Divide quantities, and half their 95 % intervals, by the reference's."""
    ours, theirs = np.asarray(quantity(model)), np.asarray(quantity(reference))
    known = model.known
    reach = known.quantile * model.standard_error(quantity) if known else np.zeros_like(ours)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.stack([ours / theirs, np.abs(reach / theirs)])


def _draw_ratios(
    axes: Axes, labels: Sequence[str], ratios: Mapping[str, Float[np.ndarray, "2 K"]]
) -> None:
    """Draw ratios as differences in percent: a row for each label, a colour for each model."""
    rows = style.label_rows(axes, labels)
    spread = np.linspace(0.26, -0.26, len(ratios)) if len(ratios) > 1 else (0.0,)
    colors = style.model_colors(ratios)
    for offset, (name, (ratio, reach)) in zip(spread, ratios.items(), strict=False):
        reach = 100 * np.where(np.isfinite(reach), reach, 0.0)
        look: dict[str, Any] = {"color": colors[name], "ls": "", "marker": "o", "ms": 4.5}
        axes.errorbar(100 * (ratio - 1), rows + offset, xerr=reach, elinewidth=1.1, **look)
    for row in rows[:-1]:
        axes.axhline(row - 0.5, color="#e6e6e6", lw=0.6)
    axes.axvline(0, color=style.BLACK, lw=0.8)


@style.styled
def packet_delay_figure(
    sent: Float[np.ndarray, " K"], delays: PacketDelays, model: Model
) -> Figure:
    """Draw the known packet delays, ± two standard errors, and their distribution."""
    figure = style.new_figure(style.PAGE_WIDTH, 2.9)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=[2.6, 1.0])
    mean = 1e3 * model.transport_delay
    delay, reach = mean + 1e3 * delays.deviation, 2e3 * delays.standard_error
    dots = {"ls": "", "marker": "o", "ms": 2.6, "lw": 0.7}
    left.errorbar(sent[delays.packet], delay, reach, color=style.BLUE, **dots)
    label = "mean, learned with the model"
    handles = [left.axhline(mean, color=style.GREY, lw=1.0, label=label)]
    left.set(xlabel="time [s]", ylabel="delay of a packet [ms]")
    bars: dict[str, Any] = {"orientation": "horizontal", "alpha": 0.55}
    count, edges, _ = right.hist(delay, _DELAY_BINS, color=style.BLUE, **bars)
    right.axhline(mean, color=style.GREY, lw=1.0)
    right.set(xlabel="packets", xlim=(0, 1.08 * count.max()))
    jitter = model.delay_jitter
    if jitter is not None and jitter.standard_deviation_s > 0:
        spread, center = 1e3 * jitter.standard_deviation_s, float(np.mean(delay))
        at = np.linspace(edges[0], edges[-1], 200)
        density = np.exp(-(((at - center) / spread) ** 2) / 2) / (spread * np.sqrt(2 * np.pi))
        expected = density * len(delay) * (edges[1] - edges[0])
        label = f"normal, jitter of {spread:.1f} ms"
        handles += right.plot(expected, at, color=style.VERMILLION, label=label)
    style.top_legend(figure, handles)
    return figure


@style.styled
def design_figure(found: Design) -> Figure:
    """Draw the relative standard errors of all quantities: now, usual, proposed."""
    figure = style.new_figure(style.PAGE_WIDTH, 1.0 + 0.24 * len(found.quantities.labels))
    axes = figure.add_subplot()
    rows = style.label_rows(axes, found.quantities.labels)
    usual, proposal = 100 * found.usual.relative, 100 * found.proposal.relative
    axes.hlines(rows, usual, proposal, color=style.LIGHT, lw=2.5)
    dots: dict[str, Any] = {"ls": "", "ms": 5.5}
    handles = []
    if np.isfinite(found.relative_before).any():
        now = 100 * found.relative_before
        handles += axes.plot(now, rows, marker="s", color=style.GREY, label="now", **dots)
    dots["marker"] = "o"
    label = "usual excitation, predicted"
    handles += axes.plot(usual, rows, color=style.GREY, mfc="white", label=label, **dots)
    handles += axes.plot(proposal, rows, color=style.BLUE, label="proposal, predicted", **dots)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
    axes.grid(visible=True, axis="x", which="minor")
    axes.set_xlabel(
        f"standard error after {found.proposal.plan.duration_s:g} s [% of the quantity's scale]"
    )
    style.top_legend(figure, handles)
    return figure
