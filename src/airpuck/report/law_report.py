"""What the laws of a controller did on the same flight: where a predictive one is among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from airpuck.report import style
from airpuck.report.page import Picture, Section, Table, Text
from airpuck.report.replay_report import OUTCOMES
from airpuck.twin.tracking_study import Tracked


def predicts(flights: Sequence[Tracked]) -> bool:
    """Return whether a predictive law is among the flights."""
    return any(flight.regulator == "mpc" for flight in flights)


def flight_colors(flights: Sequence[Tracked]) -> list[str]:
    """Return a colour for each flight: that of its model, or of its law where laws differ."""
    if not predicts(flights):
        return [style.rung_color(flight.model) for flight in flights]
    colors = style.model_colors(flight.label for flight in flights)
    return [colors[flight.label] for flight in flights]


def summary(flights: Sequence[Tracked]) -> Section:
    """Say in words what the flights have to tell."""
    bullets = [
        _joined("Settling", flights, _settled),
        _joined("Distance from the set point, root mean square", flights, _distance),
        _joined("Motors at full command", flights, _saturated),
        _joined("Nearest to a rail", flights, lambda f: f"{1e3 * f.clearance.min():.0f} mm"),
        _joined("Time per control step, median and 99 %", flights, _times),
    ]
    return Section("words", "In words", [Text(bullets, bullets=True)])


def _joined(what: str, flights: Sequence[Tracked], say: Callable[[Tracked], str]) -> str:
    """Say one thing of each flight."""
    return f"{what}: {'; '.join(f'{flight.label} {say(flight)}' for flight in flights)}."


def _settled(flight: Tracked) -> str:
    """Say where a flight settled, and how fast."""
    times = [result.settling_time for result in flight.results]
    done = [time for time in times if time is not None]
    if not done:
        return "at none of the set points"
    where = "at every set point" if len(done) == len(times) else f"at {len(done)} of {len(times)}"
    return f"{where}, after {np.mean(done):.2f} s on average"


def _distance(flight: Tracked) -> str:
    """Say how far a flight was from its set points."""
    x, y, yaw = np.sqrt(np.mean(flight.twin.errors**2, axis=0))
    return f"{1e3 * np.hypot(x, y):.0f} mm and {yaw:.2f} rad"


def _saturated(flight: Tracked) -> str:
    """Say how often motors were at full command."""
    each, some = flight.saturated.mean(), flight.saturated.any(axis=1).mean()
    return (
        f"{100 * each:.1f} % of the commands (one motor at least: {100 * some:.0f} % of the time)"
    )


def _times(flight: Tracked) -> str:
    """Say how long control steps took."""
    median, most, _ = flight.step_times
    return f"{median:.2f} and {most:.2f} ms"


def law_sections(flights: Sequence[Tracked]) -> list[Section]:
    """Return what a page shows of several laws beside poses and commands."""
    planned = (
        "Every tenth plan of the predictive law over its horizon, coloured by what holds it back; "
        "a dot is where it ends. The broad line is the way that was flown. Outer frame: the rails; "
        "dashed: how far the middle of the craft can get."
    )
    nearest = "How far the edge of the craft is from the nearest rail; at zero it touches it."
    return [
        Section(
            "errors",
            "Distance from the set point",
            [Picture("errors", error_figure(flights), "Pose minus the set point in force.")],
        ),
        Section(
            "above",
            "From above, with the plans",
            [Picture("above", path_figure(flights), planned), _limits_table(flights)],
        ),
        Section("rails", "Rails", [Picture("rails", clearance_figure(flights), nearest)]),
        Section("time", "Time and outcome of each step", _step_tables(flights)),
    ]


def _limits_table(flights: Sequence[Tracked]) -> Table:
    """Tabulate how often plans were at which limit."""
    kinds = ("motor", "rail", "disc", "speed", "spin")
    rows = []
    for flight in flights:
        plans = list(flight.log.predictions.values())
        if plans:
            shares = [np.mean([kind in plan.active for plan in plans]) for kind in kinds]
            rows.append([flight.label, *(f"{100 * share:.0f} %" for share in shares)])
    return Table("Share of the plans that are at a limit somewhere.", ["flight", *kinds], rows)


def _step_tables(flights: Sequence[Tracked]) -> list[Table]:
    """Tabulate what control steps took, and how they ended."""
    times = [[flight.label, *(f"{ms:.2f}" for ms in flight.step_times)] for flight in flights]
    taken = Table(
        "What a control step took on this machine, with all else that it did. airpuck fly asks "
        "the system for priority.",
        ["flight", "median [ms]", "99 % [ms]", "longest [ms]"],
        times,
    )
    ended = [
        [flight.label, status, str(count), OUTCOMES[status]]
        for flight in flights
        for status, count in flight.outcomes.items()
    ]
    return [taken, Table("How steps ended.", ["flight", "outcome", "steps", "meaning"], ended)]


@style.styled
def error_figure(flights: Sequence[Tracked]) -> Figure:
    """Draw pose minus set point over time."""
    figure = style.new_figure(style.PAGE_WIDTH, 4.6)
    axes = style.panels(figure, 3, 1, sharex=True)
    for one, (name, unit, factor), channel in zip(axes, style.ERRORS, range(3), strict=True):
        one.axhline(0.0, color=style.GREY, linewidth=0.8)
        for flight, color in zip(flights, flight_colors(flights), strict=True):
            time = flight.twin.time - flight.origin
            one.plot(time, factor * flight.twin.errors[:, channel], color=color, linewidth=1.4)
        one.set_ylabel(f"{name} [{unit}]")
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(0.0, _end(flights))
    style.top_legend(figure, _keys(flights))
    return figure


@style.styled
def clearance_figure(flights: Sequence[Tracked]) -> Figure:
    """Draw the distance to the nearest rail over time."""
    figure = style.new_figure(style.PAGE_WIDTH, 2.6)
    axes = figure.subplots()
    axes.axhline(0.0, color=style.RAIL, linewidth=3.0)
    for flight, color in zip(flights, flight_colors(flights), strict=True):
        axes.plot(flight.twin.time - flight.origin, 1e3 * flight.clearance, color=color)
    axes.set(xlabel="time [s]", ylabel="to the nearest rail [mm]", xlim=(0.0, _end(flights)))
    style.top_legend(figure, [*_keys(flights), style.key("rail", style.RAIL, linewidth=3.0)])
    return figure


@style.styled
def path_figure(flights: Sequence[Tracked]) -> Figure:
    """Draw the ways from above, to scale, with the plans of predictive laws."""
    count = len(flights)
    figure = style.new_figure(style.PAGE_WIDTH, 0.5 + 2.4 * -(-count // 2))
    panels = style.panels(figure, count, min(count, 2), sharex=True, sharey=True)
    for axes, flight in zip(panels, flights, strict=True):
        _draw_way(axes, flight)
        axes.label_outer()
    keys = [
        style.key("flown", style.LIGHT, lw=6.0),
        style.key("set point", style.ASKED, marker="+", lw=0),
    ]
    keys += [
        style.key(style.BOUND_WORDS[k], color, marker=".", lw=1.1)
        for k, color in style.BOUND_COLORS.items()
    ]
    style.top_legend(figure, keys)
    return figure


def _draw_way(axes: Axes, flight: Tracked) -> None:
    """Draw one flight from above."""
    table, radius = flight.table, flight.vehicle.radius_m
    for (x, y), look in (
        (table.reach(0.0), {"edgecolor": style.RAIL, "lw": 3.0}),
        (table.reach(radius), {"edgecolor": style.GREY, "lw": 0.8, "ls": style.DASHED}),
    ):
        axes.add_patch(Rectangle((-x, -y), 2 * x, 2 * y, fill=False, **look))
    plans = list(flight.log.predictions.values())
    lines = LineCollection(
        [plan.states[:, :2].tolist() for plan in plans],
        colors=[style.BOUND_COLORS[plan.bound_by] for plan in plans],
        lw=1.1,
        zorder=3,
    )
    axes.add_collection(lines)
    for plan in plans:
        axes.plot(
            *plan.states[-1, :2], ".", color=style.BOUND_COLORS[plan.bound_by], ms=4, zorder=3
        )
    axes.plot(*flight.twin.pose[:, :2].T, color=style.LIGHT, lw=6.0, zorder=2)
    axes.plot(*flight.twin.set_points.poses[:, :2].T, "+", color=style.ASKED, ms=9, mew=2, zorder=4)
    x, y = table.reach(-0.04)
    axes.set(xlim=(-x, x), ylim=(-y, y), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(flight.label, loc="left")


def _end(flights: Sequence[Tracked]) -> float:
    """Return where the axis of time ends [s]."""
    return max(float(flight.twin.time[-1]) - flight.origin for flight in flights)


def _keys(flights: Sequence[Tracked]) -> list[Artist]:
    """Return entries of a legend, one for each flight."""
    named = zip(flights, flight_colors(flights), strict=True)
    return [style.key(flight.label, color) for flight, color in named]
