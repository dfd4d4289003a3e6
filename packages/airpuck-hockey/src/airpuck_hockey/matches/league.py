"""`league`: every player plays every other."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck import InputError, TwinSettings
from airpuck.extend import Row, Workers
from airpuck_hockey.game.hand import HANDS
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.matches.match import checked_game, played

#: Default players.
PLAYERS = (
    *("airpuck:hard", "airpuck:medium", "airpuck:easy", "predecessor:hard"),
    *(f"{hand}:medium" for hand in HANDS),
)


@dataclass(frozen=True, eq=False)
class LeagueResult:
    """The games of all pairs.

    Attributes
    ----------
    players : tuple of str
        The players.
    games : tuple of (int, int, dict)
        Indices of the left and the right player, and the figures of their game; see
        `airpuck_hockey.game.game.Game.figures`.
    """

    players: tuple[str, ...]
    games: tuple[tuple[int, int, Row], ...]

    def total(self, name: str) -> Float[np.ndarray, "p p"]:
        """Sum a figure of the games of each pair.

        Parameters
        ----------
        name : str
            ``goals`` or another figure that a game has for each side; ``points``: games won, plus
            half of those drawn; ``wins``; ``games``; or a figure of the whole game, such as
            ``duration_s``.

        Returns
        -------
        array, shape (p, p)
            Sum for the player of the row, in games against the player of the column.
        """
        found = np.zeros((len(self.players), len(self.players)))
        for left, right, game in self.games:
            lead = game["left_goals"] - game["right_goals"]
            for one, other, ahead, side in (
                (left, right, lead, "left"),
                (right, left, -lead, "right"),
            ):
                own = {"points": (np.sign(ahead) + 1) / 2, "wins": float(ahead > 0), "games": 1.0}
                whole = game.get(name, own.get(name, 0.0))
                found[one, other] += game.get(f"{side}_{name}", whole)
        return found

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``."""
        sums = {name: self.total(name) for name in ("games", "wins", "goals", "duration_s")}

        def cell(one: int, other: int) -> dict[str, float] | None:
            if one == other:
                return None
            return {
                "games": round(sums["games"][one, other]),
                "wins": round(sums["wins"][one, other]),
                "losses": round(sums["wins"][other, one]),
                "goals_for": round(sums["goals"][one, other]),
                "goals_against": round(sums["goals"][other, one]),
                "seconds": sums["duration_s"][one, other],
            }

        everyone = range(len(self.players))
        return {
            "players": list(self.players),
            "matrix": [[cell(one, other) for other in everyone] for one in everyone],
        }


def league(
    players: Sequence[str] = PLAYERS,
    games: int = 2,
    *,
    seed: int = 0,
    model: str = "paper:M3",
    settings: TwinSettings | None = None,
    rules: Rules | None = None,
    output: str | os.PathLike[str] | None = None,
    workers: Workers = None,
    only: str | None = None,
    progress: Callable[[float, int, int], None] = lambda done, of, failed: None,
) -> LeagueResult:
    """Let every player play every other.

    Sides alternate from game to game. Drag and bounces of the puck are drawn for each game, within
    their uncertainty; no player gets the true numbers.

    Parameters
    ----------
    players : sequence of str
        Players as for `airpuck_hockey.match`; by default the package's levels and scripted hands.
    games : int, default 2
        Number of games of each pair.
    seed : int, default 0
        Seed of the first game of each pair; it grows by one from game to game.
    model : str, default "paper:M3"
        Model of the craft: a model file, or one of the paper's.
    settings : TwinSettings, optional
        Table, puck, radio, noise; by default the paper's.
    rules : Rules, optional
        By default first to seven.
    output : path-like, optional
        Folder for the results. Games already in the folder are not played again.
    workers : int or str, optional
        Number of processes; by default as many as there are processors. A single process does not
        need Dask. Or the address of a running Dask scheduler, ``"tcp://HOST:PORT"``.
    only : str, optional
        One of the players: only pairs that include it play.
    progress : callable, optional
        Called with the number of games played, including fractions of those in progress, the
        number of all games, and the number of failed ones.

    Returns
    -------
    LeagueResult
        All games.

    Raises
    ------
    InputError
        If a player is unknown, occurs twice or fails, if there are fewer than two, if the only
        player is not among them, or if Dask is missing.

    Examples
    --------
    >>> rules = airpuck_hockey.Rules(limit_s=0.5)
    >>> found = airpuck_hockey.league(("keeper", "human"), games=1, rules=rules, workers=1)
    >>> found.total("games").tolist()
    [[0.0, 1.0], [1.0, 0.0]]
    """
    if len(players) < 2 or len(set(players)) < len(players):
        raise InputError("name at least two players, each only once", field="players")
    if only is not None and only not in players:
        raise InputError(f"{only} is not among the players", field="only")
    game = checked_game(
        players, games, seed, output, model=model, settings=settings, rules=rules, drawn=True
    )
    pairs, matches = [], []
    # All pairs play a game before the next, so that an interrupted league is balanced.
    for number in range(games):
        for one, other in itertools.combinations(range(len(players)), 2):
            if only not in (None, players[one], players[other]):
                continue
            sides = (one, other) if number % 2 == 0 else (other, one)
            names = dict(zip(("left", "right"), (players[side] for side in sides), strict=True))
            pairs.append(sides)
            matches.append(game.model_copy(update={**names, "seed": seed + number}))
    results = played(matches, output, workers, progress, bags=False) if matches else ()
    rows = (result.rows[0] for result in results)
    found = tuple((*sides, row) for sides, row in zip(pairs, rows, strict=True))
    return LeagueResult(tuple(players), found)
