"""`campaign`: read a spec, compute the items that have no result yet, summarise all results."""

from __future__ import annotations

import csv
import itertools
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic

from airpuck import __version__
from airpuck.boundary.errors import InputError
from airpuck.boundary.extensions import named
from airpuck.boundary.files import Section, checked, laid_over, read_toml
from airpuck.boundary.limits import read_text
from airpuck.boundary.outputs import check_output, replacing, without_home
from airpuck.boundary.results import Brief
from airpuck.campaigns.items import Count, Fitting, Item, Natural, Recovery, ShortestTime, Tracking
from airpuck.campaigns.workers import Entry, ItemResult, checked_workers, dispatch
from airpuck.control.settings import Workers

#: Kinds of items; entry points (`airpuck.items`) add others.
KINDS: dict[str, type[Item]] = {
    "tracking": Tracking,
    "recovery": Recovery,
    "fit": Fitting,
    "shortest_time": ShortestTime,
}
#: Largest number of items; all are created before the first one runs.
_MOST = 100_000


def _named_anew(kind: Any) -> Any:
    """Check that a kind is not a former one."""
    if kind == "fleet":
        raise ValueError("'fleet' is no longer a kind; step many craft with airpuck.TwinBatch")
    return kind


class Spec(Section):
    """Content of a spec file."""

    #: Kind of the items.
    kind: Annotated[str, pydantic.BeforeValidator(_named_anew)]
    #: Number of seeds from 0, or a list of seeds.
    seeds: Count | Annotated[tuple[Natural, ...], pydantic.Field(min_length=1)] = 1
    #: Fields that all items share.
    base: dict[str, Any] = pydantic.Field(default_factory=dict)
    #: Fields with lists of values; every combination is a setting.
    grid: dict[str, Any] = pydantic.Field(default_factory=dict)


def read_spec(path: str | os.PathLike[str]) -> list[Entry]:
    """Read a spec file and create all of its items."""
    spec, folder = read_toml(path, Spec), Path(path).resolve().parent
    for table, content in (("base", spec.base), ("grid", spec.grid)):
        if "seed" in content:
            raise InputError("is set by seeds; remove it", file=path, field=f"{table}.seed")
    kind = named(spec.kind, KINDS, "airpuck.items", file=path, field="kind")
    axes = dict(_axes(spec.grid, path))
    seeds = range(spec.seeds) if isinstance(spec.seeds, int) else spec.seeds
    size = math.prod(map(len, axes.values()), start=len(seeds))
    if size > _MOST:
        problem = f"asks for {size} items, more than {_MOST}; draw fewer seeds, or split the grid"
        raise InputError(problem, file=path)
    entries: dict[str, Entry] = {}
    hashes: dict[Any, str] = {}
    for values in itertools.product(*axes.values()):
        setting = dict(zip(axes, values, strict=True))
        content = spec.base
        for field, value in setting.items():
            for name in reversed(field.split(".")):
                value = {name: value}
            content = laid_over(content, value)
        given = kind.SOURCES & content.keys()
        sources = {name: _resolved(content[name], folder, kind) for name in given}
        # One check covers all seeds.
        item = checked({**content, **sources}, kind, file=path)
        for seed in seeds:
            seeded = item.model_copy(update={"seed": seed})
            key = seeded.key(hashes)
            entries.setdefault(key, Entry(key, setting, seeded))
    return list(entries.values())


def _axes(
    grid: Mapping[str, Any], path: str | os.PathLike[str], above: str = ""
) -> Iterator[tuple[str, list[Any]]]:
    """Flatten the tables of a grid to dotted fields with their values."""
    for name, values in grid.items():
        field = above + name
        if isinstance(values, Mapping):
            yield from _axes(values, path, f"{field}.")
            continue
        if not isinstance(values, list) or not values:
            raise InputError("must be a list of values", file=path, field=f"grid.{field}")
        if len({json.dumps(v, sort_keys=True, default=str) for v in values}) < len(values):
            raise InputError("names a value twice", file=path, field=f"grid.{field}")
        yield field, values


