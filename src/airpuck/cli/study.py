"""Commands for the paper's study and the demonstration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import airpuck
from airpuck.cli.app import app
from airpuck.cli.options import Json, Quiet
from airpuck.cli.output import check_destinations, report, say

PANEL = "The paper's study"

#: Called --out at first; scripts may still use that.
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
    show = say(quiet)
    fetched = airpuck.fetch(
        all=everything, progress=lambda done, of, name: show(f"{done + 1}/{of} {name}")
    )
    print(fetched)


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
    check_destinations(output=output, json=json_file)
    result = airpuck.reproduce(data, output, progress=say(quiet))
    report(result.to_json(), json_file, output / "index.html")


@app.command(rich_help_panel=PANEL)
def demo(
    output: Out = Path("demo"),
    quiet: Quiet = False,
) -> None:
    """Run the whole study on simulated recordings: no download, no hardware."""
    from airpuck.report.demo import demo

    check_destinations(output=output)
    print(demo(output, progress=say(quiet)))
