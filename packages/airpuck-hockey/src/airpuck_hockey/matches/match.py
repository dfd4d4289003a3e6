"""`match` and `league`: games of air hockey between two players, or all pairs, in parallel."""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import pydantic
from jaxtyping import Float

from airpuck import InputError, TwinSettings, read_model, write_bag
from airpuck.extend import (
    Entry,
    Item,
    ItemResult,
    Result,
    Row,
    Stopped,
    Workers,
    check_output,
    check_seed,
    checked_workers,
    completed,
    compute,
    default_twin_settings,
    dispatch,
    fingerprints,
    low_latency,
    numbers,
    wilson_interval,
)
from airpuck_hockey.game.contestant import PLAYERS as KINDS
from airpuck_hockey.game.contestant import contestant
from airpuck_hockey.game.game import Game
from airpuck_hockey.game.hand import HANDS
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.puck.prediction import drawn_puck

#: Identifies the table's stream of random numbers; see `airpuck_hockey.game.game`.
_DRAWN = 21


class Match(Item):
    """One game of air hockey between two players."""

    SOURCES: ClassVar = {
        "left": fingerprints.of_code,
        "right": fingerprints.of_code,
        "model": fingerprints.of_file,
    }
    PACKAGED: ClassVar = ("paper", *KINDS)

    #: Players; see `airpuck_hockey.game.contestant.contestant`.
    left: str = "airpuck"
    right: str = "human"
    #: Model of the craft.
    model: str = "paper:M3"
    #: Rules of the game.
    rules: Rules = pydantic.Field(default_factory=Rules)
    #: Settings of the twin, which override the paper's.
    twin: TwinSettings = pydantic.Field(default_factory=default_twin_settings)
    #: Whether drag and bounces of the puck are drawn for each game, within their uncertainty. No
    #: player gets the true numbers.
    drawn: bool = False
    #: Folder to write the game to; does not affect the result.
    bag: Annotated[str | None, pydantic.Field(exclude=True)] = None

    #: See `Item.reporting`.
    _tell: Callable[[float], None] | None = None

    def reporting(self, tell: Callable[[float], None]) -> Match:
        """Return a game that reports its progress; see `Item.reporting`."""
        game = self.model_copy()
        game._tell = tell
        return game

    def written(self) -> str | None:
        """Hash the bag; see `Item.written`."""
        if self.bag is None:
            return None
        return fingerprints.of_recording(self.bag) if Path(self.bag).exists() else ""

    def run(self) -> list[Row]:
        """Play; see `Item.run`."""
        low_latency()
        settings = self.twin
        if self.drawn:
            random = np.random.default_rng([self.seed, _DRAWN])
            puck = drawn_puck(settings.puck, random)
            settings = settings.model_copy(update={"puck": puck})
        game = Game(
            contestant(self.left),
            contestant(self.right),
            settings=settings,
            believed=self.twin,
            rules=self.rules,
            model=read_model(self.model),
            seed=self.seed,
        )
        game.play(*([self._tell] if self._tell else []))
        if self.bag is not None:
            # Removes the bag of an interrupted run, or a damaged one.
            shutil.rmtree(self.bag, ignore_errors=True)
            write_bag(game.recording(), self.bag)
        return [game.figures()]


