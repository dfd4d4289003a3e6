"""Commands that plan the fastest flight, and fly it."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Option

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.cli import inputs, options
from airpuck.cli.app import app, repeated
from airpuck.cli.output import report, show_time_left, table
from airpuck.planning.settings import Limits

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.planning.plan import Plan
    from airpuck.planning.request import Goal
    from airpuck.twin.race import Race

_PANEL = "Control and flight"


@app.command(rich_help_panel=_PANEL, cls=repeated(via=2, keep_out=3))
def plan(
    limits: Limits,
    start: Annotated[
        tuple[float, float, float],
        options.number("X Y YAW", "Initial pose of the craft.", numbers.COORDINATE, "--from"),
    ],
    goal: Annotated[
        tuple[float, float, float],
        options.number("X Y YAW", "Goal pose.", numbers.COORDINATE, "--to"),
    ],
    model: Annotated[str, options.BELIEVED_MODEL] = "paper:M3",
    velocity: Annotated[
        tuple[float, float, float],
        options.number("VX VY W", "Initial velocity.", numbers.COORDINATE, "--velocity"),
    ] = (0.0, 0.0, 0.0),
    end_velocity: Annotated[
        tuple[float, float, float],
        options.number("VX VY W", "Final velocity.", numbers.COORDINATE, "--end-velocity"),
    ] = (0.0, 0.0, 0.0),
    free: Annotated[
        Literal["yaw", "velocity", "both"] | None,
        Option(help="Final quantities that are free; by default none."),
    ] = None,
    turn: Annotated[
        Literal["shorter", "exact"], Option(help="Count whole turns of the yaw.")
    ] = "shorter",
    via: Annotated[
        list[str] | None,
        Option("--via", metavar="X Y", help="A point to pass; repeat for several, in order."),
    ] = None,
    keep_out: Annotated[
        list[str] | None,
        Option("--keep-out", metavar="X Y R", help="A disc to avoid; repeat for several."),
    ] = None,
    size: Annotated[
        tuple[float, float] | None,
        options.number("L W", "Length and width of the table.", numbers.TABLE_SIDE, "--table"),
    ] = None,
    intervals: Annotated[
        int, options.number("N", "Intervals of constant commands in a leg.", numbers.INTERVALS)
    ] = 40,
    output: Annotated[Path | None, options.output("FILE", "Plan to write; TOML.")] = None,
    figure: Annotated[
        Path | None, options.output("FILE", "Draw path and thrusts; a PNG.", "--figure")
    ] = None,
    json_file: options.Json = None,
) -> None:
    """Plan the fastest flight from one state to another, with a lower bound on its time."""
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
        limits=limits,
        intervals=intervals,
    )
    if output is not None:
        found.save(output)
    if figure is not None:
        from airpuck.report.plan_figures import plan_figure
        from airpuck.report.style import write_png

        write_png(plan_figure(found, rails), figure)
    report(found.to_json(), json_file, _starts_table(found), _sentence(found), output, figure)


@app.command(rich_help_panel=_PANEL)
def race(
    plan: Annotated[
        Path | None,
        Option("--plan", metavar="FILE", help="A plan by `airpuck plan`, instead of a course."),
    ] = None,
    course: Annotated[
        Literal["straight", "slalom", "eight"] | None,
        Option(help="The course to plan and fly; by default straight."),
    ] = None,
    model: Annotated[str, options.CONTROLLERS_MODEL] = "paper:M3",
    truth: Annotated[str, Option(metavar="MODEL", help="Truth of the twin.")] = "paper:M3",
    regulator: options.RegulatorName = None,
    reserve: Annotated[
        float | None,
        options.number(
            "R", "Fraction of thrust reserved for feedback, by default 0.1.", numbers.RESERVE
        ),
    ] = None,
    seeds: Annotated[
        int,
        options.number(
            "N", "Number of flights, each with its own noise and radio.", numbers.CHECK_FLIGHTS
        ),
    ] = 10,
    twin: options.TwinFile = None,
    tuning: options.TuningFile = None,
    figure: Annotated[
        Path | None, options.output("FILE", "Draw all flights; a PNG.", "--figure")
    ] = None,
    animation: Annotated[
        Path | None,
        options.output("FILE", "The first flight, as GIF or HTML.", "--animation"),
    ] = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Fly a plan on the twin; without points and discs, also fly to its goal as a set point."""
    from airpuck.planning.plan import read_plan
    from airpuck.twin import race as racing
    from airpuck.twin.settings import default_twin_settings

    settings = inputs.read_twin(twin) or default_twin_settings()
    belief = inputs.read_belief(model)
    if plan is not None and (course, reserve) != (None, None):
        raise InputError("is planned already; leave --course and --reserve out", field="--plan")
    if plan is not None:
        planned = read_plan(plan, belief)
    else:
        share = 0.1 if reserve is None else reserve
        planned = racing.course_plan(course or "straight", belief, settings, share)
    with show_time_left("flights", quiet) as progress:
        found = racing.race(
            planned,
            airpuck.read_model(truth),
            seeds=seeds,
            settings=settings,
            tuning=inputs.read_controls(tuning, regulator, belief),
            progress=progress,
        )
    if figure is not None:
        from airpuck.report.plan_figures import race_figure
        from airpuck.report.style import write_png

        write_png(race_figure(found, settings.table), figure)
    if animation is not None:
        airpuck.animate(found.recording, animation, vehicle=belief.vehicle)
    report(found.to_json(), json_file, _race_table(found), figure, animation)


