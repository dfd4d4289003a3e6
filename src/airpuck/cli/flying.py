"""Commands that fly."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from airpuck.cli.app import app
from airpuck.cli.inputs import read_flight
from airpuck.cli.options import Json, Span, TopicsFile, TuningFile
from airpuck.cli.output import is_stdout, print_replay, write_json

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
    from airpuck.control.tuning import default_tuning, read_tuning
    from airpuck.flight.replay import replay
    from airpuck.model_file import read_model

    craft = read_model(model)
    settings = default_tuning() if tuning is None else read_tuning(tuning)
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
