"""Players of a game, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from airpuck import AirHockey, InputError, Model, Pilot, PuckState
from airpuck.extend import UserCode, nearest, numbers_of, sheltered
from airpuck_hockey.game.hand import HANDS, KEEPERS, Hand, HumanHand, Point
from airpuck_hockey.player.all_rounder import AllRounder, predecessor
from airpuck_hockey.player.player import LEVELS, Level, Player
from airpuck_hockey.player.tactic import Intention, Tactic, View

#: Tactics of the package's own craft.
_CRAFT = {"airpuck": AllRounder, "predecessor": predecessor}
#: Names of the package's own players; other names are files.
PLAYERS = (*_CRAFT, *HANDS)


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
        `airpuck_hockey.game.hand.HANDS`, also with ``:LEVEL``, a scripted hand;
        ``FILE.py:NAME``, a craft with a user's tactic, or a user's `HumanHand`.

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
    >>> airpuck_hockey.contestant("airpuck:easy").name
    'airpuck:easy'
    """
    kind, colon, level = name.partition(":")
    if kind in HANDS:
        hand, levels = HANDS[kind]
        dexterity = _by_level(levels, level if colon else "medium", name)
        return Contestant(name, hand=lambda equipment, seed: hand(equipment, dexterity, seed))
    if kind in _CRAFT:
        strength = _by_level(LEVELS, level if colon else "hard", name)
        return craft_contestant(name, _CRAFT[kind], strength, learns=kind != "predecessor")
    if ".py" in name:
        code = UserCode(name, "player")
        if isinstance(code.kind, type) and issubclass(code.kind, HumanHand):
            return Contestant(name, hand=lambda equipment, seed: _UserHand(code, equipment, seed))
        return craft_contestant(name, tactic_maker(name), LEVELS["hard"])
    known = ", ".join(f"{player}[:LEVEL]" for player in PLAYERS)
    problem = f"unknown player; use {known} or FILE.py:NAME{nearest(kind, PLAYERS)}"
    raise InputError(problem, field=name)


def tactic_maker(name: str) -> Callable[[], Tactic]:
    """Return a factory for a user's tactic, named FILE.py:NAME."""
    code = UserCode(name, "tactic")

    def make() -> Tactic:
        tactic = code.run("cannot be made without arguments", code.kind)
        if not code.run("is no tactic", isinstance, tactic, Tactic):
            code.refuse("lacks decide(view); see docs/hockey.md")
        return _UserTactic(tactic, code)

    return make


class _UserHand:
    """A hand of a user's class, with the limits of a keeper of medium level; a `Hand`."""

    def __init__(self, code: UserCode, equipment: AirHockey, seed: int) -> None:
        self._code = code
        self._own = code.run("cannot be made", code.kind, equipment, KEEPERS["medium"], seed)

    def target(self, time: float, own: Point, puck: PuckState | None, opponent: Point) -> Point:
        """Return the target of the mallet; see `Hand.target`."""
        return self._code.run("target()", self._own.target, time, own, puck, opponent)


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
        target = self._code.run(called, reference.at, view.time, 0.0)
        self._code.run(called, lambda: numbers_of(target.state, (6,), "reference"))
        return self._code.run(called, lambda: replace(intention, reference=reference))


def craft_contestant(
    name: str, tactic: Callable[[], Tactic], level: Level, learns: bool = True
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
        problem = f"unknown level; use {', '.join(levels)}{nearest(level, levels)}"
        raise InputError(problem, field=name)
    return levels[level]
