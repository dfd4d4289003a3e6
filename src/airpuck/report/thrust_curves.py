"""Thrust curves of all motors, and the commands that they were learned from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.gauge import physical_thrust
from airpuck.model.model_file import Model
from airpuck.physics.thrust import thrust
from airpuck.report.style import (
    BLACK,
    GREY,
    LIGHT,
    PAGE_WIDTH,
    SKY,
    new_figure,
    propeller_groups,
    rung_color,
    styled,
    top_legend,
)

#: Width of a bin of commands, and the share of samples at the top of the right-hand scale [%].
_BIN, _TOP = 0.05, 30.0
_SMALL = {"fontsize": 7.5, "fontweight": "normal", "color": GREY}
_BRACKET = {"arrowstyle": "|-|", "mutation_scale": 3, "color": BLACK, "shrinkA": 0, "shrinkB": 0}


@styled
def thrust_figure(
    models: Sequence[Model],
    trajectory: Trajectory | None = None,
    reference: Sequence[Model] = (),
    *,
    reference_label: str = "published",
) -> Figure:
    """Draw the thrust of every motor over its speed, and which speeds were commanded.

    Shows fitted curves (broad) beside the reference (thin, dashed). Grey bars at the bottom give
    the share of the training samples in each twentieth of the command's range, with the range
    that was commanded at all; a curve outside it is extrapolated. Bands are 95 % intervals at each
    speed, where a model knows its uncertainty. Curves of a model with a directly
    learned configuration matrix are brought to newtons (`airpuck.evaluation.gauge`).
    """
    vehicle = models[0].vehicle
    order, rows, columns = _arrangement(vehicle)
    figure = new_figure(PAGE_WIDTH if columns > 2 else 6.4, 0.6 + 2.25 * rows)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    speed = np.linspace(0, 1, 201)
    highest = 0.0
    bands = [_band(model, speed) for model in models]
    for axes, motor in zip(panels.ravel(), order, strict=False):
        for model, band in zip(models, bands, strict=True):
            if band is not None:
                axes.fill_between(
                    speed,
                    *band[:, motor],
                    color=rung_color(model.name),
                    alpha=0.18,
                    lw=0,
                    zorder=1.5,
                )
        for model in [*models, *reference]:
            of_reference = any(model is other for other in reference)
            curve = thrust(physical_thrust(model)[motor : motor + 1], speed[None])[0]
            highest = max(highest, float(curve.max()))
            axes.plot(
                speed,
                curve,
                color=rung_color(model.name),
                lw=1.1 if of_reference else 3.0,
                alpha=1.0 if of_reference else 0.45,
                ls=(0, (4, 2)) if of_reference else "-",
                zorder=3 if of_reference else 2,
            )
        axes.set_title(vehicle.propeller_names[motor], loc="left", fontsize=9)
    # A band that knows nothing must not flatten the curves.
    widest = [np.nanmax(band[1], initial=0.0) for band in bands if band is not None]
    highest = max([highest, *(min(top, 1.3 * highest) for top in widest)])
    for axes, motor in zip(panels.ravel(), order, strict=False):
        axes.set(xlim=(0, 1), ylim=(0, 1.08 * highest))
        axes.set(xlabel="motor speed φ, command u [–]", ylabel="thrust [N]")
        axes.label_outer()
        if trajectory is not None:
            used = trajectory.input[trajectory.usable, motor]
            _draw_commands(axes, used, last=axes in panels[:, -1])
    for axes in panels.ravel()[len(order) :]:
        axes.set_visible(False)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=rung_color(model.name), lw=3, alpha=0.6, label=_label(model))
        for model in models
    ]
    if any(band is not None for band in bands):
        color = rung_color(models[0].name) if len(models) == 1 else SKY
        handles.append(Patch(color=color, alpha=0.25, lw=0, label="95 % interval"))
    if reference:
        handles.append(Line2D([], [], color=BLACK, lw=1.1, ls=(0, (4, 2)), label=reference_label))
    if trajectory is not None:
        handles.append(Patch(color=LIGHT, label="commands in training"))
    top_legend(figure, handles)
    return figure


def _band(model: Model, speed: Float[np.ndarray, " K"]) -> Float[np.ndarray, "2 n K"] | None:
    """Return the ends of the 95 % intervals of all thrust curves; None where there are none."""
    if model.uncertainty is None:
        return None

    def curves(model: Model) -> Float[np.ndarray, "n K"]:
        coefficients = physical_thrust(model)
        return thrust(coefficients, np.broadcast_to(speed, (len(coefficients), len(speed))))

    reach = model.uncertainty.quantile * model.standard_error(curves)
    return np.stack([curves(model) - reach, curves(model) + reach])


def _label(model: Model) -> str:
    """Name a model, and say when its scale was fixed by us."""
    direct = model.parameters.configuration_matrix is not None
    return f"{model.name} (scale fixed)" if direct else model.name


def _arrangement(vehicle: Vehicle) -> tuple[list[int], int, int]:
    """Return the order of the motors in a grid, its rows and its columns."""
    groups = propeller_groups(vehicle)
    if len(groups) <= 4 and {len(group) for group in groups} == {2}:
        return [group[row] for row in (0, 1) for group in groups], 2, len(groups)
    n = vehicle.n_propellers
    columns = min(n, 4)
    return list(range(n)), -(-n // columns), columns


def _draw_commands(axes: Axes, commands: Float[np.ndarray, " N"], *, last: bool) -> None:
    """Draw the share of samples in each bin of commands, on a scale of its own."""
    share, edges = np.histogram(commands, bins=np.arange(0, 1 + _BIN / 2, _BIN))
    share = 100 * share / max(len(commands), 1)
    scale = axes.twinx()
    scale.set_zorder(axes.get_zorder() - 1)
    axes.patch.set_visible(False)
    scale.grid(False)
    scale.bar(edges[:-1], share, _BIN, align="edge", color=LIGHT, edgecolor="white", lw=0.6)
    scale.set(ylim=(0, _TOP), yticks=(0, 5, 10))
    scale.tick_params(colors=GREY, labelright=last, right=last)
    if last:
        scale.set_ylabel("samples [%]", color=GREY, loc="bottom")
    for left, value in zip(edges[:-1], share, strict=True):
        if value > _TOP:
            scale.text(
                left + 1.2 * _BIN, 0.97 * _TOP, f"{value:.0f} %", va="top", color=GREY, fontsize=7.5
            )
    low, high = float(commands.min()), float(commands.max())
    axes.set_title(f"u from {low:.2g} to {high:.2g}", loc="right", **_SMALL)
    scale.annotate(
        "",
        (low, 0.0),
        (high, 0.0),
        arrowprops=_BRACKET,
        annotation_clip=False,
    )