def _race_table(found: Race) -> Table:
    """Lay out planned and flown times."""
    rows = [
        ("no control takes less than", _known(found.plan.lower_bound), ""),
        ("planned", f"{found.plan.duration:.3f}", ""),
    ]
    for name, times in (("flown", found.flown), ("as a set point", found.set_point or ())):
        if not times:  # another task
            continue
        reached = [time for time in times if time is not None]
        middle = f"{median(reached):.3f}" if reached else "–"
        worst = f"worst {max(reached):.3f}; " if reached else ""
        rows.append((name, middle, f"{worst}{len(reached)} of {len(times)} reached the goal"))
    title = f"Times to the goal; contacts with a rail: {found.contacts}"
    if found.plan.keep_out:
        title += f"; flights that touched a disc: {found.touches}"
    return table(("", "s", "flights"), rows, title=title, left=("", "flights"))


def _goal(
    pose: tuple[float, float, float],
    velocity: tuple[float, float, float],
    free: Literal["yaw", "velocity", "both"] | None,
    turn: Literal["shorter", "exact"],
) -> Goal:
    """Return the goal; raise InputError for a velocity that is both given and free."""
    if free in ("velocity", "both") and any(velocity):
        raise InputError("is given and left free; choose one", field="--end-velocity")
    x, y, yaw = pose
    rates = None if free in ("velocity", "both") else velocity
    return airpuck.Goal(x, y, None if free in ("yaw", "both") else yaw, rates, turn)


def _known(bound: float | None) -> str:
    return "–" if bound is None else f"{bound:.3f}"


def _sentence(found: Plan) -> str:
    """Describe the flight's time, and its lower bound."""
    bound, limits = found.lower_bound, "these limits of spin and speed"
    if bound is None:
        return (
            f"{found.duration:.3f} s; the time has no lower bound, because an effect of the model "
            "states no bounds"
        )
    if bound == 0:
        return f"{found.duration:.3f} s; no lower bound was found"
    return (
        f"{found.duration:.3f} s; no craft with these motors, within {limits}, "
        f"can do it in less than {bound:.3f} s"
    )


def _starts_table(found: Plan) -> Table:
    """Lay out the starts of the search."""
    rows = [
        (start.name, "–" if start.time_s is None else f"{start.time_s:.4f}", start.status)
        for start in found.starts
    ]
    title = f"Starts of the search; the slowest is {100 * found.spread:.1f} % slower than the best"
    return table(("start", "s", "solver"), rows, title=title, left=("start", "solver"))
