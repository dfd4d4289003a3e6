"""The command for many flights and fits."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from airpuck.cli.app import app
from airpuck.cli.options import Json, Quiet
from airpuck.cli.output import check_destinations, console, is_stdout, write_json

if TYPE_CHECKING:
    from airpuck.campaigns.campaign import Campaign

PANEL = "Many at once"

#: Failures that are printed; all are in results.csv.
_SHOWN = 10


@app.command(rich_help_panel=PANEL)
def campaign(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="A spec.toml.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder of the results.")
    ],
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="TCP", help="Address of a Dask scheduler, tcp://HOST:PORT."),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", help="Processes to start; as many as processors.", min=1),
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Run again what failed.")] = False,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Run many independent flights or fits; what is done already is not done again."""
    from airpuck.boundary.errors import InputError
    from airpuck.campaigns.campaign import campaign

    if scheduler is not None and workers is not None:
        raise InputError("a running cluster has its own; give one of the two", field="--workers")
    check_destinations(output=output, json=json_file)
    try:
        with _progress(quiet) as progress:
            found = campaign(
                spec, output, scheduler=scheduler, workers=workers, retry=retry, progress=progress
            )
    except KeyboardInterrupt:
        print("airpuck: interrupted; run it again for what is missing", file=sys.stderr)
        raise typer.Exit(130) from None
    from airpuck.boundary.files import replacing

    with replacing(output / "summary.json") as temporary:
        write_json(temporary, found.to_json())
    write_json(json_file, found.to_json())
    if not is_stdout(json_file):
        _print(found)
        print(output / "results.csv")
    if len(found.failures) == len(found.entries):
        raise InputError(f"every item failed; the first: {found.failures[0][1]}", file=spec)


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[int, int, int], None]]:
    """Show a bar on a terminal, a line for every tenth of the items elsewhere."""
    if quiet:
        yield lambda done, of, failed: None
        return
    if not sys.stderr.isatty():
        shown = -1

        def line(done: int, of: int, failed: int) -> None:
            nonlocal shown
            tenth = 10 * done // of
            if tenth > shown:
                shown = tenth
                print(f"{done} of {of} items done, {failed} failed", file=sys.stderr, flush=True)

        yield line
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("")

        def update(done: int, of: int, failed: int) -> None:
            told = f"{failed} failed" if failed else ""
            bar.update(task, completed=done, total=of, description=told)

        yield update


def _print(found: Campaign) -> None:
    """Print statistics of every figure, setting by setting, and what failed."""
    from rich.table import Table

    headings = ("mean", "sd", "min", "q05", "q50", "q95", "max")
    for summary in found.settings:
        values = (f"{k} = {json.dumps(v, default=str)}" for k, v in summary["setting"].items())
        title = f"{', '.join(values) or 'all'}: {summary['items']} items"
        if summary["failed"]:
            title += f", {summary['failed']} failed"
        console().print(title, soft_wrap=True, highlight=False, markup=False)
        table = Table()
        table.add_column("figure", overflow="fold")
        for heading in headings:
            table.add_column(heading, justify="right")
        for name, figures in summary["figures"].items():
            values = (figures[heading] for heading in headings)
            table.add_row(name, *(f"{v:.4g}" if math.isfinite(v) else "" for v in values))
        console().print(table)
    for entry, why in found.failures[:_SHOWN]:
        print(f"failed: {entry.setting or ''} seed {entry.item.seed}: {why}".replace(": ''", ":"))
    more = len(found.failures) - _SHOWN
    if more > 0:
        print(f"… and {more} more, in results.csv")
