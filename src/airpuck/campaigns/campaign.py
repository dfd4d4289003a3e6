"""`campaign`: compute what a spec asks for and has no result yet."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from airpuck.campaigns.dispatch import dispatch
from airpuck.campaigns.item import Entry
from airpuck.campaigns.results import Result, Store, Summary, summarise, write_table
from airpuck.campaigns.spec import read_spec


@dataclass(frozen=True)
class Campaign:
    """A campaign that has come to its end."""

    #: Its items.
    entries: tuple[Entry, ...]
    #: What became of each.
    results: tuple[Result, ...]
    #: Items that had no result before.
    computed: int

    @property
    def failures(self) -> list[tuple[Entry, str]]:
        """Items that failed, and why."""
        pairs = zip(self.entries, self.results, strict=True)
        return [(entry, result.failure) for entry, result in pairs if result.failure is not None]

    @property
    def summaries(self) -> list[Summary]:
        """Figures of each setting of the grid."""
        return summarise(self.entries, self.results)

    def to_json(self) -> dict[str, Any]:
        """Return the figures for ``--json``."""
        return {
            "items": len(self.entries),
            "computed": self.computed,
            "settings": [asdict(summary) for summary in self.summaries],
            "failures": [
                {"key": e.key, "setting": e.setting, "seed": e.item.seed, "reason": why}
                for e, why in self.failures
            ],
        }


def campaign(
    spec: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    retry: bool = False,
    progress: Callable[[int, int, int], None] = lambda done, of, failed: None,
) -> Campaign:
    """Run many independent flights or fits on Dask; what has a result already is not run again.

    Parameters
    ----------
    spec : path-like
        The spec file.
    output : path-like
        Folder of the results: ``items/KEY.json`` for each item, ``results.csv`` of all rows.
    scheduler : str, optional
        Address of a running Dask scheduler; by default processes are started here.
    workers : int, optional
        Number of these processes; by default as many as there are processors.
    retry : bool, default False
        Whether items that failed are run again.
    progress : callable, optional
        Called with the number of items that have a result, of all, and of those that failed.

    Returns
    -------
    Campaign
        All results.

    Raises
    ------
    InputError
        If the spec is wrong, Dask is not installed, or the scheduler is not there.
    """
    entries, store = read_spec(spec), Store(Path(output))
    results = {entry.key: store.read(entry.key) for entry in entries}
    known = {
        key: result
        for key, result in results.items()
        if result is not None and not (retry and result.failure is not None)
    }
    missing = [entry for entry in entries if entry.key not in known]
    failed = sum(result.failure is not None for result in known.values())
    progress(len(known), len(entries), failed)

    def done(entry: Entry, result: Result) -> None:
        nonlocal failed
        store.write(entry, result)
        known[entry.key] = result
        failed += result.failure is not None
        progress(len(known), len(entries), failed)

    if missing:
        dispatch(missing, done, scheduler=scheduler, workers=workers)
    found = Campaign(tuple(entries), tuple(known[e.key] for e in entries), len(missing))
    write_table(Path(output) / "results.csv", found.entries, found.results)
    return found
