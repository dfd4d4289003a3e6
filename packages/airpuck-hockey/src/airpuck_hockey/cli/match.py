"""Commands for games of two players and for leagues, and the models of craft that play."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from typer import Argument

import airpuck
import airpuck_hockey
from airpuck import InputError
from airpuck.extend import (
    Setting,
    Settings,
    Without,
    about,
    command,
    console,
    numbers,
    options,
    report,
    say,
    show_time_left,
    table,
)
from airpuck_hockey.game.rules import Rules

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck import Model
    from airpuck_hockey.game.game import Game
    from airpuck_hockey.matches.match import LeagueResult, MatchResult


def read_player(name: str) -> airpuck.Model:
    """Read a model for a player; first plan its shortest times if they are unknown."""
    from airpuck.extend import minimal_times_of
    from airpuck_hockey.player.player import check_player

    model = options.read_belief(name)
    with ExitStack() as stack, about(name):
        check_player(model)

        @cache
        def progress() -> Callable[[float, float], None]:  # shown only if there is any work
            return stack.enter_context(show_time_left("planning this craft's shortest times, once"))

        times = minimal_times_of(model, lambda done, of: progress()(done, of))
    if times.margin > 0:
        say(
            f"{name}: this craft's shortest times are uncertain by {times.error['p95']:.2f} s; its "
            f"player allows {times.margin:.2f} s more for each move and tries fewer shots"
        )
    return model


#: Events shown to spectators.
_TOLD = ("serve", "goal", "own_goal", "foul", "stuck", "over")
#: Columns and rows of the picture; time between two pictures [s].
_LETTERS = (78, 20)
_REDRAWN = 0.05
#: Names all of `airpuck_hockey.game.contestant.PLAYERS`, which takes long to import.
PLAYER = (
    "airpuck, predecessor, human, keeper, striker, wall, each with :LEVEL, or FILE.py:NAME, a "
    "tactic or a hand."
)
GameRules = Annotated[Rules, Without(("foul_s", "stuck_s", "pause_s"))]


@dataclass(frozen=True)
class Pairing(Settings):
    """The two players, the craft and the table."""

    HEADING: ClassVar = ""

    left: Annotated[str, Setting(PLAYER, metavar="PLAYER")] = "airpuck"
    right: Annotated[str, Setting("The other player; same choices.", metavar="PLAYER")] = "human"
    seed: options.Seed = 0
    model: Annotated[str, Setting("Model of the craft.", metavar="MODEL")] = "paper:M3"
    twin: options.ReadTwin = None


def read_craft(model: str, players: Sequence[str]) -> Model:
    """Read the model of the craft; hands need none, so they take the default alone."""
    from airpuck_hockey.game.contestant import contestant

    if any(contestant(name).player for name in players):
        return read_player(model)
    if model != Pairing.model:
        raise InputError("has no effect: all players are hands; leave it out", field="--model")
    return options.read_belief(model)


@command("Air hockey")
def match(
    pairing: Pairing,
    rules: GameRules,
    games: Annotated[int, Setting("Number of games.", numbers.GAMES, "N")] = 1,
    workers: options.Workers = None,
    output: Annotated[
        Path | None,
        options.output("DIR", "Folder for the games, as bags; games in it are not played again."),
    ] = None,
) -> None:
    """Let two players play air hockey against each other."""
    read_craft(pairing.model, (pairing.left, pairing.right))
    with show_time_left("games") as progress:
        found = airpuck_hockey.match(
            pairing.left,
            pairing.right,
            games,
            seed=pairing.seed,
            model=pairing.model,
            settings=pairing.twin,
            rules=rules,
            output=output,
            workers=workers,
            progress=progress,
        )
    report(found.to_json(), *_lines(found, output))


@command("Air hockey")
def watch_match(
    pairing: Pairing,
    rules: GameRules,
    port: Annotated[
        int | None,
        Setting("Show the game in the browser, at this port.", numbers.PORT, "N", "--page"),
    ] = None,
) -> None:
    """Show one game of two players in real time, in the terminal or the browser."""
    from airpuck.extend import low_latency
    from airpuck_hockey.game.contestant import contestant
    from airpuck_hockey.game.game import Game
    from airpuck_hockey.matches.match import MatchResult

    names = pairing.left, pairing.right
    players = [contestant(name) for name in names]
    craft = read_craft(pairing.model, names)
    low_latency()
    game = Game(*players, settings=pairing.twin, rules=rules, model=craft, seed=pairing.seed)
    began = time.monotonic()
    if port is None:
        _watch(game)
    else:
        from airpuck_hockey.web.page import watch_in_browser
        from airpuck_hockey.web.settings import ArenaSettings

        watch_in_browser(game, craft, ArenaSettings(port), say)
    wall = time.monotonic() - began
    found = MatchResult(*names, (pairing.seed,), (game.figures(),), wall)
    report(found.to_json(), *_summary(found))


def _lines(found: MatchResult, output: Path | None) -> Iterator[str | Table | Path]:
    """Yield what `_summary` yields, the speed of computation, and the folder of the games."""
    yield from _summary(found)
    figures = found.to_json()
    yield (
        f"{figures['duration_s']:.0f} s of play in {figures['wall_s']:.0f} s of one process, "
        f"{figures['duration_s'] / figures['wall_s']:.1f} times real time"
    )
    if output is not None:
        yield output / "games"


def _summary(found: MatchResult) -> Iterator[str | Table]:
    """Yield a table of the results, and further statistics."""
    figures = found.to_json()
    rows = []
    for side, name in (("left", found.left), ("right", found.right)):
        low, high = figures[f"{side}_wins_interval"]
        rows.append(
            [
                name,
                side,
                str(figures[f"{side}_wins"]),
                f"{100 * low:.0f} to {100 * high:.0f} %",
                *(str(figures[f"{side}_{what}"]) for what in ("goals", "own_goals", "fouls")),
            ]
        )
    headings = ("player", "side", "wins", "95 % interval", "goals", "own goals", "fouls")
    games = f"{len(found.games)} games" if len(found.games) > 1 else "1 game"
    yield table(headings, rows, title=f"{games}, {figures['draws']} drawn", left=headings[:2])
    hardest = ""
    if figures["rail_contacts"]:
        hardest = f", the hardest at {figures['hardest_rail_contact_m_s']:.2f} m/s"
    yield (
        f"rail contacts of craft: {figures['rail_contacts']}{hardest}; crossings of the centre "
        f"line: {figures['crossings']}; stuck pucks: {figures['stuck']}"
    )


def _watch(game: Game) -> None:
    """Show a game in the terminal, in real time, or as fast as it can be computed."""
    from rich.live import Live

    began, drawn = time.monotonic(), 0.0
    with Live(console=console(error=True), auto_refresh=False, transient=True) as live:
        while game.phase != "over":
            for event in game.step():
                if event.kind in _TOLD:
                    side = {-1: "left", 0: "nobody", 1: "right"}[event.side]
                    left, right = game.score
                    say(
                        f"{event.time:6.1f} s  {event.kind.replace('_', ' '):8s} {side:6s}  "
                        f"{left} : {right}"
                    )
            if game.time >= drawn and live.console.is_terminal:
                drawn = game.time + _REDRAWN
                live.update(_picture(game), refresh=True)
            time.sleep(max(0.0, began + game.time - time.monotonic()))


def _picture(game: Game) -> str:
    """Draw the table from above with characters."""
    table, (columns, rows) = game.settings.table, _LETTERS
    canvas = [[" "] * columns for _ in range(rows)]

    def place(x: float, y: float) -> tuple[int, int]:
        column = round((x / table.length_m + 0.5) * (columns - 1))
        row = round((0.5 - y / table.width_m) * (rows - 1))
        return min(max(row, 0), rows - 1), min(max(column, 0), columns - 1)

    for row in range(rows):
        canvas[row][columns // 2] = "·"
    for side in game.sides:
        x, y, *_ = side.state
        reach = range(-10, 11)
        for i, j in itertools.product(reach, reach):
            if math.hypot(i, j) <= 10:
                row, column = place(x + side.radius * i / 10, y + side.radius * j / 10)
                canvas[row][column] = "L" if side.sign < 0 else "R"
    if game.puck is not None:
        row, column = place(game.puck.x, game.puck.y)
        canvas[row][column] = "o"
    edge = "+" + "-" * columns + "+"
    half = table.goal_width_m / 2
    walls = [
        ":" if abs(0.5 - row / (rows - 1)) * table.width_m < half else "|" for row in range(rows)
    ]
    lines = [f"{wall}{''.join(line)}{wall}" for wall, line in zip(walls, canvas, strict=True)]
    left, right = game.score
    names = f"{game.sides[0].name}  {left} : {right}  {game.sides[1].name}"
    return "\n".join([names.center(columns + 2), edge, *lines, edge])


@command("Air hockey")
def league(
    rules: GameRules,
    players: Annotated[
        list[str] | None,
        Argument(metavar="PLAYER", help=f"{PLAYER} By default our levels, predecessor and hands."),
    ] = None,
    games: Annotated[int, Setting("Games of each pair; sides alternate.", numbers.GAMES, "N")] = 2,
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
) -> None:
    """Let every player play every other.

    Drag and bounces of the puck differ from game to game, and no player knows them exactly.
    """
    from airpuck_hockey.matches.match import PLAYERS

    if players:
        read_craft(model, players)
    else:
        read_player(model)
    with show_time_left("games") as progress:
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
    report(found.to_json(), _standings(found))


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
