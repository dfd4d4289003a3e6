"""Commands that play air hockey."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Exit, Option

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.cli import inputs, options
from airpuck.cli.app import app
from airpuck.cli.live import on_topics, report_flight
from airpuck.cli.output import report, say
from airpuck.live.settings import LiveSettings

if TYPE_CHECKING:
    from airpuck.web.page import ArenaSettings

_Tactic = Annotated[
    str | None, Option("--tactic", metavar="FILE.py:NAME", help="Your own tactic for the craft.")
]


@app.command(rich_help_panel="Air hockey")
def play(
    graph: LiveSettings,
    level: Annotated[
        Literal["easy", "medium", "hard"],
        Option(help="Level of the craft: thrust, reaction, aim; the page can change it."),
    ] = "medium",
    port: Annotated[int, options.number("N", "Port of the page.", numbers.PORT)] = 8088,
    no_browser: Annotated[
        bool, Option("--no-browser", help="Serve the page, but do not open it.")
    ] = False,
    model: Annotated[str, options.CONTROLLERS_MODEL] = "paper:M3",
    settings: options.TwinFile = None,
    seed: options.Seed = 0,
    tactic: _Tactic = None,
    live: Annotated[
        bool, Option("--live", help="Play on a ROS 2 graph, with puck and mallet on the table.")
    ] = False,
    no_page: Annotated[bool, Option("--no-page", help="With --live: do not serve a page.")] = False,
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
) -> None:
    """Play air hockey against the craft, in the browser; Ctrl-C ends."""
    from airpuck.web.page import ArenaSettings

    if live:
        if no_page:
            shown = {"port": port, "no_browser": no_browser}
            inputs.refuse_others(play, "--no-page", shown)
        page = None if no_page else ArenaSettings(port, graph.interface, not no_browser)
        _play_live(model, settings, level, tactic, seed, on_topics(graph, mapping), page, json_file)
        return
    of_graph = {"--domain": graph.domain, "--mapping": mapping, "--no-page": no_page or None}
    for name, given in of_graph.items():
        if given is not None:
            raise InputError("is for --live, which is not given", field=name)
    from airpuck.compute.process import low_latency
    from airpuck.web.session import play_in_browser

    arena = ArenaSettings(port, graph.interface, not no_browser, graph.duration)
    craft, table = inputs.read_player(model, graph.quiet), inputs.read_twin(settings)
    low_latency()
    tell = say(graph.quiet)
    figures = play_in_browser(
        craft, arena, level=level, tactic=tactic, settings=table, seed=seed, tell=tell
    )
    left, right = figures["score"]
    report(
        figures,
        json_file,
        f"airpuck {left} : {right} you; physics behind real time at most "
        f"{figures['behind_real_time_ms']['max']:.1f} ms",
        quiet=graph.quiet,
    )
    if figures["page_server_ended"]:
        print("airpuck: the page server has ended, and the game with it", file=sys.stderr)
        raise Exit(1)


def _play_live(
    model: str,
    settings: Path | None,
    level: str,
    tactic: str | None,
    seed: int,
    on_graph: LiveSettings,
    page: ArenaSettings | None,
    json_file: Path | None,
) -> None:
    """Fly the player behind the guard, on the left half of the table, optionally with a page."""
    from airpuck.compute.process import low_latency
    from airpuck.craft.table import AirHockey
    from airpuck.hockey.all_rounder import AllRounder
    from airpuck.hockey.contestant import tactic_maker
    from airpuck.hockey.level import LEVELS
    from airpuck.hockey.player import Player
    from airpuck.live.fly import Spectator, fly_live
    from airpuck.live.safety import half_of
    from airpuck.live.score import NAMES, Score
    from airpuck.web.live_page import LivePage, live_hello
    from airpuck.web.page import invite, served

    craft = inputs.read_player(model, on_graph.quiet)
    table = inputs.read_twin(settings) or AirHockey()
    make = AllRounder if tactic is None else tactic_maker(tactic)
    low_latency()
    score = Score(table)
    spectators: list[Spectator] = [score]
    with ExitStack() as stack:
        if page is not None:
            # The flight loop never waits for a page.
            hello = live_hello(craft, table)
            pages = stack.enter_context(
                served(page.host, page.port, hello, waits=False, without=", or give --no-page")
            )
            spectators.append(LivePage(pages, score, level))
            invite(pages, page, say(on_graph.quiet))
        figures = fly_live(
            lambda: Player(craft, table, make(), level=LEVELS[level], seed=seed),
            craft.vehicle,
            half_of(table.table, craft.vehicle.radius_m, -1),
            on_graph,
            name="airpuck play",
            spectators=spectators,
        )
    left, right = figures["score"]
    said = f"{NAMES[0]} {left} : {right} {NAMES[1]}"
    report_flight(figures, json_file, on_graph.quiet, said)


@app.command(rich_help_panel="Air hockey")
def skills(
    episodes: Annotated[
        int, options.number("N", "Number of episodes per skill.", numbers.EPISODES)
    ] = 100,
    only: Annotated[
        Literal["defend", "hit", "prepare"] | None, Option(help="One skill; by default all.")
    ] = None,
    model: Annotated[str, options.CONTROLLERS_MODEL] = "paper:M3",
    settings: options.TwinFile = None,
    seed: options.Seed = 0,
    tactic: _Tactic = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Measure how well the craft defends, hits and prepares, on the twin."""
    from airpuck.hockey.skills import SKILLS
    from airpuck.hockey.skills import skills as measured

    tell = say(quiet)

    def progress(name: str, done: int, successes: int) -> None:
        if done % 20 == 0 or done == episodes:
            tell(f"{name}: {successes} of {done}")

    found = measured(
        inputs.read_player(model, quiet),
        settings=inputs.read_twin(settings),
        episodes=episodes,
        seed=seed,
        names=(only,) if only else SKILLS,
        tactic=tactic,
        progress=progress,
    )
    figures = {name: skill.to_json() for name, skill in found.items()}
    lines = []
    for name, skill in found.items():
        low, high = skill.interval_95
        share = skill.successes / skill.episodes
        lines.append(f"{name:8}{share:6.1%} of {skill.episodes} ({low:.1%} to {high:.1%})")
    report(figures, json_file, *lines)
