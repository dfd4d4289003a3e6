"""`league`: every player plays every other; ratings with intervals."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.results import plain
from airpuck.campaigns.items import Row
from airpuck.campaigns.match import checked_game, played
from airpuck.campaigns.rating import ratings
from airpuck.campaigns.recorded_games import recorded_games
from airpuck.control.settings import Workers
from airpuck.hockey.measured_hand import MeasuredHand
from airpuck.hockey.opponents import HANDS
from airpuck.hockey.rules import Rules
from airpuck.twin.settings import TwinSettings, default_twin_settings

#: Default players.
PLAYERS = (
    *("airpuck:hard", "airpuck:medium", "airpuck:easy", "predecessor:hard"),
    *(f"{hand}:medium" for hand in HANDS),
)
#: Half the width of a 95 % interval, in standard errors.
_QUANTILE = 1.96


@dataclass(frozen=True, eq=False)
class LeagueResult:
    """The games of all pairs, and the players' ratings.

    Attributes
    ----------
    players : tuple of str
        The players.
    games : tuple of (int, int, dict)
        Indices of the left and the right player, and the figures of their game; see
        `airpuck.hockey.game.Game.figures`.
    people : mapping of str to MeasuredHand
        Limits of the people whose recorded games count; then goals are rated instead of games.
    """

    players: tuple[str, ...]
    games: tuple[tuple[int, int, Row], ...]
    people: Mapping[str, MeasuredHand] = field(default_factory=dict)

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

    @property
    def ratings(self) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
        """Elo ratings with mean 0, and their covariance."""
        return ratings(self.total("goals" if self.people else "points"))

    @property
    def intervals(self) -> Float[np.ndarray, "p 3"]:
        """Rating of each player, and the ends of its 95 % interval."""
        value, covariance = self.ratings
        half = _QUANTILE * np.sqrt(np.diag(covariance))
        return np.column_stack([value, value - half, value + half])

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
            "rated_by": "goals" if self.people else "games",
            "people": plain(self.people),
            "ratings": [
                {"player": player, "value": value, "low": low, "high": high}
                for player, (value, low, high) in zip(
                    self.players, self.intervals.tolist(), strict=True
                )
            ],
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
    bags: Sequence[str | os.PathLike[str]] = (),
    only: str | None = None,
    progress: Callable[[float, int, int], None] = lambda done, of, failed: None,
) -> LeagueResult:
    """Let every player play every other, and rate them.

    Sides alternate from game to game. Drag and bounces of the puck are drawn for each game, within
    their uncertainty; no player gets the true numbers.

    Parameters
    ----------
    players : sequence of str
        Players as for `airpuck.match`; by default the package's levels and scripted hands.
    games : int, default 2
        Number of games of each pair.
    seed : int, default 0
        Seed of the first game of each pair; it grows by one from game to game.
    model : str, default "paper:M3"
        Model of the craft: a model file, or one of the paper's.
    settings : TwinSettings, optional
        Table, puck, radio, noise; by default the packaged ones.
    rules : Rules, optional
        By default first to seven.
    output : path-like, optional
        Folder for the results. Games already in the folder are not played again.
    workers : int or str, optional
        Number of processes; by default as many as there are processors. A single process does not
        need Dask. Or the address of a running Dask scheduler, ``"tcp://HOST:PORT"``.
    bags : sequence of path-like, optional
        Folders of recorded games, one for each person. People are rated in the same league, by
        goals, and their limits are measured.
    only : str, optional
        One of the players: only pairs that include it play.
    progress : callable, optional
        Called with the number of games played, including fractions of those in progress, the
        number of all games, and the number of failed ones.

    Returns
    -------
    LeagueResult
        All games, and the ratings.

    Raises
    ------
    InputError
        If a player is unknown, occurs twice or fails, if there are fewer than two, if the only
        player is not among them, if Dask is missing, or if a folder does not hold recorded games.

    Examples
    --------
    >>> rules = airpuck.Rules(limit_s=0.5)
    >>> found = airpuck.league(("keeper", "human"), games=1, rules=rules, workers=1)
    >>> found.intervals.shape
    (2, 3)
    """
    recorded = recorded_games(bags, settings or default_twin_settings())
    if (len(players) < 2 and not bags) or len(set(players)) < len(players):
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
    found = [(*sides, row) for sides, row in zip(pairs, rows, strict=True)]
    # In a dictionary names keep their order, and repeated ones count once.
    known = dict.fromkeys([*players, *(name for game in recorded.games for name in game[:2])])
    names = list(known)
    found += [(names.index(one), names.index(other), row) for one, other, row in recorded.games]
    return LeagueResult(tuple(names), tuple(found), recorded.people)
