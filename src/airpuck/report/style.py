"""Shared style of figures: colours with fixed meanings, sizes, legends, grids of panels.

The palette of Okabe and Ito suits all types of colour vision. Figures are plain
`matplotlib.figure.Figure` objects: no pyplot, no global state. Matplotlib is imported where it
draws: pages in the browser need the colours only, and importing it takes a second.
"""

from __future__ import annotations

import functools
import io
import itertools
import os
from collections.abc import Callable, Iterable, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal, ParamSpec

import numpy as np
from jaxtyping import Float

from airpuck.boundary.outputs import replacing
from airpuck.control.law import Bound
from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure
    from matplotlib.lines import Line2D

BLACK, GREY, LIGHT = "#222222", "#767676", "#d9d9d9"
BLUE, ORANGE, GREEN, VERMILLION = "#0072b2", "#e69f00", "#009e73", "#d55e00"
SKY, PURPLE = "#56b4e9", "#cc79a7"
#: Colours of animations: the table, and the set point.
FLOOR, HOLES, GRID, RAIL = "#f4f7fa", "#cbd6e0", "#dfe6ed", "#a5b2bf"
ASKED = "#a93f7c"

#: Colours and labels of a plan by the limit that binds.
BOUND_COLORS: dict[Bound, str] = {"nothing": GREEN, "motor": ORANGE, "motion": VERMILLION}
BOUND_WORDS: dict[Bound, str] = {
    "nothing": "plan: no limit",
    "motor": "plan: a motor at its limit",
    "motion": "plan: at a rail, disc, speed or spin",
}

#: Colour of each rung of the model ladder.
RUNG_COLORS = {"M0": GREY, "M1": ORANGE, "M2": GREEN, "M3": BLUE, "M4": VERMILLION}
#: Colours of pairs of propellers and of unpaired propellers.
_PAIR_COLORS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK, "#8c6d31", GREY, "#b3a700")

#: Dashes of reference lines.
DASHED = (0, (4, 2))

#: Name, unit in figures and factor from SI of each channel of a prediction error.
ERRORS = (("x", "mm", 1e3), ("y", "mm", 1e3), ("yaw γ", "rad", 1.0))
#: Name and unit of each channel of a pose.
POSE = (("x", "m"), ("y", "m"), ("yaw", "rad"))

#: Width of a figure that fills a page [in] and resolution of the PNG [1/in].
PAGE_WIDTH, RESOLUTION = 8.6, 130

Arguments = ParamSpec("Arguments")


@functools.cache
def look() -> Any:
    """Return what all figures look like, in matplotlib's words."""
    from matplotlib import rc_params_from_file

    file = resources.files("airpuck") / "packaged" / "figures.mplstyle"
    return rc_params_from_file(str(file), use_default_template=False)


