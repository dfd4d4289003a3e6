"""The command for many flights and fits."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.cli import options
from airpuck.cli.app import app
from airpuck.cli.output import report, show_time_left, table, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.campaigns.campaign import Campaign

#: Number of failures printed; all are in results.csv.
_SHOWN = 10


@app.command(rich_help_panel="Many at once")
def campaign(
    spec: Annotated[Path, Argument(metavar="SPEC", help="The spec file, such as spec.toml.")],
    output: Annotated[Path, options.output("DIR", "Folder of the results.")],
    workers: options.Workers = None,
    retry: Annotated[bool, Option("--retry", help="Run failed items again.")] = False,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Run many independent flights or fits; skip whatever is already done."""
    with show_time_left("items", quiet) as progress:
        found = airpuck.campaign(spec, output, workers=workers, retry=retry, progress=progress)
    figures = found.to_json()
    write_json(output / "summary.json", figures)
    report(figures, json_file, *_summary(found), output / "results.csv")
    if len(found.failures) == len(found.entries):
        raise InputError(f"every item failed; the first: {found.failures[0][1]}", file=spec)


def _summary(found: Campaign) -> Iterator[str | Table]:
    """Yield the statistics of every figure, setting by setting, and the failures."""
    headings = ("mean", "sd", "min", "q05", "q50", "q95", "max")
    for setting in found.settings:
        values = [f"{k} = {json.dumps(v, default=str)}" for k, v in setting["setting"].items()]
        failed = f", {setting['failed']} failed" if setting["failed"] else ""
        yield f"{', '.join(values) or 'all'}: {setting['items']} items{failed}"
        rows = [
            [name, *(f"{f[h]:.4g}" if math.isfinite(f[h]) else "" for h in headings)]
            for name, f in setting["figures"].items()
        ]
        yield table(("figure", *headings), rows)
    for entry, why in found.failures[:_SHOWN]:
        setting = f" {entry.setting}" if entry.setting else ""
        yield f"failed:{setting} seed {entry.item.seed}: {why}"
    more = len(found.failures) - _SHOWN
    if more > 0:
        yield f"… and {more} more, in results.csv"
