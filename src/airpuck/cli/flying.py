"""Commands that fly."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from airpuck.cli.app import app
from airpuck.cli.inputs import (
    choose,
    known_flights,
    missing_flights,
    read_belief,
    read_controls,
    read_craft,
    read_flight,
)
from airpuck.cli.options import (
    Json,
    Seed,
    Span,
    TopicsFile,
    TuningFile,
    TwinFile,
    VehicleFile,
)
from airpuck.cli.output import (
    check_destinations,
    is_stdout,
    print_excitation,
    print_replay,
    print_tracks,
    warn,
    write_json,
)

PANEL = "Control and flight"


@app.command(rich_help_panel=PANEL)
def replay(
    flight: Annotated[
        Path,
        typer.Argument(metavar="FLIGHT", help="A recording with poses, commands and references."),
    ],
    model: Annotated[
        str, typer.Option(metavar="MODEL", help="What the controller believes the craft to be.")
    ],
    fit_gains: Annotated[
        bool, typer.Option("--fit-gains", help="Fit the regulator's gains to the log first.")
    ] = False,
    tuning: TuningFile = None,
    span: Span = None,
    topics: TopicsFile = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Write a page of figures.")
    ] = None,
    json_file: Json = None,
) -> None:
    """Feed a recorded flight to the controller; compare its commands with those sent."""
    from airpuck.control.tuning import default_tuning
    from airpuck.flight.replay import replay

    check_destinations(output=output, json=json_file)
    craft = read_belief(model)
    settings = read_controls(tuning) or default_tuning()
    result = replay(
        read_flight(flight, topics),
        craft,
        tuning=settings,
        fit_gains=fit_gains,
        span=span or (0.0, 1.0),
    )
    if output is not None:
        from airpuck.report.replay_report import replay_report

        replay_report(result, craft, settings.period_s, output)
    write_json(json_file, result.to_json())
    if not is_stdout(json_file):
        print_replay(result)
        if output is not None:
            print(output / "index.html")


@app.command(rich_help_panel=PANEL)
def excite(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="BAG", help="Folder to record to; new.")
    ],
    duration: Annotated[
        float | None, typer.Option(metavar="S", help=r"Length \[s], by default 90.")
    ] = None,
    seed: Seed = 0,
    vehicle: VehicleFile = None,
    model: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help="Truth of the twin; by default paper:M3, or nominal."),
    ] = None,
    amplitude: Annotated[
        float | None, typer.Option(help="Largest random signal, by default 1.")
    ] = None,
    hold: Annotated[
        float | None,
        typer.Option(metavar="S", help=r"Time between its changes \[s], by default 0.2."),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="These and the margin, as airpuck design proposes."),
    ] = None,
    twin: TwinFile = None,
    tuning: TuningFile = None,
    csv: Annotated[bool, typer.Option("--csv", help="Record CSV files instead of a bag.")] = False,
    json_file: Json = None,
) -> None:
    """Fly the excitation experiment on the twin and record it."""
    from airpuck import write_bag, write_csv
    from airpuck.boundary.errors import InputError
    from airpuck.control.excitation import ExcitationPlan, read_excitation_plan
    from airpuck.model.model_file import nominal_model, read_model
    from airpuck.twin.experiments import fly_excitation
    from airpuck.twin.settings import read_twin_settings

    craft = read_craft(vehicle)
    if craft is not None and model is not None:
        raise InputError("a model has its vehicle in it; give one of the two", field="--vehicle")
    truth = nominal_model(craft) if craft is not None else read_model(model or "paper:M3")
    # Before the flight: a folder that is in the way should not cost a minute.
    if output.exists() and (not output.is_dir() or any(output.iterdir())):
        raise InputError("exists already; choose a new folder", file=output, field="-o")
    check_destinations(output=output, json=json_file)
    planned = ExcitationPlan() if plan is None else read_excitation_plan(plan)
    excited = fly_excitation(
        truth,
        planned.duration_s if duration is None else duration,
        seed,
        amplitude=planned.amplitude if amplitude is None else amplitude,
        hold=planned.hold_s if hold is None else hold,
        margin=planned.margin_m,
        settings=None if twin is None else read_twin_settings(twin),
        tuning=read_controls(tuning),
    )
    (write_csv if csv else write_bag)(excited.recording, output)
    streams = excited.recording.streams
    figures = {
        "messages": {name: len(stream) for name, stream in streams.items()},
        "paused_s": excited.paused,
        "rail_contacts_s": list(excited.contacts),
    }
    write_json(json_file, figures)
    if not is_stdout(json_file):
        print_excitation(excited)
        print(output)


@app.command(rich_help_panel=PANEL)
def track(
    models: Annotated[
        list[str] | None,
        typer.Option(
            "--model", metavar="MODEL", help="What the controller believes; repeat for several."
        ),
    ] = None,
    flights: Annotated[
        list[Path] | None,
        typer.Option("--flight", metavar="FLIGHT", help="Real flight of each model, to imitate."),
    ] = None,
    truth: Annotated[str, typer.Option(metavar="MODEL", help="Truth of the twin.")] = "paper:M4",
    dwell: Annotated[
        float | None,
        typer.Option(metavar="S", help=r"Time at each set point \[s]; imitates no flight."),
    ] = None,
    controller: Annotated[
        str,
        typer.Option(help="paper: as flown; full: compensates the delay, rejects disturbances."),
    ] = "paper",
    estimator: Annotated[
        str | None,
        typer.Option(
            help="kalman, or actuation: finds out what each motor does; by default the tuning's."
        ),
    ] = None,
    seed: Seed = 0,
    twin: TwinFile = None,
    tuning: TuningFile = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Write a page of figures.")
    ] = None,
    json_file: Json = None,
) -> None:
    """Fly the paper's set points on the twin, beside the real flights."""
    from airpuck.boundary.errors import InputError
    from airpuck.control.tuning import ESTIMATORS, default_tuning
    from airpuck.model.model_file import read_model
    from airpuck.twin.settings import read_twin_settings
    from airpuck.twin.tracking_study import DWELL, tracking_study

    choose("--controller", controller, ("paper", "full"))
    if estimator is not None:
        choose("--estimator", estimator, ESTIMATORS)
    names = models or ["paper:M0", "paper:M4"]
    if dwell is not None and flights:
        raise InputError("a flight has its own times; give one of the two", field="--dwell")
    if dwell is not None and not 0.1 <= dwell <= 1000:
        raise InputError("must be between 0.1 and 1000 s", field="--dwell")
    paths = flights or (known_flights(names) if dwell is None and controller == "paper" else [])
    if not flights and paths:
        warn(missing_flights(names, paths))
    if len(paths) > len(names):
        raise InputError("give one for each --model, in the same order", field="--flight")
    check_destinations(output=output, json=json_file)
    controls = read_controls(tuning)
    if estimator is not None:
        controls = (controls or default_tuning()).with_estimator(estimator)
    plant = read_model(truth)
    tracked = tracking_study(
        [read_belief(name) for name in names],
        plant,
        flights=[None if path is None else read_flight(path, None) for path in paths],
        dwell=dwell or DWELL,
        seed=seed,
        full_controller=controller == "full",
        settings=None if twin is None else read_twin_settings(twin),
        tuning=controls,
    )
    if output is not None:
        from airpuck.report.tracking_report import tracking_report

        tracking_report(tracked, plant.name, output)
    # The keys of the last model stand at the top, too: for one model nothing need be looked up.
    flown = [flight.to_json() for flight in tracked]
    write_json(json_file, {**flown[-1], "flights": flown})
    if not is_stdout(json_file):
        print_tracks(tracked)
        if output is not None:
            print(output / "index.html")


@app.command(rich_help_panel=PANEL)
def animate(
    recording: Annotated[
        Path, typer.Argument(metavar="RECORDING", help="A bag folder, .mcap, or folder of CSVs.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="flight.gif or flight.html")
    ],
    span: Span = None,
    vehicle: VehicleFile = None,
    topics: TopicsFile = None,
    speed: Annotated[float, typer.Option(help="Seconds of flight per second.")] = 1.0,
    fps: Annotated[float, typer.Option(help="Frames of a GIF per second.")] = 25.0,
    table: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="L W", help=r"Length and width of the table \[m]."),
    ] = None,
) -> None:
    """Show a flight from above, as a GIF or an interactive page."""
    from airpuck.report.animation import animate
    from airpuck.report.animation_frames import TABLE

    check_destinations(output=output)
    flight = read_flight(recording, topics)
    print(
        animate(
            flight,
            output,
            vehicle=read_craft(vehicle),
            span=span or (0.0, 1.0),
            speed=speed,
            frames_per_second=fps,
            table=table or TABLE,
        )
    )
