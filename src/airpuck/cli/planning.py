"""Commands that plan: the fastest flight, which another one flies, and what to fly next."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, unknown
from airpuck.boundary.numbers import percent
from airpuck.boundary.settings import Setting
from airpuck.cli import options
from airpuck.cli.app import command
from airpuck.cli.output import draw, report, show_time_left, table, warn
from airpuck.control.settings import Criterion, ProposedDuration, ProposedMargin
from airpuck.planning.settings import Limits

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.experiment_design.design import CandidateFlight, Design
    from airpuck.model.model_file import Model
    from airpuck.planning.plan import Plan
    from airpuck.planning.request import Goal
    from airpuck.recording.mapping import RecordingMapping
    from airpuck.twin.experiments import Race

_PANEL = "Control and flight"


@command(
    _PANEL,
    rare=(
        *("spin", "speed", "margin", "smoothing", "end_velocity", "free", "turn", "keep_out"),
        *("size", "intervals"),
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
    figure: Annotated[Path | None, options.figure("path and thrusts")] = None,
) -> None:
    """Plan the fastest flight from one state to another, with a lower bound on its time."""
    from airpuck.craft.table import Table as Rails

    rails = Rails() if size is None else Rails(length_m=size[0], width_m=size[1])
    found = airpuck.plan(
        options.read_belief(model),
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
    drawn = draw(figure, "plot.plan_figure", found, rails)
    report(found.to_json(), _starts_table(found), _sentence(found), output, drawn)


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
        int, Setting("Flights, each with its own noise and radio.", numbers.CHECK_FLIGHTS, "N")
    ] = 10,
    twin: options.ReadTwin = None,
    tuning: options.TuningFile = None,
    figure: Annotated[Path | None, options.figure("all flights")] = None,
    animation: Annotated[
        Path | None,
        options.output("FILE", "Animation of the first flight, as GIF or HTML.", "--animation"),
    ] = None,
) -> None:
    """Fly a plan on the twin; without points and discs, also fly to its goal as a set point."""
    from airpuck.planning.plan import is_plan, read_plan
    from airpuck.twin import experiments as racing
    from airpuck.twin.settings import default_twin_settings

    if model in racing.COURSES or is_plan(model):
        raise InputError(f"the model comes first: airpuck race paper:M3 {model}", field=model)
    settings = twin or default_twin_settings()
    belief = options.read_belief(model)
    if course in racing.COURSES:
        planned = racing.course_plan(course, belief, settings)
    elif course.endswith(".toml"):
        planned = read_plan(course, belief)
    else:
        raise InputError(unknown(course, [*racing.COURSES, "PLAN.toml"]), field="COURSE")
    with show_time_left("flights") as progress:
        found = racing.race(
            planned,
            airpuck.read_model(truth),
            seeds=seeds,
            settings=settings,
            tuning=options.read_controls(tuning, law, belief),
            progress=progress,
        )
    draw(figure, "plot.race_figure", found, settings.table)
    if animation is not None:
        airpuck.animate(found.recording, animation, vehicle=belief.vehicle)
    report(found.to_json(), _race_table(found), figure, animation)


def _race_table(found: Race) -> Table:
    """Tabulate planned and flown times."""
    least = found.plan.lower_bound
    rows = [
        ("no control takes less than", "–" if least is None else f"{least:.3f}", ""),
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
    title = f"Search on the coarse grid; the slowest start is {100 * found.spread:.1f} % slower"
    return table(("start", "s", "solver"), rows, title=title, left=("start", "solver"))


#: Candidates to print.
_SHOWN = 8


@command(_PANEL, rare=("criterion", "mapping", "tuning", "seed"))
def design(
    model: options.ModelName = "paper:M3",
    after: Annotated[
        list[Path] | None,
        Setting("Recording to fit first; repeat for several.", metavar="RECORDING"),
    ] = None,
    duration: ProposedDuration = 60.0,
    criterion: Criterion = "worst",
    margin: ProposedMargin = 0.08,
    output: Annotated[Path | None, options.output("FILE", "Plan for excite --plan.")] = None,
    figure: Annotated[Path | None, options.figure("the errors")] = None,
    twin: options.ReadTwin = None,
    tuning: options.TuningFile = None,
    mapping: options.ReadMapping = None,
    seed: options.Seed = 0,
) -> None:
    """Propose the excitation that best reduces the largest parameter errors."""
    craft = airpuck.read_model(model)
    if after:
        craft = _fitted(craft, after, mapping)
    with show_time_left("trial flights") as progress:
        found = airpuck.design(
            craft,
            duration=duration,
            criterion=criterion,
            margin=margin,
            seed=seed,
            settings=twin,
            tuning=options.read_controls(tuning, None, craft),
            progress=progress,
        )
    if output is not None:
        found.proposal.plan.save(output)
    draw(figure, "fit_figures.design_figure", found)
    tables = _candidate_table(found), error_table(found)
    report(found.to_json(), *tables, *summary(found), output, figure)


def _fitted(craft: Model, recordings: list[Path], mapping: RecordingMapping | None) -> Model:
    """Fit a model's rung to recordings, starting from it."""
    from airpuck.experiment_design.forecast import loss_of

    trajectories = [options.load(path, craft.vehicle, mapping) for path in recordings]
    fit = airpuck.identify(
        trajectories,
        craft.rung,
        vehicle=craft.vehicle,
        initial=craft.parameters,
        loss=loss_of(craft),
    )
    warn(fit.warnings)
    return fit.model


