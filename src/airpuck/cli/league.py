"""The command for a league of players."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Setting
from airpuck.cli import inputs, options
from airpuck.cli.app import app
from airpuck.cli.match import PLAYER, GameRules, Pairing, read_craft
from airpuck.cli.output import report, show_time_left, table
from airpuck.control.settings import Workers
from airpuck.hockey.rules import Rules

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.campaigns.league import LeagueResult

#: Default number of games of each pair.
_GAMES = 2


@app.command(rich_help_panel="Air hockey")
def league(
    rules: GameRules,
    players: Annotated[
        list[str] | None,
        Argument(
            metavar="PLAYER", help=f"{PLAYER} By default our levels, predecessor and all hands."
        ),
    ] = None,
    games: Annotated[
        int, Setting("Number of games of each pair; sides alternate.", numbers.GAMES, "N")
    ] = _GAMES,
    seed: options.Seed = 0,
    model: Annotated[str, Setting("Model of the craft.", metavar="MODEL")] = Pairing.model,
    twin: options.ReadTwin = None,
    workers: options.Workers = None,
    bags: Annotated[
        list[Path] | None,
        Setting("Games of a person, by airpuck play --record; may be repeated.", metavar="DIR"),
    ] = None,
    only: Annotated[
        str | None, Setting("Play only pairs that include this player.", metavar="PLAYER")
    ] = None,
    output: Annotated[
        Path | None,
        options.output("DIR", "Folder for results and a figure; games in it are not played again."),
    ] = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Let every player play every other, and rate them.

    Drag and bounces of the puck differ from game to game, and no player knows them exactly.
    With --bags DIR … people are rated from their recorded games, alone or among the given players.
    """
    from airpuck.campaigns.league import PLAYERS

    folders = [
        *(bags or ()),
        *(Path(name) for name in players or () if bags and Path(name).is_dir()),
    ]
    others = [name for name in players or () if Path(name) not in folders]
    _check_names(others)
    if folders and len(others) < 2:
        _refuse_games(games, seed, model, rules, workers, only)
    elif others:
        read_craft(model, others, quiet)
    else:
        inputs.read_player(model, quiet)
    with show_time_left("games", quiet) as progress:
        found = airpuck.league(
            others or (() if folders else PLAYERS),
            games,
            seed=seed,
            model=model,
            settings=twin,
            rules=rules,
            output=output,
            workers=workers,
            bags=folders,
            only=only,
            progress=progress,
        )
    figure = None
    if output is not None:
        from airpuck.report.league_figure import league_figure
        from airpuck.report.style import write_png

        figure = output / "league.png"
        write_png(league_figure(found), figure)
    people = [_people(found)] if found.people else []
    report(found.to_json(), json_file, _ratings(found), *people, figure)


def _check_names(players: Sequence[str]) -> None:
    """Raise InputError for a folder among the players."""
    from airpuck.hockey.contestant import PLAYERS

    for name in players:
        if Path(name).is_dir() and name.partition(":")[0] not in PLAYERS:
            raise InputError("is a folder; for a person's games, use --bags", field=name)
        if name.endswith("/"):
            raise InputError("there is no such folder", field=name)


def _refuse_games(
    games: int, seed: int, model: str, rules: Rules, workers: Workers, only: str | None
) -> None:
    """Raise InputError for an option of games if only recorded ones count."""
    given = {
        "--games": games != _GAMES,
        "--seed": seed != 0,
        "--model": model != Pairing.model,
        "--goals": rules.goals != Rules.goals,
        "--limit": rules.limit_s != Rules.limit_s,
        "--workers": workers is not None,
        "--only": only is not None,
    }
    for option, changed in given.items():
        if changed:
            raise InputError(
                "has no effect on recorded games; leave it out, or name at least two players",
                field=option,
            )


def _ratings(found: LeagueResult) -> Table:
    """Tabulate the players, strongest first."""
    sums = {name: found.total(name) for name in ("games", "wins", "goals", "duration_s")}
    rows = []
    for number in (-found.intervals[:, 0]).argsort():
        value, low, high = found.intervals[number]
        games, wins, scored, seconds = (sums[name][number].sum() for name in sums)
        lost, conceded = (sums[name][:, number].sum() for name in ("wins", "goals"))
        rows.append(
            [
                found.players[number],
                f"{round(value):+d}",  # without negative zeros
                f"{round(low):+d} to {round(high):+d}",
                *(f"{count:.0f}" for count in (wins, games - wins - lost, lost)),
                f"{scored:.0f}:{conceded:.0f}",
                f"{60 * scored / seconds:.2f}",
            ]
        )
    headings = ("player", "Elo", "95 % interval", "won", "drawn", "lost", "goals", "goals per min")
    return table(headings, rows, title=f"{len(found.games)} games")


def _people(found: LeagueResult) -> Table:
    """Tabulate what the recorded games reveal about each person."""
    rows = [
        [
            name,
            *(
                "–"
                if math.isnan(one.value)
                else f"{factor * one.value:.{digits}f} ({factor * one.low:.{digits}f} to "
                f"{factor * one.high:.{digits}f})"
                for one, factor, digits in (
                    (hand.reaction_s, 1e3, 0),
                    (hand.speed_m_s, 1.0, 2),
                    (hand.acceleration_m_s2, 1.0, 1),
                    (hand.aim_rad, 1.0, 3),
                )
            ),
        ]
        for name, hand in found.people.items()
    ]
    headings = ("person", "reaction ms", "speed m/s", "acceleration m/s²", "aim rad")
    return table(headings, rows, title="People, with 95 % intervals; –: too few strokes or hits")
