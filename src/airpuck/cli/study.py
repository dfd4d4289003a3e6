"""Commands for the paper's study and the demonstration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from airpuck.cli.app import app
from airpuck.cli.options import Json, Quiet
from airpuck.cli.output import check_destinations, is_stdout, say, write_json

PANEL = "The paper's study"

#: Called --out at first; scripts may still say so.
Out = Annotated[
    Path, typer.Option("-o", "--output", "--out", metavar="DIR", help="Folder to write to.")
]


@app.command(rich_help_panel=PANEL)
def fetch(
    everything: Annotated[
        bool, typer.Option("--all", help="All recordings, not only the study's.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Download and verify the public dataset (or verify $AIRPUCK_DATA)."""
    from airpuck.recording.dataset import fetch

    tell = say(quiet)
    print(fetch(all=everything, progress=lambda done, of, name: tell(f"{done + 1}/{of} {name}")))


@app.command(rich_help_panel=PANEL)
def reproduce(
    data: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the public dataset.")
    ] = None,
    output: Out = Path("out"),
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Reproduce the paper's tables and figures, published against ours."""
    from airpuck.report.reproduce import reproduce

    check_destinations(output=output, json=json_file)
    result = reproduce(data, output, progress=say(quiet))
    write_json(json_file, result.to_json())
    if not is_stdout(json_file):
        print(output / "index.html")


@app.command(rich_help_panel=PANEL)
def demo(
    output: Out = Path("demo"),
    quiet: Quiet = False,
) -> None:
    """Walk the whole way on recordings that are simulated: no download, no hardware."""
    from airpuck.report.demo import demo

    check_destinations(output=output)
    print(demo(output, progress=say(quiet)))
