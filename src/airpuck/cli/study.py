"""Commands for the paper's study and the demonstration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

import airpuck
from airpuck.cli import options
from airpuck.cli.app import app
from airpuck.cli.output import origin, report, say, show

PANEL = "The paper's study"

#: The former name --out still works for scripts.
Out = Annotated[Path, options.output("DIR", "Folder to write to.", "-o", "--output", "--out")]


@app.command(rich_help_panel=PANEL)
def fetch(
    everything: Annotated[
        bool, Option("--all", help="All recordings, not only the study's.")
    ] = False,
    quiet: options.Quiet = False,
) -> None:
    """Download and verify the public dataset (or verify $AIRPUCK_DATA)."""
    tell = say(quiet)
    fetched = airpuck.fetch(
        all=everything, progress=lambda done, of, name: tell(f"{done + 1}/{of} {name}")
    )
    show(fetched)


@app.command(rich_help_panel=PANEL)
def reproduce(
    data: Annotated[
        Path | None, Option(metavar="DIR", help="Folder of the public dataset.")
    ] = None,
    output: Out = Path("out"),
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Reproduce the paper's tables and figures, published against ours."""
    result = airpuck.reproduce(data, output, progress=say(quiet), origin=origin())
    report(result.to_json(), json_file, output / "index.html")


@app.command(rich_help_panel=PANEL)
def demo(output: Out = Path("demo"), quiet: options.Quiet = False) -> None:
    """Run the whole study on simulated recordings: no download, no hardware."""
    from airpuck.report.demo import demo

    show(demo(output, progress=say(quiet), origin=origin()))
