"""How long the notebooks of the site take: docs/tables/notebooks.md.

    python studies/notebooks.py           # all tutorials, one after the other; minutes
    python studies/notebooks.py trust     # these alone; the table keeps its other rows

Processor time includes all processes that a notebook starts. It bounds the wall time on an
idle core; the measured wall time depends on what else runs.
"""

from __future__ import annotations

import os
import re
import resource
import sys
import tempfile
import time
from pathlib import Path

from myst_nb.core.read import myst_nb_reader_plugin
from nbclient import NotebookClient

DOCS = Path(__file__).parents[1] / "docs"
TABLE = DOCS / "tables" / "notebooks.md"
HEAD = "| tutorial | processor s | wall s | load |\n|---|---|---|---|\n"
#: Seconds for a cell, as in docs/conf.py.
TIMEOUT = 1800


def processor() -> float:
    """Return the processor time of all ended children [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured(page: Path) -> str:
    """Execute a page; return its row. A failing cell raises an exception."""
    notebook = myst_nb_reader_plugin(str(page))
    with tempfile.TemporaryDirectory() as folder:
        before, begin = processor(), time.monotonic()
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=TIMEOUT, resources=resources).execute()
        wall, used = time.monotonic() - begin, processor() - before
    (title,) = re.findall(r"^# (.*)$", page.read_text("utf-8"), re.MULTILINE)[:1]
    return (
        f"| [{title}](../tutorials/{page.name}) | {used:.0f} | {wall:.0f} "
        f"| {os.getloadavg()[0]:.1f} |"
    )


def main() -> None:
    """Measure the tutorials named, or all."""
    rows = {}
    if TABLE.exists():
        rows = {
            re.findall(r"(\w+)\.md", row)[0]: row
            for row in TABLE.read_text("utf-8").splitlines()[2:]
        }
    for name in sys.argv[1:] or sorted(page.stem for page in (DOCS / "tutorials").glob("*.md")):
        rows[name] = measured(DOCS / "tutorials" / f"{name}.md")
        print(rows[name], flush=True)
        TABLE.write_text(HEAD + "\n".join(rows[name] for name in sorted(rows)) + "\n", "utf-8")


if __name__ == "__main__":
    main()
