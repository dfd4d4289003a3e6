"""The command that plans the fastest flight."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Option

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.cli import inputs, options
from airpuck.cli.app import app, repeated
from airpuck.cli.output import report, table

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.planning.plan import Plan
    from airpuck.planning.request import Goal

_PANEL = "Control and flight"


@app.command(rich_help_panel=_PANEL, cls=repeated(via=2, keep_out=3))
def plan(
    start: Annotated[
        tuple[float, float, float],
        options.number("X Y YAW", "Where the craft is.", numbers.COORDINATE, "--from"),
    ],
    goal: Annotated[
        tuple[float, float, float],
        options.number("X Y YAW", "Where it is to be.", numbers.COORDINATE, "--to"),
    ],
    model: Annotated[str, options.BELIEVED_MODEL] = "paper:M3",
    velocity: Annotated[
        tuple[float, float, float],
        options.number("VX VY W", "How fast it is.", numbers.COORDINATE, "--velocity"),
    ] = (0.0, 0.0, 0.0),
    end_velocity: Annotated[
        tuple[float, float, float],
        options.number("VX VY W", "How fast it is to be.", numbers.COORDINATE, "--end-velocity"),
    ] = (0.0, 0.0, 0.0),
    free: Annotated[
        Literal["yaw", "velocity", "both"] | None,
        Option(help="What is left open at the end; by default nothing."),
    ] = None,
    turn: Annotated[
        Literal["shorter", "exact"], Option(help="Whether whole turns of the yaw count.")
    ] = "shorter",
    via: Annotated[
        list[str] | None,
        Option("--via", metavar="X Y", help="A point to pass; repeat for several, in order."),
    ] = None,
    keep_out: Annotated[
        list[str] | None,
        Option("--keep-out", metavar="X Y R", help="A disc not to touch; repeat for several."),
    ] = None,
    size: Annotated[
        tuple[float, float] | None,
        options.number("L W", "Length and width of the table.", numbers.TABLE_SIDE, "--table"),
    ] = None,
    reserve: Annotated[
        float, options.number("R", "Share of thrust kept for feedback.", numbers.RESERVE)
    ] = 0.0,
    spin: Annotated[
        float, options.number("W", "Largest spin in rad/s.", numbers.SPIN_LIMIT)
    ] = 15.0,
    speed: Annotated[
        float, options.number("V", "Largest speed along x and y in m/s.", numbers.SPEED_LIMIT)
    ] = 3.0,
    margin: Annotated[
        float, options.number("M", "Distance to keep from the rails.", numbers.CLEARANCE)
    ] = 0.0,
    intervals: Annotated[
        int, options.number("N", "Intervals of constant commands in a leg.", numbers.INTERVALS)
    ] = 40,
    output: Annotated[Path | None, options.output("FILE", "Plan to write; TOML.")] = None,
    figure: Annotated[
        Path | None, options.output("FILE", "Draw path and thrusts; a PNG.", "--figure")
    ] = None,
    json_file: options.Json = None,
) -> None:
    """Plan the fastest flight from one state to another, and say what no control can undercut."""
    from airpuck.craft.table import Table as Rails

    rails = Rails() if size is None else Rails(length_m=size[0], width_m=size[1])
    found = airpuck.plan(
        inputs.read_belief(model),
        (*start, *velocity),
        _goal(goal, end_velocity, free, turn),
        via=inputs.rows(via or [], 2, "--via", "give two numbers: x [m], y [m]"),
        keep_out=inputs.rows(
            keep_out or [], 3, "--keep-out", "give three numbers: x [m], y [m], radius [m]"
        ),
        table=rails,
        limits=airpuck.Limits(reserve, spin, speed, margin),
        intervals=intervals,
    )
    if output is not None:
        found.save(output)
    if figure is not None:
        from airpuck.report.plan_figure import write_plan_figure

        write_plan_figure(found, figure, rails)
    report(found.to_json(), json_file, _starts_table(found), _sentence(found), output, figure)


def _goal(
    pose: tuple[float, float, float],
    velocity: tuple[float, float, float],
    free: Literal["yaw", "velocity", "both"] | None,
    turn: Literal["shorter", "exact"],
) -> Goal:
    """Return the goal; refuse a velocity that is both given and free."""
    if free in ("velocity", "both") and any(velocity):
        raise InputError("is given and left free; choose one", field="--end-velocity")
    x, y, yaw = pose
    rates = None if free in ("velocity", "both") else velocity
    return airpuck.Goal(x, y, None if free in ("yaw", "both") else yaw, rates, turn)


def _sentence(found: Plan) -> str:
    """Say how fast it is, and how fast it cannot be."""
    bound, limits = found.lower_bound, "these limits of spin and speed"
    return (
        f"{found.duration:.3f} s; no craft with these motors, within {limits}, "
        f"can do it in less than {bound:.3f} s"
    )


def _starts_table(found: Plan) -> Table:
    """Lay out what the search began with."""
    rows = [
        (start.name, "–" if start.time_s is None else f"{start.time_s:.4f}", start.status)
        for start in found.starts
    ]
    title = f"Starts of the search; the slowest is {100 * found.spread:.1f} % slower than the best"
    return table(("start", "s", "solver"), rows, title=title, left=("start", "solver"))
