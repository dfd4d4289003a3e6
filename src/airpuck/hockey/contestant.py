"""Who can play a game, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.craft.table import AirHockey
from airpuck.flight.pilot import Pilot
from airpuck.hockey.hand import SKILLS, Hand, ScriptedHand
from airpuck.model.model_file import Model


@dataclass(frozen=True)
class Contestant:
    """Who plays: a craft with a player, or a hand with a mallet.

    Attributes
    ----------
    name : str
        What it is called.
    player : callable, optional
        Of a craft: makes its player from model, table, side (-1, 1), seed and the radius of the
        opponent's disc [m].
    hand : callable, optional
        Of a hand: makes it from table and seed.
    """

    name: str
    player: Callable[[Model, AirHockey, int, int, float], Pilot] | None = None
    hand: Callable[[AirHockey, int], Hand] | None = None


def contestant(name: str) -> Contestant:
    """Return who plays under a name.

    Parameters
    ----------
    name : str
        ``human`` or ``human:LEVEL``, scripted.

    Returns
    -------
    Contestant
        For a `Game`.

    Raises
    ------
    InputError
        If nobody is called so.
    """
    kind, _, level = name.partition(":")
    if kind == "human":
        skill = _by_level(SKILLS, level or "medium", name)
        return Contestant(name, hand=lambda play, seed: ScriptedHand(play, skill, seed))
    raise InputError("nobody is called so; give human or human:LEVEL", field=name)


def _by_level(levels: dict[str, Any], level: str, name: str) -> Any:
    """Return what is meant by the name of a level."""
    if level not in levels:
        raise InputError(f"has no such level; give {', '.join(levels)}", field=name)
    return levels[level]
