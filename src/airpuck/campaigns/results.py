"""Results of a campaign: a file for each item, tables of all."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from airpuck import __version__
from airpuck.boundary.errors import InputError
from airpuck.boundary.files import replacing
from airpuck.campaigns.item import Entry, Row

#: Of the rows of a setting.
QUANTILES = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class Result:
    """What became of an item."""

    #: Its figures; empty where it failed.
    rows: tuple[Row, ...]
    #: Why it failed.
    failure: str | None = None
    #: Time it took, where it came to an end [s].
    wall_s: float | None = None


class Store:
    """Results in a folder, each in a file of its own that is written once and in one step."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def _path(self, key: str) -> Path:
        return self.folder / "items" / f"{key}.json"

    def read(self, key: str) -> Result | None:
        """Read a result."""
        path = self._path(key)
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            rows = tuple(
                {name: math.nan if value is None else float(value) for name, value in row.items()}
                for row in content["rows"]
            )
            return Result(rows, content["failure"], content["wall_s"])
        except FileNotFoundError:
            return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(
                f"is no result of a campaign ({error}); remove it", file=path
            ) from error

    def write(self, entry: Entry, result: Result) -> None:
        """Write a result."""
        content = {
            "airpuck": __version__,
            "kind": type(entry.item).__name__,
            "item": entry.item.model_dump(mode="json"),
            "failure": result.failure,
            "wall_s": result.wall_s,
            "rows": [
                {k: v if math.isfinite(v) else None for k, v in r.items()} for r in result.rows
            ],
        }
        with replacing(self._path(entry.key)) as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Summary:
    """Figures over all rows of one setting."""

    #: What the grid says, by dotted field.
    setting: dict[str, Any]
    #: Items that came to an end, and that failed.
    items: int
    failed: int
    #: By name: ``count`` (of rows where it is known), ``mean``, ``sd``, ``min``, ``q05``, ``q50``,
    #: ``q95``, ``max``; nan where there is none.
    figures: dict[str, dict[str, float]]


def summarise(entries: Sequence[Entry], results: Sequence[Result]) -> list[Summary]:
    """Sum up results, setting by setting."""
    groups: dict[str, tuple[dict[str, Any], list[Result]]] = {}
    for entry, result in zip(entries, results, strict=True):
        told = json.dumps(entry.setting, sort_keys=True, default=str)
        groups.setdefault(told, (entry.setting, []))[1].append(result)
    summaries = []
    for setting, own in groups.values():
        rows = [row for result in own for row in result.rows]
        names = dict.fromkeys(name for row in rows for name in row)
        figures = {
            name: statistics(np.array([row.get(name, math.nan) for row in rows])) for name in names
        }
        failed = sum(result.failure is not None for result in own)
        summaries.append(Summary(setting, len(own) - failed, failed, figures))
    return summaries


def statistics(values: np.ndarray) -> dict[str, float]:
    """Describe a sample."""
    known = values[np.isfinite(values)]
    found = dict.fromkeys(("mean", "sd", "min", "q05", "q50", "q95", "max"), math.nan)
    if len(known):
        found["mean"], found["min"], found["max"] = known.mean(), known.min(), known.max()
        found |= zip(("q05", "q50", "q95"), np.quantile(known, QUANTILES), strict=True)
    if len(known) > 1:
        found["sd"] = known.std(ddof=1)
    return {"count": float(len(known)), **{name: float(value) for name, value in found.items()}}


def write_table(path: Path, entries: Sequence[Entry], results: Sequence[Result]) -> None:
    """Write all rows as CSV."""
    settings = dict.fromkeys(field for entry in entries for field in entry.setting)
    names = dict.fromkeys(n for result in results for row in result.rows for n in row)
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["key", *settings, "seed", "row", *names, "failure"])
        writer.writeheader()
        writer.writerows(_lines(entries, results))


def _lines(entries: Sequence[Entry], results: Sequence[Result]) -> Iterator[dict[str, Any]]:
    for entry, result in zip(entries, results, strict=True):
        common = {"key": entry.key, "seed": entry.item.seed, "failure": result.failure}
        common |= {
            field: value if isinstance(value, (str, int, float)) else json.dumps(value, default=str)
            for field, value in entry.setting.items()
        }
        for number, row in enumerate(result.rows or ({},)):
            known = {name: value for name, value in row.items() if math.isfinite(value)}
            yield {**common, "row": number if row else None, **known}