def summary(found: Design) -> list[str]:
    """Describe which errors a proposal reduces, and the basis of the forecast."""
    import numpy as np

    labels, counts = found.quantities.labels, np.isfinite(found.quantities.scales)
    usual, proposal = found.usual.relative, found.proposal.relative
    before, since = found.relative_before, "now"
    if not np.isfinite(before).any():
        before, since = usual, "with the usual excitation"
    worst_before, worst = (int(np.argmax(np.where(counts, e, -1))) for e in (before, proposal))
    text = [
        f"{labels[worst_before]}, the worst determined {since}: "
        f"from {percent(before[worst_before])} to {percent(proposal[worst_before])}",
        f"worst after the proposed flight: {labels[worst]}, {percent(proposal[worst])}"
        f" ({percent(usual[worst])} after the usual one)",
    ]
    missing = [labels[k] for k in np.flatnonzero(np.isinf(proposal))]
    if missing:
        text.append(f"stays undetermined: {', '.join(missing)}")
    level = found.residual_level
    if level == 1.0:
        return [*text, "assumes the twin's residuals; a real flight has larger ones (--after)"]
    return [*text, f"variance of the residuals: {level:.2g} times the twin's, as in the fit"]


def _candidate_table(found: Design) -> Table:
    """Tabulate the best candidates, and the usual one."""
    shown = list(found.candidates[:_SHOWN])
    if all(one.plan != found.usual.plan for one in shown):
        shown.append(found.usual)
    proposal, usual = found.proposal.plan, found.usual.plan
    plans = [one.plan for one in shown]
    names = ["proposal" if p == proposal else "usual" if p == usual else "" for p in plans]
    return table(
        ("", "amplitude", "hold s", "margin m", "clearance mm", "error", "remark"),
        [(name, *_row(one)) for name, one in zip(names, shown, strict=True)],
        title=f"Excitations of {proposal.duration_s:g} s, by the "
        + ("largest error" if found.criterion == "worst" else "mean error"),
        left=("", "amplitude", "remark"),
    )


def _row(one: CandidateFlight) -> tuple[str, ...]:
    """Return the cells of a candidate."""
    plan = one.plan
    amplitudes = plan.amplitude if isinstance(plan.amplitude, tuple) else (plan.amplitude,)
    return (
        " ".join(f"{amplitude:g}" for amplitude in amplitudes),
        f"{plan.hold_s:g}",
        f"{plan.margin_m:g}",
        f"{1e3 * one.clearance:.0f}",
        percent(one.score, "–"),
        one.refused and f"refused: {one.refused}",
    )


def error_table(found: Design) -> Table:
    """Tabulate the standard errors of every quantity."""
    headings = ("", "100 % are", "now", "usual", "proposal")
    errors = [found.relative_before, found.usual.relative, found.proposal.relative]
    compared, rows = found.quantities, []
    for k, (label, unit) in enumerate(zip(compared.labels, compared.units, strict=True)):
        scale = compared.scales[k]
        size = f"{scale:.3g} {unit}" if scale < 1e12 else "no scale"
        rows.append([label, size, *(percent(each[k], "–") for each in errors)])
    title = "Standard errors, relative to each quantity's scale"
    return table(headings, rows, title=title, left=("", "100 % are"))
