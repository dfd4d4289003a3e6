"""Who can play a game, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.boundary.user_class import load_class
from airpuck.control.reference import Reference
from airpuck.craft.table import AirHockey
from airpuck.flight.pilot import Pilot
from airpuck.hockey.hand import SKILLS, Hand, ScriptedHand
from airpuck.hockey.level import LEVELS, Level
from airpuck.hockey.player import Player
from airpuck.hockey.tactic import Intention, Tactic, View
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
        ``airpuck`` or ``airpuck:LEVEL``, a craft with the package's tactic; ``human`` or
        ``human:LEVEL``, a scripted hand; ``FILE.py:NAME``, a craft with a tactic of the user's.

    Returns
    -------
    Contestant
        For a `Game`.

    Raises
    ------
    InputError
        If nobody is called so.
    """
    kind, colon, level = name.partition(":")
    if kind == "human":
        skill = _by_level(SKILLS, level if colon else "medium", name)
        return Contestant(name, hand=lambda play, seed: ScriptedHand(play, skill, seed))
    if kind == "airpuck":
        return _flown(name, lambda: None, _by_level(LEVELS, level if colon else "hard", name))
    if ".py" in name:
        return _flown(name, tactic_maker(name), LEVELS["hard"])
    raise InputError(
        "nobody is called so; give airpuck, airpuck:LEVEL, human, human:LEVEL or FILE.py:NAME",
        field=name,
    )


def tactic_maker(name: str) -> Callable[[], Tactic]:
    """Return what makes a user's tactic, named FILE.py:NAME."""
    kind = load_class(name, "tactic")

    def make() -> Tactic:
        try:
            tactic = kind()
        # Whatever goes wrong in a user's class is for the user to mend.
        except Exception as error:
            problem = f"cannot be made without arguments: {type(error).__name__}: {error}"
            raise InputError(problem, file=name) from error
        if not isinstance(tactic, Tactic):
            raise InputError("lacks decide(view); see docs/hockey.md", file=name)
        return _Named(tactic, name)

    return make


class _Named:
    """A user's tactic, whose failures name it: a `Tactic`."""

    def __init__(self, tactic: Tactic, name: str) -> None:
        self._tactic, self._name = tactic, name

    def decide(self, view: View) -> Intention:
        """Return what to do now; see `Tactic.decide`."""
        try:
            intention = self._tactic.decide(view)
        except Exception as error:
            problem = f"decide() at {view.time:.2f} s: {type(error).__name__}: {error}"
            raise InputError(problem, file=self._name) from error
        problem = _what_is_wrong(intention, view.time)
        if problem:
            raise InputError(f"decide() at {view.time:.2f} s {problem}", file=self._name)
        return intention


def _what_is_wrong(intention: Any, time: float) -> str:
    """Say why something is no intention; an empty text where it is one."""
    if not isinstance(intention, Intention):
        return f"must return an Intention, not {type(intention).__name__}"
    if not isinstance(intention.reference, Reference):
        return "must give a reference, such as airpuck.SetPoint(-0.9, 0, 0)"
    numbers = {
        "reference": (intention.reference.at(time, 0.0).state, (6,)),
        "meet": (intention.meet, (3,)),
        "avoid": (intention.avoid, (3,)),
    }
    for name, (given, shape) in numbers.items():
        found = None if given is None else _finite(given)
        if given is not None and (found is None or found.shape != shape):
            return f"gave as {name} something else than {shape[0]} finite numbers"
    path, chance = intention.path, intention.chance
    found = None if path is None else _finite(path)
    if path is not None and (found is None or found.shape[1:] != (2,)):
        return "gave as path something else than finite numbers of shape (N, 2)"
    if not (chance is None or isinstance(chance, Real)):
        return "gave as chance something else than a number"
    return ""


def _finite(given: Any) -> np.ndarray | None:
    """Return finite numbers as an array; None if they are others."""
    try:
        found = np.array(given, dtype=float)
    except (TypeError, ValueError):
        return None
    return found if np.isfinite(found).all() else None


def _flown(name: str, tactic: Callable[[], Tactic | None], level: Level) -> Contestant:
    """Return a craft whose player has a tactic and a level."""

    def player(model: Model, play: AirHockey, side: int, seed: int, opponent: float) -> Pilot:
        return Player(
            model, play, tactic(), level=level, side=side, seed=seed, opponent_radius=opponent
        )

    return Contestant(name, player=player)


def _by_level(levels: Mapping[str, Any], level: str, name: str) -> Any:
    """Return what is meant by the name of a level."""
    if level not in levels:
        raise InputError(f"has no such level; give {', '.join(levels)}", field=name)
    return levels[level]
