"""Commands for campaigns, the paper's study and the demonstration."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.cli import options
from airpuck.cli.app import command
from airpuck.cli.output import console, origin, report, say, show, show_time_left, table, write_json

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.campaigns.campaign import Campaign


#: Number of failures printed; all are in results.csv.
_SHOWN = 10


@command("Many at once")
def campaign(
    spec: Annotated[Path, Argument(metavar="SPEC", help="The spec file, such as spec.toml.")],
    output: Annotated[Path, options.output("DIR", "Folder of the results.")],
    workers: options.Workers = None,
    retry: Annotated[bool, Option("--retry", help="Run failed items again.")] = False,
) -> None:
    """Run many independent flights or fits; skip whatever is already done."""
    with show_time_left("items") as progress:
        found = airpuck.campaign(spec, output, workers=workers, retry=retry, progress=progress)
    figures = found.to_json()
    write_json(output / "summary.json", figures)
    report(figures, *_summary(found), output / "results.csv")
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


PANEL = "The paper's study"

#: Left-aligned columns of the list of datasets.
_LEFT = ("name", "licence", "content")
#: The former name --out still works for scripts.
Out = Annotated[Path, options.output("DIR", "Folder to write to.", "-o", "--output", "--out")]


@command(PANEL, figures=False)
def fetch(
    name: Annotated[str, Argument(metavar="[NAME]", help="Name of the dataset.")] = "holohover",
    everything: Annotated[bool, Option("--all", help="All, not only the study's.")] = False,
    listed: Annotated[bool, Option("--list", help="List the datasets; download nothing.")] = False,
    output: Annotated[
        Path | None,
        options.output("DIR", "Folder to download to; by default the user's cache folder."),
    ] = None,
) -> None:
    """Download and verify a public dataset, by default the paper's (or verify $AIRPUCK_DATA)."""
    from airpuck.recording.dataset import dataset, dataset_names

    if listed:
        found = {each: dataset(each) for each in dataset_names()}
        rows = [(n, f"{d.size_MB:g} MB", d.licence, d.title) for n, d in found.items()]
        console().print(table(("name", "size", "licence", "content"), rows, left=_LEFT))
        return
    chosen = dataset(name)
    for line in (chosen.title, f"by {chosen.authors}; licence: {chosen.licence}", chosen.url):
        say(line)
    fetched = airpuck.fetch(
        name,
        all=everything,
        folder=output,
        progress=lambda done, of, file: say(f"{done + 1}/{of} {file}") if file else None,
    )
    for line in chosen.next:
        say("next: " + line.replace("FOLDER", shlex.quote(str(fetched))))
    show(fetched)


@command(PANEL)
def reproduce(
    data: Annotated[Path | None, Option(metavar="DIR", help="Folder of the public data.")] = None,
    output: Out = Path("out"),
) -> None:
    """Reproduce the paper's tables and figures, published against ours."""
    result = airpuck.reproduce(data, output, progress=say, origin=origin())
    report(result.to_json(), output / "index.html")


@command(PANEL, figures=False)
def demo(output: Out = Path("demo")) -> None:
    """Run the whole study on simulated recordings: no download, no hardware."""
    from airpuck.report.reproduce import demo

    show(demo(output, progress=say, origin=origin()))
