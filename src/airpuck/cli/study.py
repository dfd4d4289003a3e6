"""Commands for the paper's study and the demonstration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from airpuck.cli.app import app
from airpuck.cli.options import Json, Quiet
from airpuck.cli.output import check_destinations, is_stdout, say, write_json

PANEL = "The paper's study"


@app.command(rich_help_panel=PANEL)
def fetch(
    everything: Annotated[
        bool, typer.Option("--all", help="All recordings, not only the study's.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Download and verify the public dataset (or verify $AIRPUCK_DATA)."""
    from airpuck.recording import fetch

    tell = say(quiet)
    print(fetch(all=everything, progress=lambda done, of, name: tell(f"{done + 1}/{of} {name}")))


@app.command(rich_help_panel=PANEL)
def reproduce(
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the public dataset.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path("out"),
    side_claims: Annotated[
        bool, typer.Option("--side-claims", help="Re-test the paper's side claims too (minutes).")
    ] = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Reproduce the paper's tables and figures, published against ours."""
    from airpuck.report.reproduce import reproduce

    check_destinations(out=out, json=json_file)
    result = reproduce(data, out, side_claims=side_claims, progress=say(quiet))
    write_json(json_file, result.to_json())
    if not is_stdout(json_file):
        print(out / "index.html")


@app.command(rich_help_panel=PANEL)
def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where to write.")] = Path("demo"),
    quiet: Quiet = False,
) -> None:
    """Walk the whole way on recordings that are simulated: no download, no hardware."""
    from airpuck.demo import demo

    check_destinations(out=out)
    print(demo(out, progress=say(quiet)))
