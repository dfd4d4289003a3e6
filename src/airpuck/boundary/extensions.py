"""Other distributions: what they add to airpuck through entry points, and what to install."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

from airpuck.boundary.errors import InputError, nearest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: Groups of entry points, which any distribution may use: kinds of actuators
#: (`ActuatorKind`), commands (functions), effects (`Effect`),
#: kinds of export (`ExportKind`), kinds of campaign items (`Item`), laws (`Law`), and opponents on
#: the graph.
Group = Literal[
    "airpuck.actuators",
    "airpuck.commands",
    "airpuck.effects",
    "airpuck.exports",
    "airpuck.items",
    "airpuck.laws",
    "airpuck.opponents",
]
_TYPES = ["Game", "Intention", "Level", "Player", "PuckFilter", "Rules", "Tactic", "View"]
_TOOLS = ["contestant", "identify_puck", "league", "match", "skills"]
_PLAYING = ["identify-puck", "league", "match", "play", "play-live", "skills", "watch-match"]
#: What airpuck-hockey adds, so that a name without it leads there: public names by group, and the
#: names that `airpuck` itself had.
HOCKEY: Mapping[str, Sequence[str]] = {
    "airpuck.commands": _PLAYING,
    "airpuck.exports": ["gym-hockey"],
    "airpuck.items": ["match"],
    "airpuck.opponents": ["easy", "medium", "hard", "page"],
    "airpuck": [*_TOOLS, *_TYPES],
}

#: Former public names, with their replacement.
_FORMER = {"fly_fleet": "airpuck.TwinBatch", "Adam": "studies/adam.py"}
_FORMER |= {"select_model": "airpuck.study", "Selection": "airpuck.Study"}


@cache
def added(group: Group) -> Mapping[str, EntryPoint]:
    """Return what installed distributions add to a group, by name."""
    from importlib import metadata  # takes long to import, and few commands need it

    return {entry.name: entry for entry in metadata.entry_points(group=group)}


def loaded(group: Group, name: str, use: Callable[[Any], Any] = lambda found: found) -> Any:
    """Import what a distribution adds to a group, and use it; if that fails, name the source."""
    if name not in added(group):
        raise InputError(_needs_hockey(name))
    entry = added(group)[name]
    try:
        return use(entry.load())
    except Exception as error:
        source = entry.dist.name if entry.dist else entry.value
        problem = f"{source} adds {name}, but it cannot be used ({type(error).__name__}: {error})"
        raise InputError(f"{problem}; upgrade or uninstall {source}") from error


def moved(name: str, known: Sequence[str]) -> Any:
    """Return a name that moved from `airpuck` to airpuck-hockey; see `HOCKEY`."""
    if name not in HOCKEY["airpuck"]:
        remedy = f"; use {_FORMER[name]}" if name in _FORMER else nearest(name, known)
        raise AttributeError(f"module 'airpuck' has no attribute {name!r}{remedy}")
    try:
        return getattr(import_module("airpuck_hockey"), name)
    except ModuleNotFoundError as error:
        if error.name != "airpuck_hockey":
            raise
        raise AttributeError(_needs_hockey(f"airpuck.{name}")) from None


def _needs_hockey(name: str) -> str:
    """Return the problem, and what to install, for a name that airpuck-hockey adds."""
    return f"{name} is part of airpuck-hockey, which is not installed: pip install airpuck-hockey"
