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
#: The options --json and --quiet of the running command.
_options: dict[str, Any] = {"json_file": None, "quiet": False}


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
    """Write a figure if its path is given; see `page`."""
    if path is not None:
        _reported("style.write_figure")(_reported(name)(*content), path)
    return path


def _reported(name: str) -> Any:
    """Return a function of the reports, whose libraries take long to import."""
    module, _, function = name.partition(".")
    return getattr(import_module(f"airpuck.report.{module}"), function)


@contextmanager
def output_for(json_file: Path | None = None, quiet: bool = False, **_: Any) -> Iterator[None]:
    """Let all output, of every thread, obey the options --json and --quiet of a command."""
    before = dict(_options)
    _options.update(json_file=json_file, quiet=quiet)
    try:
        yield
    finally:
        _options.update(before)


def say(message: str) -> None:
    """Print a progress message, unless --quiet is given."""
    if not _options["quiet"]:
        show(message, error=True)


def show(text: str | Path, *, error: bool = False) -> None:
    """Print a line; quoted names and file contents cannot control the terminal."""
    print(escaped(str(text)), file=sys.stderr if error else sys.stdout, flush=True)


def warn(warnings: Iterable[str]) -> None:
    """Print warnings on standard error, unless --quiet is given."""
    for warning in warnings:
        say(f"warning: {warning}")


def console(error: bool = False) -> Console:
    """Return where tables are printed; outside a terminal, rows may be longer.

    Names such as [red] and :smile: are printed literally.
    """
    from rich.console import Console

    file = sys.stderr if error else sys.stdout
    return Console(file=file, width=None if file.isatty() else 160, markup=False, emoji=False)


def report(figures: Any, *shown: Any) -> None:
    """Write figures to the --json file, and print the rest unless it would interfere.

    Items to print are lines, paths and tables; None is skipped.
    """
    from airpuck.report.tables import PageTable

    write_json(_options["json_file"], figures)
    if json_on_stdout():
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


def json_on_stdout() -> bool:
    """Return whether the running command prints JSON, and nothing else, on standard output."""
    return is_stdout(_options["json_file"])


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
def show_time_left(what: str) -> Iterator[Callable[..., None]]:
    """Show how long some work will take: on a terminal as a bar, else in words."""
    began, said = time.monotonic(), 0

    def in_words(done: float, total: float, failed: int = 0) -> None:
        nonlocal said
        tenths = int(10 * done / total)
        if tenths > said:
            said, left = tenths, (time.monotonic() - began) * (total / done - 1)
            rest = f", {failed} failed" if failed else ""
            rest += f", about {left:.0f} s left" if done < total else ""
            say(f"{what}: {10 * tenths} %{rest}")

    if _options["quiet"] or not sys.stderr.isatty():
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
def show_progress() -> Iterator[Any]:
    """Show an optimiser's iterations: one live line on a terminal, plain lines elsewhere."""
    if sys.stderr.isatty() and not _options["quiet"]:
        from rich.console import Console

        with Console(stderr=True).status("compiling …") as status:
            yield lambda iteration: status.update(str(iteration))
    else:
        yield lambda iteration: say(str(iteration))
