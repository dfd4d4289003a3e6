"""Commands that play air hockey."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from typer import Exit

from airpuck import InputError
from airpuck.extend import (
    LiveSettings,
    Setting,
    Settings,
    Without,
    command,
    numbers,
    options,
    report,
    report_flight,
    say,
)
from airpuck_hockey.cli.match import read_player
from airpuck_hockey.web.settings import ArenaSettings


@dataclass(frozen=True)
class PlayingCraft(Settings):
    """The craft that plays."""

    HEADING: ClassVar = ""

    level: Annotated[
        Literal["easy", "medium", "hard"],
        Setting("Level of the craft: thrust, reaction, aim; the page can change it."),
    ] = "medium"
    model: options.ControllersModel = "paper:M3"
    twin: options.ReadTwin = None
    seed: options.Seed = 0
    tactic: Annotated[str | None, Setting("A tactic of your own.", metavar="FILE.py:NAME")] = None


@command("Air hockey")
def play(
    craft: PlayingCraft,
    arena: ArenaSettings,
    record: Annotated[
        Path | None,
        options.output("DIR", "Record every game as a bag, and say so on the page.", "--record"),
    ] = None,
) -> None:
    """Play air hockey against the craft, in the browser; Ctrl-C ends the game."""
    from airpuck_hockey.web.page import play_in_browser

    figures = play_in_browser(
        read_player(craft.model),
        arena,
        level=craft.level,
        tactic=craft.tactic,
        settings=craft.twin,
        seed=craft.seed,
        record=record,
        tell=say,
    )
    left, right = figures["score"]
    report(
        figures,
        f"airpuck {left} : {right} you; physics behind real time at most "
        f"{figures['behind_real_time_ms']['max']:.1f} ms",
    )
    if figures["page_server_ended"]:
        print("airpuck: the page server has ended, and the game with it", file=sys.stderr)
        raise Exit(1)


@command("Air hockey", rare=("domain", "topics", "seed"))
def play_live(
    craft: Annotated[PlayingCraft, Without(("model",))],
    live: LiveSettings,
    model: options.ModelName = "paper:M3",
    port: Annotated[
        int, Setting("Port of the page; with 0 there is no page.", numbers.PAGE_PORT, "N")
    ] = 8088,
    browser: Annotated[
        bool, Setting("Whether to open the page in a browser.", option="--browser/--no-browser")
    ] = True,
) -> None:
    """Play on a ROS 2 graph: fly the craft, on the left half, against the mallet on the table."""
    from airpuck import AirHockey
    from airpuck.extend import Spectator, fly_live, half_of, invite, low_latency, served
    from airpuck_hockey.game.contestant import tactic_maker
    from airpuck_hockey.game.scorekeeper import NAMES, Score
    from airpuck_hockey.player.all_rounder import AllRounder
    from airpuck_hockey.player.player import LEVELS, Player
    from airpuck_hockey.web.live_page import LivePage, live_hello
    from airpuck_hockey.web.page import GAME_PAGE

    if not (port or browser):
        raise InputError("has no effect with --port 0; leave it out", field="--no-browser")
    believed = read_player(model)
    table = craft.twin or AirHockey()
    make = AllRounder if craft.tactic is None else tactic_maker(craft.tactic)
    score = Score(table)
    spectators: list[Spectator] = [score]
    with ExitStack() as stack:
        if port:
            page = ArenaSettings(port, live.interface, browser)
            # The flight loop never waits for a page.
            hello = live_hello(believed, table)
            pages = stack.enter_context(
                served(
                    page.host, port, hello, page=GAME_PAGE, waits=False, without=", or use --port 0"
                )
            )
            spectators.append(LivePage(pages, score, craft.level))
            invite(pages, page.browser, say)
        low_latency()
        figures = fly_live(
            lambda: Player(believed, table, make(), level=LEVELS[craft.level], seed=craft.seed),
            believed.vehicle,
            half_of(table.table, believed.vehicle.radius_m, -1),
            live,
            name="airpuck play",
            spectators=spectators,
        )
    left, right = figures["score"]
    said = f"{NAMES[0]} {left} : {right} {NAMES[1]}"
    report_flight(figures, said)


@command("Air hockey")
def skills(
    craft: Annotated[PlayingCraft, Without(("level",))],
    episodes: Annotated[int, Setting("Number of episodes per skill.", numbers.EPISODES, "N")] = 100,
    only: Annotated[
        Literal["defend", "hit", "prepare"] | None, Setting("One skill; by default all.")
    ] = None,
) -> None:
    """Measure how well the craft defends, hits and prepares, on the twin."""
    from airpuck_hockey.game.skills import SKILLS
    from airpuck_hockey.game.skills import skills as measured

    def progress(name: str, done: int, successes: int) -> None:
        if done % 20 == 0 or done == episodes:
            say(f"{name}: {successes} of {done}")

    found = measured(
        read_player(craft.model),
        settings=craft.twin,
        episodes=episodes,
        seed=craft.seed,
        names=(only,) if only else SKILLS,
        tactic=craft.tactic,
        progress=progress,
    )
    figures = {name: skill.to_json() for name, skill in found.items()}
    lines = []
    for name, skill in found.items():
        low, high = skill.interval_95
        share = skill.successes / skill.episodes
        lines.append(f"{name:8}{share:6.1%} of {skill.episodes} ({low:.1%} to {high:.1%})")
    report(figures, *lines)
