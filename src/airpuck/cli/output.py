"""Printing and writing of results."""

from __future__ import annotations

import json
import math
import os
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from airpuck.boundary.errors import escaped
from airpuck.boundary.outputs import without_home
from airpuck.boundary.results import plain

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from airpuck.report.page import Origin

#: Latest date that `datetime` supports, the end of 9999 [s].
_LATEST = 253402300799


def origin() -> Origin:
    """Return the running command line and the date, for the foot of a page.

    The date is $SOURCE_DATE_EPOCH if that is a valid date, so that pages can be reproduced
    (reproducible-builds.org). Home folders are replaced by ~, since they are private.
    """
    from airpuck.report.page import Origin

    seconds = os.environ.get("SOURCE_DATE_EPOCH", "")
    moment = float(seconds) if seconds.isdecimal() else math.inf
    moment = moment if moment <= _LATEST else time.time()
    date = datetime.fromtimestamp(moment, UTC).strftime("%Y-%m-%d %H:%M UTC")
    return Origin(date, shlex.join(["airpuck", *map(without_home, sys.argv[1:])]))


def page(folder: Path | None, name: str, *content: Any, **options: Any) -> Path | None:
    """Write a page if its folder is given; `name`: module.function in `airpuck.report`."""
    return folder and _reported(name)(*content, out=folder, origin=origin(), **options)


def draw(path: Path | None, name: str, *content: Any) -> Path | None:
    """Write a figure as a PNG if its path is given; see `page`."""
    if path is not None:
        from airpuck.report.style import write_png

        write_png(_reported(name)(*content), path)
    return path


def _reported(name: str) -> Any:
    """Return a function of the reports, whose libraries take long to import."""
    module, _, function = name.partition(".")
    return getattr(import_module(f"airpuck.report.{module}"), function)


def say(quiet: bool) -> Any:
    """Return a function that prints progress messages."""
    return (lambda _: None) if quiet else partial(show, error=True)


def show(text: str | Path, *, error: bool = False) -> None:
    """Print a line; quoted names and file contents cannot control the terminal."""
    print(escaped(str(text)), file=sys.stderr if error else sys.stdout, flush=True)


def warn(warnings: Any, quiet: bool = False) -> None:
    """Print warnings on standard error."""
    if not quiet:
        for warning in warnings:
            show(f"warning: {warning}", error=True)


def console(error: bool = False) -> Console:
    """Return where tables are printed; outside a terminal, rows may be longer.

    Names such as [red] and :smile: are printed literally.
    """
    from rich.console import Console

    file = sys.stderr if error else sys.stdout
    return Console(file=file, width=None if file.isatty() else 160, markup=False, emoji=False)


def report(figures: Any, json_file: Path | None, *shown: Any, quiet: bool = False) -> None:
    """Write figures to the --json file, and print the rest unless it would interfere.

    Items to print are lines, paths and tables; None is skipped.
    """
    from airpuck.report.tables import PageTable

    write_json(json_file, figures)
    if quiet or is_stdout(json_file):
        return
    for part in shown:
        if isinstance(part, (str, Path)):
            show(part)
        elif isinstance(part, PageTable):
            title = part.caption.partition(". ")[0].removesuffix(".")
            console().print(table(part.headings, part.rows, title=title, left=part.texts))
        elif part is not None:
            console().print(part)


def table(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    title: str | None = None,
    left: Sequence[str] | None = None,
) -> Table:
    """Lay out a table; `left` columns (by default the first) are left-aligned."""
    from rich.table import Table

    made = Table(title=title and escaped(title), title_justify="left")
    for heading in headings:
        to_left = heading in (headings[:1] if left is None else left)
        made.add_column(escaped(heading), justify="left" if to_left else "right", overflow="fold")
    for row in rows:
        made.add_row(*map(escaped, row))
    return made


def is_stdout(json_file: Path | None) -> bool:
    """Return whether JSON goes to standard output, where nothing else may then be printed."""
    return json_file is not None and str(json_file) == "-"


def write_json(json_file: Path | None, figures: Any) -> None:
    """Write figures to the --json file; null stands for a number that is not finite."""
    if json_file is None:
        return
    text = json.dumps(plain(figures), indent=2, allow_nan=False) + "\n"
    if is_stdout(json_file):
        sys.stdout.write(text)
        return
    from airpuck.boundary.outputs import replacing

    with replacing(json_file) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def show_time_left(what: str, quiet: bool) -> Iterator[Callable[..., None]]:
    """Show how long some work will take: on a terminal as a bar, else in words."""
    began, said = time.monotonic(), 0

    def in_words(done: float, total: float, failed: int = 0) -> None:
        nonlocal said
        tenths = int(10 * done / total)
        if tenths > said and not quiet:
            said, left = tenths, (time.monotonic() - began) * (total / done - 1)
            rest = f", {failed} failed" if failed else ""
            rest += f", about {left:.0f} s left" if done < total else ""
            print(f"{what}: {10 * tenths} %{rest}", file=sys.stderr, flush=True)

    if quiet or not sys.stderr.isatty():
        yield in_words
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total, failed=0: bar.update(
            task, completed=done, total=total, description=f"{failed} failed" if failed else what
        )


@contextmanager
def show_progress(quiet: bool) -> Iterator[Any]:
    """Show an optimiser's iterations: one live line on a terminal, plain lines elsewhere."""
    if quiet:
        yield lambda _: None
    elif sys.stderr.isatty():
        from rich.console import Console

        with Console(stderr=True).status("compiling …") as status:
            yield lambda iteration: status.update(str(iteration))
    else:
        yield lambda iteration: print(iteration, file=sys.stderr)
