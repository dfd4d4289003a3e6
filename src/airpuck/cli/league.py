"""The command for a league of players."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.settings import Setting
from airpuck.cli import inputs, options
from airpuck.cli.app import app
from airpuck.cli.match import PLAYER, GameRules
from airpuck.cli.output import report, show_time_left, table

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.campaigns.league import LeagueResult


@app.command(rich_help_panel="Air hockey")
def league(
    rules: GameRules,
    players: Annotated[
        list[str] | None,
        Argument(metavar="PLAYER", help=f"{PLAYER} By default our levels and all scripted hands."),
    ] = None,
    games: Annotated[
        int, Setting("Number of games of each pair; sides alternate.", numbers.GAMES, "N")
    ] = 2,
    seed: options.Seed = 0,
    model: Annotated[str, Setting("Model of the craft.", metavar="MODEL")] = "paper:M3",
    twin: options.ReadTwin = None,
    workers: options.Workers = None,
    output: Annotated[
        Path | None,
        options.output("DIR", "Folder for results and a figure; games in it are not played again."),
    ] = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Let every player play every other, and rate them.

    Drag and bounces of the puck differ from game to game, and no player knows them exactly.
    """
    from airpuck.campaigns.league import PLAYERS

    inputs.read_player(model, quiet)
    with show_time_left("games", quiet) as progress:
        found = airpuck.league(
            players or PLAYERS,
            games,
            seed=seed,
            model=model,
            settings=twin,
            rules=rules,
            output=output,
            workers=workers,
            progress=progress,
        )
    figure = None
    if output is not None:
        from airpuck.report.league_figure import league_figure
        from airpuck.report.style import write_png

        figure = output / "league.png"
        write_png(league_figure(found), figure)
    report(found.to_json(), json_file, _ratings(found), figure)


def _ratings(found: LeagueResult) -> Table:
    """Lay out the players, strongest first."""
    sums = {name: found.total(name) for name in ("games", "wins", "goals", "duration_s")}
    rows = []
    for number in (-found.intervals[:, 0]).argsort():
        value, low, high = found.intervals[number]
        games, wins, scored, seconds = (sums[name][number].sum() for name in sums)
        lost, conceded = (sums[name][:, number].sum() for name in ("wins", "goals"))
        rows.append(
            [
                found.players[number],
                f"{value:+.0f}",
                f"{low:+.0f} to {high:+.0f}",
                *(f"{count:.0f}" for count in (wins, games - wins - lost, lost)),
                f"{scored:.0f}:{conceded:.0f}",
                f"{60 * scored / seconds:.2f}",
            ]
        )
    headings = ("player", "Elo", "95 % interval", "won", "drawn", "lost", "goals", "goals per min")
    return table(headings, rows, title=f"{len(found.games)} games")