def styled(draw: Callable[Arguments, Figure]) -> Callable[Arguments, Figure]:
    """Decorate a function so that it draws in the style of the package."""

    @functools.wraps(draw)
    def in_style(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Figure:
        from matplotlib import rc_context

        with rc_context(look()):
            return draw(*args, **kwargs)

    return in_style


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure with an Agg canvas, which needs no display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = Figure(figsize=(width, height), layout=ConstrainedLayoutEngine(w_pad=0.07, h_pad=0.05))
    FigureCanvasAgg(figure)
    return figure


def drawn(figure: Figure, suffix: Literal["png", "pdf", "svg"]) -> bytes:
    """Draw a figure in a format: PNG for pages and screens, PDF and SVG for papers."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    # Without dates and versions, the same figure gives the same file.
    changing = {"png": {"Software": None}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}
    metadata = changing[suffix]
    with rc_context(look()):  # ticks are created on the first draw
        layout = figure.get_layout_engine()
        if layout is not None:
            # The layout costs as much as drawing, so it runs once for all formats.
            layout.execute(figure)
            figure.set_layout_engine(None)
        figure.savefig(buffer, format=suffix, dpi=RESOLUTION, metadata=metadata)
    return buffer.getvalue()


def write_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure as PDF or SVG if its name ends so, otherwise as PNG."""
    formats: dict[str, Literal["pdf", "svg"]] = {".pdf": "pdf", ".svg": "svg"}
    with replacing(path) as temporary:
        temporary.write_bytes(drawn(figure, formats.get(temporary.suffix, "png")))


def model_colors(names: Iterable[str]) -> dict[str, str]:
    """Return a colour for each model of a figure; rungs keep theirs."""
    names = list(dict.fromkeys(names))
    taken = {RUNG_COLORS[name] for name in names if name in RUNG_COLORS}
    free = [color for color in (BLUE, VERMILLION, GREEN, *_PAIR_COLORS) if color not in taken]
    others = itertools.cycle(dict.fromkeys(free))
    return {name: RUNG_COLORS.get(name) or next(others) for name in names}


def propeller_colors(vehicle: Vehicle) -> list[str]:
    """Return a colour for each propeller; the two of a pair share one."""
    colors = [""] * vehicle.n_propellers
    for number, group in enumerate(propeller_groups(vehicle)):
        for index in group:
            colors[index] = _PAIR_COLORS[number % len(_PAIR_COLORS)]
    return colors


def propeller_groups(vehicle: Vehicle) -> list[tuple[int, ...]]:
    """Return the pairs, and each unpaired propeller as its own group."""
    groups: list[tuple[int, ...]] = [tuple(sorted(pair)) for pair in vehicle.opposed]
    paired = {index for pair in groups for index in pair}
    groups += [(index,) for index in range(vehicle.n_propellers) if index not in paired]
    return sorted(groups)


def closest_propellers(vehicle: Vehicle) -> float:
    """Return the smallest distance between propellers that do not share an axle [m]."""
    x, y = vehicle.positions.T
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    return float(np.where(apart > 1e-3, apart, np.inf).min())


def propeller_size(vehicle: Vehicle) -> float:
    """Return a radius at which drawn propellers do not overlap [m]."""
    return min(0.16 * vehicle.radius_m, 0.42 * closest_propellers(vehicle))


def panels(figure: Figure, count: int, columns: int, **sharing: Any) -> list[Axes]:
    """Add a grid of panels, row by row; spare places stay empty."""
    grid = figure.subplots(-(-count // columns), columns, squeeze=False, **sharing).ravel()
    for spare in grid[count:]:
        spare.set_visible(False)
    return list(grid[:count])


def draw_rails(axes: Axes, table: Table, inset: float = 0.0, **look: Any) -> None:
    """Draw the rails of a table, or the limit at a distance from them [m]."""
    from matplotlib.patches import Rectangle

    x, y = table.reach(inset)
    look = {"facecolor": "none", "edgecolor": RAIL, "lw": 2, **look}
    axes.add_patch(Rectangle((-x, -y), 2 * x, 2 * y, **look))


def label_rows(axes: Axes, labels: Sequence[str]) -> Float[np.ndarray, " rows"]:
    """Label rows from top to bottom; return their y coordinates."""
    rows = -np.arange(len(labels), dtype=float)
    axes.set_yticks(rows, labels)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_ylim(rows[-1] - 0.5, 0.5)
    return rows


def draw_arrow(
    axes: Axes, start: tuple[float, float], end: tuple[float, float], **look: Any
) -> None:
    """Draw an arrow from one point to another."""
    look = {"shrinkA": 0, "shrinkB": 0, "color": BLACK, **look}
    axes.annotate("", end, start, arrowprops=look, annotation_clip=False, zorder=5)


def key(label: str, color: str = BLACK, **line: Any) -> Line2D:
    """Return a legend entry."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, label=label, **line)


def top_legend(
    figure: Figure | SubFigure, handles: Sequence[Artist], columns: int | None = None
) -> None:
    """Put one legend above all axes."""
    figure.legend(
        handles=list(handles),
        loc="outside upper center",
        ncols=columns or len(handles),
        handlelength=2.4,
        columnspacing=1.6,
    )
