"""The spec of a campaign: what all items share, a grid of what differs, seeds."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Section, checked, laid_over, read_toml
from airpuck.campaigns.fitting import Fitting
from airpuck.campaigns.fleet import Fleet
from airpuck.campaigns.item import Entry, Item, fingerprint
from airpuck.campaigns.recovery import Recovery
from airpuck.campaigns.tracking import Tracking

#: What an item can be.
KINDS: dict[str, type[Item]] = {
    "tracking": Tracking,
    "recovery": Recovery,
    "fit": Fitting,
    "fleet": Fleet,
}
#: More are taken for a slip of the pen.
_MOST = 1_000_000


class Spec(Section):
    """Content of a spec file."""

    #: What an item is.
    kind: Literal["tracking", "recovery", "fit", "fleet"]
    #: How many, from 0 on, or which.
    seeds: (
        Annotated[int, pydantic.Field(ge=1)]
        | Annotated[tuple[Annotated[int, pydantic.Field(ge=0)], ...], pydantic.Field(min_length=1)]
    ) = 1
    #: Fields that all items share.
    base: dict[str, Any] = pydantic.Field(default_factory=dict)
    #: Fields, each with a list of values: every combination is a setting.
    grid: dict[str, Any] = pydantic.Field(default_factory=dict)


def read_spec(path: str | os.PathLike[str]) -> list[Entry]:
    """Read a spec file, and lay out all of its items."""
    spec = read_toml(path, Spec)
    kind, folder = KINDS[spec.kind], Path(path).resolve().parent
    seeds = tuple(range(spec.seeds)) if isinstance(spec.seeds, int) else spec.seeds
    for field in ("base", "grid"):
        if "seed" in getattr(spec, field):
            raise InputError("is given by seeds; leave it out", file=path, field=f"{field}.seed")
    axes = dict(_axes(spec.grid, path))
    size = len(seeds)
    for values in axes.values():
        size *= len(values)
    if size > _MOST:
        raise InputError(f"asks for {size} items, more than {_MOST}", file=path)
    remembered = cache(fingerprint)
    entries: dict[str, Entry] = {}
    for values in itertools.product(*axes.values()):
        setting = dict(zip(axes, values, strict=True))
        content = dict(spec.base)
        for field, value in setting.items():
            content = laid_over(content, _nested(field, value))
        content = {
            field: _resolved(value, folder) if field in kind.SOURCES else value
            for field, value in content.items()
        }
        # Checked once for all seeds.
        item = checked(content, kind, file=path)
        for seed in seeds:
            seeded = item.model_copy(update={"seed": seed})
            key = seeded.key(remembered)
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
        elif isinstance(values, list) and values:
            told = [json.dumps(value, sort_keys=True, default=str) for value in values]
            if len(set(told)) < len(told):
                raise InputError("names a value twice", file=path, field=f"grid.{field}")
            yield field, values
        else:
            raise InputError("must be a list of values", file=path, field=f"grid.{field}")


def _nested(field: str, value: Any) -> dict[str, Any]:
    """``a.b``, value -> ``{"a": {"b": value}}``."""
    for name in reversed(field.split(".")):
        value = {name: value}
    return value


def _resolved(names: Any, folder: Path) -> Any:
    """Make names of files absolute."""
    if isinstance(names, list):
        return [_resolved(name, folder) for name in names]
    if not isinstance(names, str) or names.startswith("paper:"):
        return names
    return str(folder / os.path.expandvars(names))
