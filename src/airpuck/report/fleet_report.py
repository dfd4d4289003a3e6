"""The report on a flight of several craft: `airpuck fleet -o`."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from airpuck.boundary.outputs import replacing
from airpuck.fleet.flight import FleetFlight
from airpuck.fleet.scenario import Fleet
from airpuck.report import style
from airpuck.report.animation import LASTS, RATE, Mover, moving_drawing, write_gif
from airpuck.report.page import Origin, PageSection, PageTable, Picture, Text, write_page

#: Colours of the craft, repeated for more.
_COLORS = (style.BLUE, style.VERMILLION, style.GREEN, style.PURPLE, style.ORANGE, style.SKY)
#: Length of the trails of the animation [s].
_TRAIL = 1.2


def fleet_report(
    flight: FleetFlight, fleet: Fleet, out: str | os.PathLike[str], origin: Origin | None = None
) -> Path:
    """Write a page on a flight: an animation, the paths, the distances."""
    drawn = fleet_animation(flight, fleet)
    moving = Picture("flight", drawn, "In real time. Dashed: goals.", moves=True)
    paths = Picture(
        "paths", path_figure(flight, fleet), "Paths from the starts (open) to the goals (dashed)."
    )
    gaps = Picture(
        "gaps",
        gap_figure(flight),
        "Smallest gap between the edges of any two craft; at zero they touch.",
    )
    margins = Text(
        [
            "Any two paths are at least both radii and both margins apart. A margin is how far a "
            "craft may stray from its path, given what its model does not know."
        ]
    )
    sections = [
        PageSection("flight", "Flight", (moving, _table(flight))),
        PageSection("paths", "Paths", (paths, margins)),
        PageSection("gaps", "Distances", (gaps,)),
    ]
    return write_page(
        out, "Several craft on one table", " ".join(sentences(flight)), sections, origin
    )


def sentences(flight: FleetFlight) -> Iterator[str]:
    """Describe a flight."""
    count = len(flight.names)
    if math.isfinite(flight.settled):
        yield f"{count} craft arrived within {flight.settled:.2f} s."
    else:
        late = [n for n, t in flight.arrived.items() if n not in flight.died and t == math.inf]
        yield f"{', '.join(late)} did not arrive within {flight.time[-1]:.0f} s."
    touched = [c for c in flight.contacts if not {c[1], c[2]} & set(flight.died)]
    if touched:
        time, one, other, speed = touched[0]
        yield f"{one} and {other} collided at {time:.2f} s, at {speed:.2f} m/s."
    elif count > 1:
        yield f"There were no collisions; the smallest gap was {1e3 * flight.least_gap:.0f} mm."
    for name, time in flight.died.items():
        met = [c for c in flight.contacts if name in c[1:3]]
        hit = f"; it was hit at {max(c[3] for c in met):.2f} m/s" if met else ""
        yield f"{name} died at {time:.2f} s{hit}."


def _table(flight: FleetFlight) -> PageTable:
    """Tabulate arrivals and distances from the paths."""
    rows = []
    for k, name in enumerate(flight.names):
        time = flight.arrived[name]
        arrived = f"{time:.2f}" if math.isfinite(time) else "–"
        if name in flight.died:
            arrived = f"died at {flight.died[name]:.2f}"
        off, margin = 1e3 * flight.strayed[k], 1e3 * flight.margins[k]
        rows.append((name, arrived, f"{off:.1f}", f"{margin:.1f}"))
    return PageTable(
        "When each craft arrived, how far it strayed from its path, and the margin for that.",
        ("craft", "arrived [s]", "strayed [mm]", "margin [mm]"),
        rows,
    )


def _color(k: int) -> str:
    return _COLORS[k % len(_COLORS)]


@style.styled
def _scenery(fleet: Fleet) -> Figure:
    """Draw the table and the obstacles from above."""
    figure, table = style.new_figure(style.PAGE_WIDTH, 4.6), fleet.settings.table
    axes = figure.subplots()
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    x, y = 0.52 * table.length_m, 0.52 * table.width_m
    axes.set(xlim=(-x, x), ylim=(-y, y))
    style.draw_rails(axes, table, facecolor=style.FLOOR, zorder=0)
    for disc in fleet.scenario.obstacles:
        place = disc.x_m, disc.y_m
        axes.add_patch(Circle(place, disc.radius_m, fc=style.GREY, ec="none"))
    return figure


@style.styled
def path_figure(flight: FleetFlight, fleet: Fleet) -> Figure:
    """Draw all paths from above."""
    figure = _scenery(fleet)
    axes = figure.axes[0]
    for k, name in enumerate(flight.names):
        color, track, radius = _color(k), flight.poses[:, k], flight.radii[k]
        axes.plot(track[:, 0], track[:, 1], color=color, lw=1.6)
        axes.add_patch(Circle(tuple(track[0, :2]), radius, fc="none", ec=color, lw=1.2))
        goal = fleet.member(name).goals[-1]
        axes.add_patch(
            Circle(tuple(goal[:2]), radius, fc="none", ec=color, ls=style.DASHED, lw=1.2)
        )
        above = track[0, 1] + 1.15 * radius
        axes.text(track[0, 0], above, name, ha="center", va="bottom", color=color, fontsize=9)
    return figure


@style.styled
def gap_figure(flight: FleetFlight) -> Figure:
    """Draw the smallest gap of all pairs over time, of live craft and of those that died."""
    figure = style.new_figure(style.PAGE_WIDTH, 2.6)
    axes = figure.subplots()
    gaps = flight.gaps
    dead = np.array([name in flight.died for name in flight.names])
    pairs = dead[:, None] | dead
    for chosen, color, label in (
        (~pairs, style.BLUE, "live craft"),
        (pairs, style.VERMILLION, "with a craft that died"),
    ):
        if chosen.any() and len(dead) > 1:
            least = np.where(chosen, gaps, np.inf).min(axis=(1, 2))
            axes.plot(flight.time, 1e3 * least, color=color, label=label)
    axes.axhline(0, color=style.GREY, lw=0.8)
    axes.set(xlabel="time [s]", ylabel="smallest gap [mm]", xlim=(0, flight.time[-1]))
    axes.legend()
    return figure


def fleet_animation(flight: FleetFlight, fleet: Fleet) -> str:
    """Return the flight as an animated SVG, which repeats."""
    moving = []
    for k, (name, radius) in enumerate(zip(flight.names, flight.radii, strict=True)):
        goals = Mover("", _color(k), radius, np.zeros(1), fleet.member(name).goals[-1:])
        moving += [goals, Mover(name, _color(k), radius, flight.time, flight.poses[:, k])]
    discs = [(disc.x_m, disc.y_m, disc.radius_m) for disc in fleet.scenario.obstacles]
    return moving_drawing(fleet.settings.table, moving, discs)


def write_fleet_gif(flight: FleetFlight, fleet: Fleet, path: str | os.PathLike[str]) -> None:
    """Write the flight as an animated GIF, in real time."""
    figure, times = _scenery(fleet), np.arange(flight.time[0], flight.time[-1], 1 / RATE)
    rows = np.minimum(np.searchsorted(flight.time, times), len(flight.time) - 1)
    moving = [partial(_moving, figure.axes[0], flight, fleet, row) for row in rows.tolist()]
    with replacing(path) as temporary:
        write_gif(temporary, figure, moving, _COLORS[: len(flight.names)], RATE, LASTS)


def _moving(
    axes: Axes, flight: FleetFlight, fleet: Fleet, row: int
) -> Iterator[tuple[Axes, Artist]]:
    """Yield the craft with their trails and goals at one time."""
    time = flight.time[row]
    first = int(np.searchsorted(flight.time, time - _TRAIL))
    for k, name in enumerate(flight.names):
        color, radius, pose = _color(k), flight.radii[k], flight.poses[row, k]
        goal = fleet.member(name).goal(time)
        head = pose[:2] + 0.6 * radius * np.array([np.cos(pose[2]), np.sin(pose[2])])
        yield axes, LineCollection([flight.poses[first : row + 1, k, :2]], colors=color, lw=2)
        yield axes, Circle(tuple(goal[:2]), radius, fc="none", ec=color, ls=style.DASHED)
        yield axes, Circle(tuple(pose[:2]), radius, fc=(color, 0.3), ec=color, lw=2)
        yield axes, Circle(tuple(head), 0.18 * radius, fc=color, ec="none")
