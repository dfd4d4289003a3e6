"""Commands that fly on the twin or replay a flight, show flights, and export controllers."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Setting
from airpuck.cli import options
from airpuck.cli.app import command
from airpuck.cli.output import page, report, show, show_time_left, table, warn
from airpuck.control.laws import PAPERS
from airpuck.control.settings import ControllerKind, Dwell
from airpuck.export.kinds import KINDS, check_given, kind_named, known_kinds

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.recording.mapping import RecordingMapping
    from airpuck.recording.stream import Recording
    from airpuck.twin.experiments import Excited
    from airpuck.twin.tune import Tuned

PANEL = "Control and flight"


@command(PANEL)
def replay(
    model: options.ModelName,
    flight: Annotated[
        Path, Argument(metavar="FLIGHT", help="A recording with poses, commands and references.")
    ],
    fit_gains: Annotated[
        bool, Option("--fit-gains", help="First fit the law's gains to the log.")
    ] = False,
    law: options.LawName = None,
    tuning: options.TuningFile = None,
    span: options.RecordingPart = None,
    mapping: options.ReadMapping = None,
    output: options.PageFolder = None,
) -> None:
    """Feed a recorded flight to the controller; compare its commands with the recorded ones."""
    from airpuck.report.tables import agreement_table, controller_tables

    craft = options.read_belief(model)
    settings = options.read_controls(tuning, law, craft)
    result = airpuck.replay(
        options.read_recording(flight, mapping),
        craft,
        tuning=settings,
        fit_gains=fit_gains,
        span=span or (0.0, 1.0),
    )
    tables = agreement_table(result), *controller_tables(result)
    written = page(output, "control_report.replay_report", result, craft, settings.period_s)
    report(result.to_json(), *tables, written)


@command(PANEL, rare=("margin_m", "tuning", "twin", "seed"))
def excite(
    output: options.NewBag,
    experiment: options.Experiment,
    seed: options.Seed = 0,
    vehicle: options.ReadVehicle = None,
    truth: Annotated[
        str | None,
        Setting("True model; by default paper:M3, or --vehicle's nominal values.", None, "MODEL"),
    ] = None,
    twin: options.ReadTwin = None,
    tuning: options.TuningFile = None,
    csv: Annotated[bool, Option("--csv", help="Record CSV files instead of a bag.")] = False,
) -> None:
    """Fly the excitation experiment on the twin and record it."""
    from airpuck.twin.experiments import fly_excitation

    usual = None if vehicle else "paper:M3"
    model = options.model_or_nominal(truth or usual, vehicle, airpuck.read_model)
    excited = fly_excitation(
        model, experiment, seed, settings=twin, tuning=options.read_controls(tuning, None, model)
    )
    (airpuck.write_csv if csv else airpuck.write_bag)(excited.recording, output)
    figures = {
        "messages": {name: len(stream) for name, stream in excited.recording.streams.items()},
        "paused_s": excited.paused,
        "rail_contacts_s": list(excited.contacts),
    }
    report(figures, _excitation_line(excited), output)


@command(PANEL, rare=("controller", "estimator", "truth", "tuning"))
def track(
    models: Annotated[
        list[str] | None,
        Argument(metavar="MODEL", help="Models for the controller; by default the paper's."),
    ] = None,
    flights: Annotated[
        list[Path] | None,
        Setting("Real flight to reproduce, one per model.", metavar="FLIGHT", option="--flight"),
    ] = None,
    truth: options.Truth = "paper:M4",
    setpoints: Annotated[
        Path | None, Setting("Set points and their times, as TOML.", metavar="FILE")
    ] = None,
    dwell: Dwell | None = None,
    controller: ControllerKind = None,
    laws: Annotated[
        list[str] | None,
        Setting(
            f"{options.LAWS_THERE_ARE} or pilot; repeat to compare. By default the tuning's.",
            metavar="LAW",
            option="--law",
        ),
    ] = None,
    estimator: options.Estimator = None,
    seed: options.Seed = 0,
    twin: options.ReadTwin = None,
    tuning: options.TuningFile = None,
    output: options.PageFolder = None,
) -> None:
    """Fly set points on the twin: by default the paper's, compared with the real flights.

    With --law lqr --law mpc both laws fly the same task, and the page compares them.
    """
    from airpuck.control.reference import read_setpoints
    from airpuck.flight.loop import pilot_named
    from airpuck.report.tables import tracking_tables

    plant = airpuck.read_model(truth)
    controls = options.read_controls(tuning, None, plant)
    if estimator is not None:
        controls = controls.with_estimator(estimator)
    if flights and (setpoints is not None or dwell is not None):
        raise InputError(
            "sets the set points and times; leave out --setpoints and --dwell", field="flights"
        )
    laws = list(dict.fromkeys(laws or [controls.law.kind]))
    beyond_paper = set(laws) != {PAPERS}
    names = models or ["paper:M0", "paper:M4"][beyond_paper:]
    paths: list[Path | None] = list(flights or ())
    as_flown = controller == "paper" or (controller is None and not beyond_paper)
    if not paths and dwell is None and as_flown and setpoints is None:
        paths = options.published_flights(names)
    if len(paths) > len(names):
        raise InputError("must be given once for each model, in the same order", field="flights")
    beliefs = [options.read_belief(name) for name in names]
    computed = [law for law in laws if pilot_named(law) is None]
    for law in computed:
        options.check_law(tuning, controls.with_law(law), *beliefs)
    for name, given in {"controller": controller, "estimator": estimator}.items():
        if given is not None and not computed:
            raise InputError("has no effect on a pilot; leave it out", field=name)
    tracked = airpuck.tracking_study(
        beliefs,
        plant,
        flights=[path and options.read_recording(path, None) for path in paths],
        set_points=None if setpoints is None else read_setpoints(setpoints),
        dwell=dwell,
        seed=seed,
        controller="paper" if as_flown else "full",
        laws=laws,
        settings=twin,
        tuning=controls,
    )
    of = "the paper" if setpoints is None else setpoints.name
    written = page(output, "control_report.tracking_report", tracked, plant.name, set_points=of)
    for flight in tracked:
        warn(flight.warnings)
    # The top level holds the last model's keys, too: with one model there is nothing to look up.
    flown = [flight.to_json() for flight in tracked]
    report({**flown[-1], "flights": flown}, *tracking_tables(tracked), written)


@command(PANEL, rare=("seed",))
def tune(
    model: options.ModelName,
    output: Annotated[Path, options.output("FILE", "Controller tuning to write.")],
    law: options.LawName = None,
    tuning: options.TuningFile = None,
    twin: options.ReadTwin = None,
    trials: Annotated[int, Setting("Maximum number of tunings.", numbers.CHECK_FLIGHTS, "N")] = 50,
    seed: options.Seed = 0,
) -> None:
    """Find weights of a law by flights on the twin: less error for no more effort.

    Half of the twins are stronger and later than the model: robust weights win.
    """
    craft = options.read_belief(model)
    start = options.read_controls(tuning, law, craft)
    with show_time_left("flights") as told:
        found = airpuck.tune(craft, start, settings=twin, trials=trials, seed=seed, progress=told)
    found.tuning.save(output)
    warn(found.warnings)
    report(found.to_json(), _tuned_table(found), output)


def _tuned_table(found: Tuned) -> Table:
    """Tabulate the weights, and what they change for other craft."""
    both = found.before, found.after
    rows = [(name, f"{was:.3g}", f"{now:.3g}") for name, (was, now) in found.changes.items()]
    rows += [
        ("error [mm]", *(f"{1e3 * one.error_m:.3g}" for one in both)),
        ("effort", *(f"{one.effort:.3g}" for one in both)),
        ("rail contacts", *(str(one.contacts) for one in both)),
        ("additional delay tolerated [ms]", *(f"{1e3 * one.delay_margin_s:.0f}" for one in both)),
        (
            "relative thrust tolerated",
            *("{:.2g} to {:.2g}".format(*one.thrust_margins) for one in both),
        ),
    ]
    title = "Weights; craft that no trial flew; margins of a craft like the model"
    return table(("", "before", "after"), rows, title=title)


@command(PANEL, figures=False)
def animate(
    recording: Annotated[
        Path, Argument(metavar="RECORDING", help="A bag folder, .mcap, or folder of CSV files.")
    ],
    output: Annotated[Path, options.output("FILE", "File to write: flight.gif or flight.html.")],
    span: options.RecordingPart = None,
    vehicle: options.ReadVehicle = None,
    mapping: options.ReadMapping = None,
    speed: Annotated[float, Setting("Seconds of flight per second.", numbers.SPEED, "X")] = 1.0,
    fps: Annotated[float, Setting("Frames of a GIF per second.", numbers.FRAME_RATE, "N")] = 25.0,
    twin: options.ReadTwin = None,
) -> None:
    """Show a flight from above, as a GIF or an interactive page."""
    from airpuck.report.scene import TABLE

    written = airpuck.animate(
        _flight(recording, mapping),
        output,
        vehicle=vehicle,
        span=span or (0.0, 1.0),
        speed=speed,
        frames_per_second=fps,
        table=twin or TABLE,
    )
    show(written)


def _flight(path: Path, mapping: RecordingMapping | None) -> Recording:
    """Read the flight of a craft; a game between two hands has none."""
    try:
        return options.read_recording(path, mapping)
    except InputError:
        streams = airpuck.read_recording(path, mapping=mapping, needs=("pose",)).streams
        if "game" in streams and "command" not in streams:
            problem = "is a game between two hands; choose a game of a craft, or use watch-match"
            raise InputError(problem, file=path) from None
        raise


def _excitation_line(excited: Excited) -> str:
    """Return a line on how close the craft came to the rails."""
    contacts, met = excited.contacts, "none"
    if contacts:
        times = ", ".join(f"{time:.1f}" for time in contacts[:10]) + " …" * (len(contacts) > 10)
        met = f"{len(contacts)}, at {times} s (no model includes rails)"
    return f"signals paused near the rails: {excited.paused:.1f} s; contacts with a rail: {met}"


@command(PANEL)
def fleet(
    scenario: Annotated[
        str,
        Argument(
            metavar="SCENARIO",
            help="A scenario (TOML), or crossing, into_center, into_line, into_square, "
            "line_crossing, obstacles, square_crossing.",
        ),
    ] = "crossing",
    seed: options.Seed = 0,
    output: options.PageFolder = None,
    animation: Annotated[
        Path | None,
        options.output("FILE", "Animation of the flight to write, a GIF.", "--animation"),
    ] = None,
) -> None:
    """Fly several craft on one twin, without collisions.

    Each craft plans on its own model, and flies a path only after all others have accepted it.
    """
    from airpuck.report.fleet_report import sentences, write_fleet_gif

    flown = airpuck.read_fleet(scenario)
    flight = airpuck.fly_together(flown, seed)
    written = page(output, "fleet_report.fleet_report", flight, flown)
    if animation is not None:
        write_fleet_gif(flight, flown, animation)
    report(flight.to_json(), *sentences(flight), written, animation)


@command(PANEL)
def export(
    model: options.ModelName,
    kind: Annotated[
        str,
        Setting(
            f"What to write: {'; '.join(f'{n} ({k.summary})' for n, k in KINDS.items())}.",
            metavar="KIND",
            option="--to",
            complete=known_kinds,
        ),
    ],
    output: Annotated[Path, options.output("DIR", "Folder for the files.")],
    tuning: options.TuningFile = None,
    law: options.LawName = None,
    plan: Annotated[
        Path | None, Setting("A plan by `airpuck plan` that the controller tracks.", metavar="FILE")
    ] = None,
    twin: options.TwinFile = None,
) -> None:
    """Write a model, or its whole controller, for other tools."""
    from airpuck.planning.plan import read_plan

    check_given(kind, tuning=tuning, law=law, twin=twin, plan=plan)
    exported = airpuck.read_model(model)
    # The controller is the same as in the other commands; it depends on the craft.
    controls = "tuning" in kind_named(kind).uses
    written = airpuck.export.write(
        exported,
        kind,
        output,
        tuning=options.read_controls(tuning, law, exported) if controls else None,
        twin=None if twin is None else airpuck.read_twin_settings(twin),
        plan=None if plan is None else read_plan(plan, exported),
        inputs=[one for one in (model, tuning, twin, plan) if one is not None],
    )
    rows = [(name, str(value)) for name, value in written.facts.items()]
    shown = [table(("", ""), rows, left=("",))] if rows else []
    report(written.to_json(), *shown, *(output / name for name in written.files))
