"""Players of a game, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, get_args

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.user_code import UserCode
from airpuck.control.pilot import Pilot
from airpuck.control.reference import sheltered
from airpuck.craft.table import AirHockey
from airpuck.hockey.all_rounder import predecessor
from airpuck.hockey.hand import Hand
from airpuck.hockey.level import LEVELS, Level
from airpuck.hockey.opponents import HANDS
from airpuck.hockey.player import Player
from airpuck.hockey.tactic import Intention, Kind, Tactic, View
from airpuck.model.model_file import Model

#: Names of the package's own players; other names are files.
PLAYERS = ("airpuck", "predecessor", *HANDS)


@dataclass(frozen=True)
class Contestant:
    """A participant of a game: a craft with a player, or a hand with a mallet.

    Attributes
    ----------
    name : str
        Name of the contestant.
    player : callable, optional
        For a craft: makes its player from model, table, side (-1, 1), seed and the radius of the
        opponent's disc [m].
    hand : callable, optional
        For a hand: makes it from table and seed.
    """

    name: str
    player: Callable[[Model, AirHockey, int, int, float], Pilot] | None = None
    hand: Callable[[AirHockey, int], Hand] | None = None


def contestant(name: str) -> Contestant:
    """Return the named contestant.

    Parameters
    ----------
    name : str
        ``airpuck`` or ``airpuck:LEVEL``, a craft with the package's tactic; ``predecessor``, also
        with ``:LEVEL``, the same without learning and with slower shots; a name of
        `airpuck.hockey.opponents.HANDS`, also with ``:LEVEL``, a scripted hand; ``FILE.py:NAME``, a
        craft with a user's tactic.

    Returns
    -------
    Contestant
        The contestant, for a `Game`.

    Raises
    ------
    InputError
        If the player or its level is unknown.

    Examples
    --------
    >>> airpuck.contestant("airpuck:easy").name
    'airpuck:easy'
    """
    kind, colon, level = name.partition(":")
    if kind in HANDS:
        hand, levels = HANDS[kind]
        dexterity = _by_level(levels, level if colon else "medium", name)
        return Contestant(name, hand=lambda equipment, seed: hand(equipment, dexterity, seed))
    if kind == "airpuck":
        return _flown(name, lambda: None, _by_level(LEVELS, level if colon else "hard", name))
    if kind == "predecessor":
        strength = _by_level(LEVELS, level if colon else "hard", name)
        return _flown(name, predecessor, strength, learns=False)
    if ".py" in name:
        return _flown(name, tactic_maker(name), LEVELS["hard"])
    known = ", ".join(f"{player}[:LEVEL]" for player in PLAYERS)
    raise InputError(f"unknown player; use {known} or FILE.py:NAME", field=name)


def tactic_maker(name: str) -> Callable[[], Tactic]:
    """Return a factory for a user's tactic, named FILE.py:NAME."""
    code = UserCode(name, "tactic")

    def make() -> Tactic:
        tactic = code.run("cannot be made without arguments", code.kind)
        if not code.run("is no tactic", isinstance, tactic, Tactic):
            code.refuse("lacks decide(view); see docs/hockey.md")
        return _UserTactic(tactic, code)

    return make


class _UserTactic:
    """A tactic from a user's class, with its results checked; a `Tactic`."""

    def __init__(self, own: Tactic, code: UserCode) -> None:
        self._own, self._code = own, code

    def decide(self, view: View) -> Intention:
        """Return the intention; see `Tactic.decide`."""
        called = f"decide() at {view.time:.2f} s"
        intention = self._code.run(called, self._own.decide, view)
        if not isinstance(intention, Intention):
            returned = type(intention).__name__
            self._code.refuse(f"{called} must return an Intention, not {returned}")
        reference = self._code.run(called, sheltered, intention.reference, self._code)
        intention = self._code.run(called, lambda: replace(intention, reference=reference))
        problem = self._code.run(called, _what_is_wrong, intention, view.time)
        if problem:
            self._code.refuse(f"{called} {problem}")
        return intention


def _what_is_wrong(intention: Intention, time: float) -> str:
    """Return the first problem with an intention, or an empty text."""
    if intention.kind not in get_args(Kind):
        return f"gave a kind other than {', '.join(get_args(Kind))}"
    numbers = {
        "reference": (intention.reference.at(time, 0.0).state, (6,)),
        "meet": (intention.meet, (3,)),
        "avoid": (intention.avoid, (3,)),
    }
    for name, (given, shape) in numbers.items():
        found = None if given is None else _finite(given)
        if given is not None and (found is None or found.shape != shape):
            return f"gave a {name} that is not {shape[0]} finite numbers"
    path, chance = intention.path, intention.chance
    found = None if path is None else _finite(path)
    if path is not None and (found is None or found.ndim != 2 or found.shape[1] != 2):
        return "gave a path that is not an array of finite numbers (N, 2)"
    if not (chance is None or isinstance(chance, Real)):
        return "gave a chance that is not a number"
    return ""


def _finite(given: Any) -> np.ndarray | None:
    """Return finite numbers as an array; None if some are not finite numbers."""
    try:
        found = np.array(given, dtype=float)
    except (TypeError, ValueError):
        return None
    return found if np.isfinite(found).all() else None


def _flown(
    name: str, tactic: Callable[[], Tactic | None], level: Level, learns: bool = True
) -> Contestant:
    """Return a craft whose player has a given tactic and level."""

    def player(model: Model, equipment: AirHockey, side: int, seed: int, opponent: float) -> Pilot:
        return Player(
            model,
            equipment,
            tactic(),
            level=level,
            side=side,
            seed=seed,
            opponent_radius=opponent,
            learns=learns,
        )

    return Contestant(name, player=player)


def _by_level(levels: Mapping[str, Any], level: str, name: str) -> Any:
    """Return the entry for a level."""
    if level not in levels:
        raise InputError(f"unknown level; use {', '.join(levels)}", field=name)
    return levels[level]