@dataclass(frozen=True)
class MatchResult(Result):
    """The games of two players.

    Attributes
    ----------
    left, right : str
        The players.
    seeds : tuple of int
        Seed of each game.
    games : tuple of dict
        Figures of each game; see `airpuck_hockey.game.game.Game.figures`.
    wall_s : float
        Sum of the computing times of all games [s].
    """

    left: str
    right: str
    seeds: tuple[int, ...]
    games: tuple[Row, ...]
    wall_s: float

    @property
    def wins(self) -> tuple[int, int]:
        """Games won by left and right."""
        ahead = [game["left_goals"] - game["right_goals"] for game in self.games]
        return sum(lead > 0 for lead in ahead), sum(lead < 0 for lead in ahead)

    def total(self, name: str) -> int:
        """Sum a figure of both sides over all games.

        Parameters
        ----------
        name : str
            Name without the side, such as ``rail_contacts``.

        Returns
        -------
        int
            The sum.
        """
        return round(sum(game[f"{side}_{name}"] for game in self.games for side in _SIDES))

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``."""
        left, right = self.wins
        lasted = sum(game["duration_s"] for game in self.games)
        sums = [f"{side}_{what}" for what in ("goals", "own_goals", "fouls") for side in _SIDES]
        sums.append("stuck")
        hardest = [g[f"{side}_hardest_rail_contact_m_s"] for g in self.games for side in _SIDES]
        return {
            "left": self.left,
            "right": self.right,
            "games": len(self.games),
            "left_wins": left,
            "right_wins": right,
            "draws": len(self.games) - left - right,
            "left_wins_interval": list(wilson_interval(left, len(self.games))),
            "right_wins_interval": list(wilson_interval(right, len(self.games))),
            **{name: round(sum(game[name] for game in self.games)) for name in sums},
            "rail_contacts": self.total("rail_contacts"),
            "hardest_rail_contact_m_s": max(hardest),
            "crossings": self.total("crossings"),
            "duration_s": lasted,
            "wall_s": self.wall_s,
            "results": [
                {"seed": seed, **game} for seed, game in zip(self.seeds, self.games, strict=True)
            ],
        }


_SIDES = ("left", "right")


def match(
    left: str,
    right: str,
    games: int = 1,
    *,
    seed: int = 0,
    model: str = "paper:M3",
    settings: TwinSettings | None = None,
    rules: Rules | None = None,
    output: str | os.PathLike[str] | None = None,
    workers: Workers = None,
    progress: Callable[[float, int, int], None] = lambda done, of, failed: None,
) -> MatchResult:
    """Let two players play each other.

    Parameters
    ----------
    left, right : str
        Players; see `airpuck_hockey.game.contestant.contestant`.
    games : int, default 1
        Number of games.
    seed : int, default 0
        Seed of the first game; it grows by one from game to game.
    model : str, default "paper:M3"
        Model of the craft: a model file, or one of the paper's.
    settings : TwinSettings, optional
        Table, puck, radio, noise; by default the paper's.
    rules : Rules, optional
        By default first to seven.
    output : path-like, optional
        Folder for the games, as bags ``games/SEED-KEY``, where KEY is a hash of everything that
        determines a game. Games already in the folder are not played again.
    workers : int or str, optional
        Number of processes; by default as many as there are processors. A single process does not
        need Dask. Or the address of a running Dask scheduler, ``"tcp://HOST:PORT"``.
    progress : callable, optional
        Called with the number of games played, including fractions of those in progress, the
        number of all games, and the number of failed ones.

    Returns
    -------
    MatchResult
        All games.

    Raises
    ------
    InputError
        If a player is unknown or fails, or Dask is missing.

    Examples
    --------
    >>> rules = airpuck_hockey.Rules(limit_s=0.5)
    >>> result = airpuck_hockey.match("keeper", "human", rules=rules, workers=1)
    >>> result.wins
    (0, 0)
    """
    game = checked_game(
        (left, right), games, seed, output, model=model, settings=settings, rules=rules
    )
    sides = {"left": left, "right": right}
    games_of = [game.model_copy(update={**sides, "seed": s}) for s in range(seed, seed + games)]
    results = played(games_of, output, workers, progress)
    rows = tuple(result.rows[0] for result in results)
    wall = sum(result.wall_s or 0.0 for result in results)
    return MatchResult(left, right, tuple(game.seed for game in games_of), rows, wall)


def checked_game(
    players: Sequence[str],
    games: int,
    seed: int,
    output: str | os.PathLike[str] | None,
    *,
    model: str,
    settings: TwinSettings | None,
    rules: Rules | None,
    drawn: bool = False,
) -> Match:
    """Check the arguments of a match or a league; return a game without players and seed."""
    numbers.GAMES.check(games, "games")
    for number in (seed, seed + games - 1):
        check_seed(number, limits=numbers.GAME_SEED)
    for name in players:
        contestant(name)
    read_model(model)
    if output is not None:
        check_output(output, "folder", field="output")
    game = Match(model=model, rules=rules or Rules(), drawn=drawn)
    return game if settings is None else game.model_copy(update={"twin": settings})


def played(
    games: Sequence[Match],
    output: str | os.PathLike[str] | None,
    workers: Workers,
    progress: Callable[[float, int, int], None],
    *,
    bags: bool = True,
) -> tuple[ItemResult, ...]:
    """Play games, in processes if there are several; keep results, and bags, in a folder.

    Raises InputError if one fails.
    """
    with ExitStack() as stack:
        folder = Path(output or stack.enter_context(tempfile.TemporaryDirectory()))
        entries = list(_entries(games, folder if output and bags else None))
        where = checked_workers(workers, len(games))
        work = _here if where == 1 else partial(dispatch, workers=where)
        try:
            done = completed(entries, folder, work, retry=True, progress=progress)
        except Stopped as stopped:
            words = "run it again to play the rest" if output else "only -o DIR keeps played games"
            raise Stopped(stopped.number, words) from None
    if done.failures:
        raise InputError(done.failures[0][1])
    return done.results


def _entries(games: Sequence[Match], folder: Path | None) -> Iterator[Entry]:
    """Yield games with their keys, and with the names of their bags in a folder."""
    hashes: dict[Any, str] = {}
    for game in games:
        key = game.key(hashes)
        if folder is not None:
            # The folder may also hold games of other players.
            bag = (folder / "games" / f"{game.seed}-{key[:8]}").absolute()
            game = game.model_copy(update={"bag": str(bag)})
        yield Entry(key, {}, game)


def _here(
    entries: list[Entry], tell: Callable[[str, float], None]
) -> Iterator[tuple[Entry, ItemResult]]:
    """Play games sequentially in this process."""
    for entry in entries:
        yield entry, compute(entry.item, partial(tell, entry.key))


#: Default players.
PLAYERS = (
    *("airpuck:hard", "airpuck:medium", "airpuck:easy", "predecessor:hard"),
    *(f"{hand}:medium" for hand in HANDS),
)


@dataclass(frozen=True, eq=False)
class LeagueResult(Result):
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
