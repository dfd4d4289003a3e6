"""What is wrong in a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from airpuck.cli.app import app
from airpuck.cli.inputs import cut, load, read_craft
from airpuck.cli.learning import PANEL
from airpuck.cli.options import Json, Quiet, RecordingPath, Span, TopicsFile, VehicleFile
from airpuck.cli.output import check_destinations, console, is_stdout, warn, write_json

if TYPE_CHECKING:
    from airpuck.data.trajectory import Span as FoundSpan


@app.command(rich_help_panel=PANEL)
def faults(
    recording: RecordingPath,
    model: Annotated[
        str | None,
        typer.Option(
            metavar="MODEL", help="Of the healthy craft; by default M3, fitted to the recording."
        ),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="DIR", help="Write a page, too.")
    ] = None,
    span: Span = None,
    vehicle: VehicleFile = None,
    topics: TopicsFile = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Find when motors, radio or cameras failed, or something hit the craft."""
    from airpuck.boundary.errors import InputError
    from airpuck.faults.find import find_faults
    from airpuck.identification.fit import identify
    from airpuck.model.model_file import read_model

    if model is not None and vehicle is not None:
        raise InputError("is the model's; leave out one of both", field="--vehicle")
    check_destinations(output=output, json=json_file)
    known = None if model is None else read_model(model)
    craft = known.vehicle if known else read_craft(vehicle)
    trajectory = cut(load(recording, craft, topics), span)
    warn(trajectory.warnings, quiet)
    if known is None:
        fit = identify(trajectory, vehicle=craft)
        warn(fit.exclusion.warnings if fit.exclusion else (), quiet)
        known = fit.model
    found = find_faults(trajectory, known)
    if output is not None:
        from airpuck.report.fault_report import fault_report

        fault_report(trajectory, found, known, output)
    spans = sorted((*trajectory.excluded, *found), key=lambda s: s.start)
    usable = float(trajectory.leave_out(found).usable.mean())
    write_json(
        json_file,
        {
            "model": known.name,
            "duration_s": trajectory.duration,
            "usable": usable,
            "spans": [
                {"start_s": s.start, "stop_s": s.stop, "cause": s.cause, "confidence": s.confidence}
                for s in spans
            ],
        },
    )
    if not is_stdout(json_file):
        _print(spans)
        print(f"{100 * usable:.1f} % of {trajectory.duration:.1f} s without any fault")
        if output is not None:
            print(output / "index.html")


def _print(spans: list[FoundSpan]) -> None:
    """Print spans as a table."""
    from rich.table import Table

    table = Table()
    for heading in ("from s", "to s", "cause", "confidence"):
        table.add_column(heading, justify="left" if heading == "cause" else "right")
    for span in spans:
        sure = "measured" if span.confidence == 1 else f"{min(span.confidence, 0.99):.2f}"
        table.add_row(f"{span.start:.3f}", f"{span.stop:.3f}", span.cause, sure)
    if spans:
        console().print(table)
