"""The command for games of two players."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.cli import inputs, options
from airpuck.cli.app import app
from airpuck.cli.output import console, is_stdout, report, say, show_time_left, table

if TYPE_CHECKING:
    from rich.table import Table

    from airpuck.campaigns.match import MatchResult
    from airpuck.hockey.game import Game
    from airpuck.hockey.rules import Rules
    from airpuck.model.model_file import Model
    from airpuck.twin.settings import TwinSettings

#: Events shown to spectators.
_TOLD = ("serve", "goal", "own_goal", "foul", "stuck", "over")
#: Columns and rows of the picture; time between two pictures [s].
_LETTERS = (78, 20)
_REDRAWN = 0.05
_PLAYER = "airpuck, human, keeper or striker, each with :LEVEL, or a tactic, FILE.py:NAME."


@app.command(rich_help_panel="Air hockey")
def match(
    left: Annotated[str, Option("--left", metavar="PLAYER", help=_PLAYER)] = "airpuck",
    right: Annotated[str, Option("--right", metavar="PLAYER", help="The same.")] = "human",
    games: Annotated[int, options.number("N", "Number of games.", numbers.GAMES)] = 1,
    seed: options.Seed = 0,
    goals: Annotated[int, options.number("N", "Goals needed to win.", numbers.GOALS)] = 7,
    limit: Annotated[
        float, options.number("S", "Time limit of a game.", numbers.FLIGHT_DURATION)
    ] = 300.0,
    model: Annotated[str, Option(metavar="MODEL", help="Model of the craft.")] = "paper:M3",
    twin: options.TwinFile = None,
    workers: Annotated[
        int | None,
        options.number("N", "Processes to start; by default one per processor.", numbers.WORKERS),
    ] = None,
    output: Annotated[
        Path | None,
        options.output(
            "DIR", "Folder for the games, as bags; existing games are not played again."
        ),
    ] = None,
    watch: Annotated[bool, Option("--watch", help="Show one game in real time.")] = False,
    page: Annotated[
        bool, Option("--page", help="With --watch: in the browser, not in the terminal.")
    ] = False,
    port: Annotated[
        int | None, options.number("N", "Port of the page; by default 8088.", numbers.PORT)
    ] = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Let two players play air hockey against each other."""
    from airpuck.campaigns.match import MatchResult
    from airpuck.hockey.rules import Rules

    if page and not watch:
        raise InputError("is for --watch, which is not given", field="--page")
    if port is not None and not page:
        raise InputError("is for --page, which is not given", field="--port")
    rules, settings = Rules(goals=goals, limit_s=limit), inputs.read_twin(twin)
    if watch:
        inputs.refuse_others(
            match, "--watch", {"games": games, "output": output, "workers": workers}
        )
        game, craft = _game(left, right, model, settings, rules, seed, quiet)
        began = time.monotonic()
        if page:
            _show_page(game, craft, port, quiet)
        else:
            _watch(game, is_stdout(json_file), quiet)
        found = MatchResult(left, right, (seed,), (game.figures(),), time.monotonic() - began)
    else:
        inputs.read_player(model, quiet)
        with show_time_left("games", quiet) as progress:
            found = airpuck.match(
                left,
                right,
                games,
                seed=seed,
                model=model,
                settings=settings,
                rules=rules,
                output=output,
                workers=workers,
                progress=lambda done, of, failed: progress(done, of),
            )
    report(found.to_json(), json_file, *_lines(found, output))


def _game(
    left: str,
    right: str,
    model: str,
    settings: TwinSettings | None,
    rules: Rules,
    seed: int,
    quiet: bool,
) -> tuple[Game, Model]:
    """Return a game between two named players with a craft model."""
    from airpuck.compute.process import low_latency
    from airpuck.hockey.contestant import contestant
    from airpuck.hockey.game import Game

    players = contestant(left), contestant(right)
    craft = inputs.read_player(model, quiet)
    low_latency()
    return Game(*players, settings=settings, rules=rules, model=craft, seed=seed), craft


def _show_page(game: Game, craft: Model, port: int | None, quiet: bool) -> None:
    """Show a game in the browser."""
    from airpuck.web.match_page import watch_in_browser
    from airpuck.web.page import ArenaSettings

    arena = ArenaSettings() if port is None else ArenaSettings(port)
    watch_in_browser(game, craft, arena, say(quiet))


def _lines(found: MatchResult, output: Path | None) -> Iterator[str | Table | Path]:
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
        f"crafts met a rail {figures['rail_contacts']} times{hardest}, and crossed the centre "
        f"line {figures['crossings']} times; the puck was stuck {figures['stuck']} times"
    )
    yield (
        f"{figures['duration_s']:.0f} s of play in {figures['wall_s']:.0f} s of one process, "
        f"{figures['duration_s'] / figures['wall_s']:.1f} times real time"
    )
    if output is not None:
        yield output / "games"


def _watch(game: Game, error: bool, quiet: bool) -> None:
    """Show a game in the terminal, in real time, or as fast as it can be computed."""
    from rich.live import Live

    began, drawn = time.monotonic(), 0.0
    with Live(console=console(error), auto_refresh=False, transient=True) as live:
        while game.phase != "over":
            for event in game.step():
                if event.kind in _TOLD and not quiet:
                    side = {-1: "left", 0: "nobody", 1: "right"}[event.side]
                    left, right = game.score
                    live.console.print(
                        f"{event.time:6.1f} s  {event.kind.replace('_', ' '):8s} {side:6s}  "
                        f"{left} : {right}"
                    )
            if game.time >= drawn and live.console.is_terminal:
                drawn = game.time + _REDRAWN
                live.update(_picture(game), refresh=True)
            time.sleep(max(0.0, began + game.time - time.monotonic()))


def _picture(game: Game) -> str:
    """Draw the table from above, in letters."""
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