def _resolved(names: Any, folder: Path, kind: type[Item]) -> Any:
    """Make file names absolute."""
    if isinstance(names, list):
        return [_resolved(name, folder, kind) for name in names]
    if not isinstance(names, str) or not kind.is_file(names):
        return names
    return str(folder / os.path.expandvars(names))


_STATISTICS = ("count", "mean", "sd", "min", "q05", "q50", "q95", "max")


@dataclass(frozen=True)
class Campaign(Brief):
    """A completed campaign."""

    #: Items in the order of the spec.
    entries: tuple[Entry, ...]
    #: Result of each item.
    results: tuple[ItemResult, ...]
    #: Number of items computed in this run.
    computed: int

    @property
    def failures(self) -> list[tuple[Entry, str]]:
        """Items that failed, and why."""
        pairs = zip(self.entries, self.results, strict=True)
        return [(entry, result.failure) for entry, result in pairs if result.failure is not None]

    @property
    def settings(self) -> list[dict[str, Any]]:
        """Summary of each setting of the grid: ``setting, items, failed, figures``.

        ``figures`` maps each name to ``count, mean, sd, min, q05, q50, q95, max`` of its finite
        values over all rows; nan without such values.
        """
        pairs = zip(self.entries, self.results, strict=True)
        # Items of one setting are adjacent.
        groups = itertools.groupby(pairs, key=lambda pair: pair[0].setting)
        return [_summary(setting, [result for _, result in group]) for setting, group in groups]

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``."""
        return {
            "items": len(self.entries),
            "computed": self.computed,
            "settings": self.settings,
            "failures": [
                {"key": e.key, "setting": e.setting, "seed": e.item.seed, "reason": why}
                for e, why in self.failures
            ],
        }

    def write_table(self, path: Path) -> None:
        """Write all rows as CSV."""
        settings = dict.fromkeys(field for entry in self.entries for field in entry.setting)
        names = dict.fromkeys(n for result in self.results for row in result.rows for n in row)
        columns = ["key", *settings, "seed", "row", *names, "failure"]
        with (
            replacing(path) as temporary,
            temporary.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.DictWriter(file, columns)
            writer.writeheader()
            for entry, result in zip(self.entries, self.results, strict=True):
                writer.writerows(_lines(entry, result))


def campaign(
    spec: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    workers: Workers = None,
    retry: bool = False,
    progress: Callable[[float, int, int], None] = lambda done, of, failed: None,
) -> Campaign:
    """Run many independent flights, fits or games on Dask; skip items with a result.

    Parameters
    ----------
    spec : path-like
        The spec file.
    output : path-like
        Folder of the results: ``items/KEY.json`` for each item, ``results.csv`` of all rows.
    workers : int or str, optional
        Number of processes; by default as many as there are processors. Or the address of a running
        Dask scheduler, ``"tcp://HOST:PORT"``, whose workers compute instead.
    retry : bool, default False
        Whether to run failed items again.
    progress : callable, optional
        Called with the numbers of finished items, all items and failed items.

    Returns
    -------
    Campaign
        All results.

    Raises
    ------
    InputError
        If the spec is invalid, Dask is missing, or the scheduler does not answer.

    Examples
    --------
    >>> found = airpuck.campaign("spec.toml", "campaign/", workers=4)  # doctest: +SKIP
    >>> found.summaries, found.failures  # doctest: +SKIP
    >>> airpuck.campaign("spec.toml", "campaign/")
    Traceback (most recent call last):
        ...
    airpuck.boundary.errors.InputError: spec.toml: there is no such file
    """
    entries, folder = read_spec(spec), Path(output)
    check_output(folder, "folder", field="output")
    compute = partial(dispatch, workers=checked_workers(workers))
    done = completed(entries, folder, compute, retry=retry, progress=progress)
    done.write_table(folder / "results.csv")
    return done


def completed(
    entries: Sequence[Entry],
    folder: Path,
    compute: Callable[..., Iterable[tuple[Entry, ItemResult]]],
    *,
    retry: bool = False,
    progress: Callable[[float, int, int], None] = lambda done, of, failed: None,
) -> Campaign:
    """Compute the items that have no result in a folder yet.

    `compute` takes entries and a callback ``tell(key, share)`` for the progress of one of them.
    """
    results = {}
    for entry in entries:
        result = read_result(folder, entry.key)
        if result is None or (retry and result.failure is not None):
            continue
        # The files that it wrote must be unchanged.
        if result.failure is not None or entry.item.written() in (None, result.written):
            results[entry.key] = result
    # Equal items, as of copies of one player, are computed once.
    missing = list({entry.key: entry for entry in entries if entry.key not in results}.values())
    failed = sum(result.failure is not None for result in results.values())
    progress(len(results), len(entries), failed)
    shares: dict[str, float] = {}

    def tell(key: str, share: float) -> None:
        shares[key] = share
        under_way = sum(part for k, part in shares.copy().items() if k not in results)
        progress(len(results) + under_way, len(entries), failed)

    for entry, result in compute(missing, tell=tell) if missing else ():
        write_result(folder, entry, result)
        results[entry.key] = result
        failed += result.failure is not None
        progress(len(results), len(entries), failed)
    return Campaign(tuple(entries), tuple(results[e.key] for e in entries), len(missing))


def read_result(folder: Path, key: str) -> ItemResult | None:
    """Read the result of an item; None if there is none, or if it is damaged."""
    path = folder / "items" / f"{key}.json"
    try:
        return ItemResult.model_validate_json(read_text(path), strict=True)
    except ValueError:
        return None


def write_result(folder: Path, entry: Entry, result: ItemResult) -> None:
    """Write the result of an item atomically."""
    content = {
        "airpuck": __version__,
        "kind": type(entry.item).__name__,
        "item": _private(entry.item.model_dump(mode="json")),
        **json.loads(result.model_dump_json()),
    }
    with replacing(folder / "items" / f"{entry.key}.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _private(content: Any) -> Any:
    """Return the fields of an item without the user's home folder."""
    if isinstance(content, dict):
        return {key: _private(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_private(value) for value in content]
    return without_home(content) if isinstance(content, str) else content


def _summary(setting: dict[str, Any], results: list[ItemResult]) -> dict[str, Any]:
    """Summarise the results of one setting."""
    rows = [row for result in results for row in result.rows]
    names = dict.fromkeys(name for row in rows for name in row)
    failed = sum(result.failure is not None for result in results)
    figures = {name: statistics([row.get(name, math.nan) for row in rows]) for name in names}
    ended = len(results) - failed
    return {"setting": setting, "items": ended, "failed": failed, "figures": figures}


def statistics(values: list[float]) -> dict[str, float]:
    """Describe the finite values of a sample."""
    sample = np.array([value for value in values if math.isfinite(value)])
    count = len(sample)
    mean = sample.mean() if count else math.nan
    sd = sample.std(ddof=1) if count > 1 else math.nan
    quantiles = np.quantile(sample, (0, 0.05, 0.5, 0.95, 1)) if count else [math.nan] * 5
    return dict(zip(_STATISTICS, map(float, (count, mean, sd, *quantiles)), strict=True))


def _lines(entry: Entry, result: ItemResult) -> Iterator[dict[str, Any]]:
    """Yield the table rows of one item, or its failure."""
    common = {"key": entry.key, "seed": entry.item.seed, "failure": result.failure}
    for field, value in entry.setting.items():
        plain = isinstance(value, (str, int, float))
        common[field] = value if plain else json.dumps(value, default=str)
    for number, row in enumerate(result.rows):
        finite = {name: value for name, value in row.items() if math.isfinite(value)}
        yield {**common, "row": number, **finite}
    if not result.rows:
        yield common
