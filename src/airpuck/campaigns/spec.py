"""The spec of a campaign: fields that all items share, a grid of varied fields, seeds."""

from __future__ import annotations

import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pydantic

from airpuck.boundary.errors import InputError
from airpuck.boundary.extensions import HOCKEY, added, loaded
from airpuck.boundary.files import Section, checked, laid_over, read_toml
from airpuck.boundary.kinds import unknown
from airpuck.campaigns.items import (
    Count,
    Fitting,
    Item,
    Natural,
    Recovery,
    ShortestTime,
    Tracking,
)

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


@dataclass(frozen=True)
class Entry:
    """An item and its place in the campaign."""

    #: Key of the item; equal computations have equal keys in all campaigns.
    key: str
    #: Values from the grid, by dotted field.
    setting: dict[str, Any]
    item: Item


def read_spec(path: str | os.PathLike[str]) -> list[Entry]:
    """Read a spec file and create all of its items."""
    spec, folder = read_toml(path, Spec), Path(path).resolve().parent
    for table, content in (("base", spec.base), ("grid", spec.grid)):
        if "seed" in content:
            raise InputError("is set by seeds; remove it", file=path, field=f"{table}.seed")
    kind, axes = _kind(spec.kind, path), dict(_axes(spec.grid, path))
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
        named = kind.SOURCES & content.keys()
        sources = {name: _resolved(content[name], folder, kind) for name in named}
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


def _kind(name: str, path: str | os.PathLike[str]) -> type[Item]:
    """Return a kind of items, which another distribution may add."""
    if name in KINDS:
        return KINDS[name]
    if name in (*added("airpuck.items"), *HOCKEY["airpuck.items"]):
        return loaded("airpuck.items", name)
    raise InputError(unknown(name, [*KINDS, *added("airpuck.items")]), file=path, field="kind")


def _resolved(names: Any, folder: Path, kind: type[Item]) -> Any:
    """Make file names absolute."""
    if isinstance(names, list):
        return [_resolved(name, folder, kind) for name in names]
    if not isinstance(names, str) or not kind.is_file(names):
        return names
    return str(folder / os.path.expandvars(names))
