"""Commands that plan the fastest flight, and fly it."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.kinds import unknown
from airpuck.boundary.settings import Setting
from airpuck.cli import inputs, options
from airpuck.cli.app import command
from airpuck.cli.output import draw, report, show_time_left, table
from airpuck.planning.settings import Limits

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.planning.plan import Plan
    from airpuck.planning.request import Goal
    from airpuck.twin.experiments import Race

_PANEL = "Control and flight"


@command(
    _PANEL,
    rare=(
        "spin",
        "speed",
        "margin",
        "smoothing",
        "end_velocity",
        "free",
        "turn",
        "keep_out",
        "size",
        "intervals",
    ),
)
def plan(
    start: Annotated[
        tuple[float, float, float],
        Setting("Initial pose of the craft.", numbers.COORDINATE, "X Y YAW", "--from"),
    ],
    goal: Annotated[
        tuple[float, float, float], Setting("Goal pose.", numbers.COORDINATE, "X Y YAW", "--to")
    ],
    limits: Limits,
    model: options.ModelName = "paper:M3",
    velocity: Annotated[
        tuple[float, float, float], Setting("Initial velocity.", numbers.COORDINATE, "VX VY W")
    ] = (0.0, 0.0, 0.0),
    end_velocity: Annotated[
        tuple[float, float, float], Setting("Final velocity.", numbers.COORDINATE, "VX VY W")
    ] = (0.0, 0.0, 0.0),
    free: Annotated[
        Literal["yaw", "velocity", "both"] | None,
        Setting("Final quantities that are free; by default none."),
    ] = None,
    turn: Annotated[
        Literal["shorter", "exact"],
        Setting("Turn the shorter way to the yaw, or keep its whole turns."),
    ] = "shorter",
    via: Annotated[
        list[tuple[float, float]] | None,
        Setting("A point to pass; repeat for several, in order.", numbers.COORDINATE, "X Y"),
    ] = None,
    keep_out: Annotated[
        list[tuple[float, float, float]] | None,
        Setting("A disc to avoid; repeat for several.", numbers.COORDINATE, "X Y R"),
    ] = None,
    size: Annotated[
        tuple[float, float] | None,
        Setting("Length and width of the table.", numbers.TABLE_SIDE, "L W", "--table"),
    ] = None,
    intervals: Annotated[
        int, Setting("Intervals of constant commands in a leg.", numbers.INTERVALS, "N")
    ] = 40,
    output: Annotated[Path | None, options.output("FILE", "Plan file to write (TOML).")] = None,
    figure: Annotated[
        Path | None,
        options.output("FILE", "Figure of path and thrusts to write, a PNG.", "--figure"),
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
        via=via or (),
        keep_out=keep_out or (),
        table=rails,
        limits=limits,
        intervals=intervals,
    )
    if output is not None:
        found.save(output)
    drawn = draw(figure, "plan_figures.plan_figure", found, rails)
    report(found.to_json(), json_file, _starts_table(found), _sentence(found), output, drawn)


@command(_PANEL)
def race(
    model: options.RacingModel = "paper:M3",
    course: Annotated[
        str,
        Argument(
            metavar="COURSE",
            help="A course to plan (straight, slalom, eight), or a plan by `airpuck plan`.",
        ),
    ] = "straight",
    truth: options.Truth = "paper:M3",
    law: options.LawName = None,
    seeds: Annotated[
        int,
        Setting(
            "Number of flights, each with its own noise and radio.", numbers.CHECK_FLIGHTS, "N"
        ),
    ] = 10,
    twin: options.ReadTwin = None,
    tuning: options.TuningFile = None,
    figure: Annotated[
        Path | None, options.output("FILE", "Figure of all flights to write, a PNG.", "--figure")
    ] = None,
    animation: Annotated[
        Path | None,
        options.output(
            "FILE", "Animation of the first flight to write, as GIF or HTML.", "--animation"
        ),
    ] = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Fly a plan on the twin; without points and discs, also fly to its goal as a set point."""
    from airpuck.planning.plan import is_plan, read_plan
    from airpuck.twin import experiments as racing
    from airpuck.twin.settings import default_twin_settings

    if model in racing.COURSES or is_plan(model):
        raise InputError(f"the model comes first: airpuck race paper:M3 {model}", field=model)
    settings = twin or default_twin_settings()
    belief = inputs.read_belief(model)
    if course in racing.COURSES:
        planned = racing.course_plan(course, belief, settings)
    elif course.endswith(".toml"):
        planned = read_plan(course, belief)
    else:
        raise InputError(unknown(course, [*racing.COURSES, "PLAN.toml"]), field="COURSE")
    with show_time_left("flights", quiet) as progress:
        found = racing.race(
            planned,
            airpuck.read_model(truth),
            seeds=seeds,
            settings=settings,
            tuning=inputs.read_controls(tuning, law, belief),
            progress=progress,
        )
    draw(figure, "plan_figures.race_figure", found, settings.table)
    if animation is not None:
        airpuck.animate(found.recording, animation, vehicle=belief.vehicle)
    report(found.to_json(), json_file, _race_table(found), figure, animation)


def _race_table(found: Race) -> Table:
    """Tabulate planned and flown times."""
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
    """Return the goal; raise InputError if something is both given and free."""
    if free in ("velocity", "both") and any(velocity):
        raise InputError("is given and left free; choose one", field="--end-velocity")
    if free in ("yaw", "both") and turn != "shorter":
        raise InputError("has no effect on a free yaw; leave it out", field="--turn")
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
    """Tabulate the starts of the search."""
    rows = [
        (start.name, "–" if start.time_s is None else f"{start.time_s:.4f}", start.status)
        for start in found.starts
    ]
    title = f"Starts of the search; the slowest is {100 * found.spread:.1f} % slower than the best"
    return table(("start", "s", "solver"), rows, title=title, left=("start", "solver"))
