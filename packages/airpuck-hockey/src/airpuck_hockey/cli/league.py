"""The command for a league of players."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument

import airpuck_hockey
from airpuck.extend import Setting, command, numbers, options, report, show_time_left, table
from airpuck_hockey.cli.match import PLAYER, GameRules, Pairing, read_craft, read_player

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck_hockey.matches.match import LeagueResult


@command("Air hockey")
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
    ] = 2,
    seed: options.Seed = 0,
    model: Annotated[str, Setting("Model of the craft.", metavar="MODEL")] = Pairing.model,
    twin: options.ReadTwin = None,
    workers: options.Workers = None,
    only: Annotated[
        str | None, Setting("Play only pairs that include this player.", metavar="PLAYER")
    ] = None,
    output: Annotated[
        Path | None, options.output("DIR", "Folder for results; games in it are not played again.")
    ] = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Let every player play every other.

    Drag and bounces of the puck differ from game to game, and no player knows them exactly.
    """
    from airpuck_hockey.matches.match import PLAYERS

    if players:
        read_craft(model, players, quiet)
    else:
        read_player(model, quiet)
    with show_time_left("games", quiet) as progress:
        found = airpuck_hockey.league(
            players or PLAYERS,
            games,
            seed=seed,
            model=model,
            settings=twin,
            rules=rules,
            output=output,
            workers=workers,
            only=only,
            progress=progress,
        )
    report(found.to_json(), json_file, _standings(found))


def _standings(found: LeagueResult) -> Table:
    """Tabulate the players, by points per game: a draw is half a win."""
    sums = {name: found.total(name) for name in ("games", "wins", "goals", "duration_s")}
    points = found.total("points").sum(axis=1) / sums["games"].sum(axis=1).clip(1)
    rows = []
    for number in (-points).argsort(kind="stable"):
        games, wins, scored, seconds = (sums[name][number].sum() for name in sums)
        lost, conceded = (sums[name][:, number].sum() for name in ("wins", "goals"))
        rows.append(
            [
                found.players[number],
                f"{points[number]:.2f}",
                *(f"{count:.0f}" for count in (wins, games - wins - lost, lost)),
                f"{scored:.0f}:{conceded:.0f}",
                f"{60 * scored / seconds:.2f}",
            ]
        )
    headings = ("player", "points per game", "won", "drawn", "lost", "goals", "goals per min")
    return table(headings, rows, title=f"{len(found.games)} games")
