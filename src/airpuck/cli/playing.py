"""Commands that play air hockey."""

from __future__ import annotations

from typing import Annotated, Literal

from typer import Option

from airpuck.boundary import numbers
from airpuck.cli import inputs, options
from airpuck.cli.app import app
from airpuck.cli.output import report, say


@app.command(rich_help_panel="Air hockey")
def play(
    level: Annotated[
        Literal["easy", "medium", "hard"],
        Option(help="Of the craft: thrust, reaction, aim; the page can change it."),
    ] = "medium",
    port: Annotated[int, options.number("N", "Port of the page.", numbers.PORT)] = 8088,
    no_browser: Annotated[
        bool, Option("--no-browser", help="Serve the page, but do not open it.")
    ] = False,
    interface: Annotated[
        str | None,
        Option(
            metavar="NAME",
            help="Network interface, such as wlan0, for a phone; by default this machine alone.",
        ),
    ] = None,
    model: Annotated[str, options.CONTROLLERS_MODEL] = "paper:M3",
    settings: options.TwinFile = None,
    seed: options.Seed = 0,
    duration: Annotated[
        float | None,
        options.number(
            "S", "How long to serve; by default until Ctrl-C.", numbers.LIVE_DURATION, "--duration"
        ),
    ] = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Play air hockey against the craft, in the browser; Ctrl-C ends."""
    from airpuck.arena.session import ArenaSettings, play_in_browser
    from airpuck.compute.process import low_latency

    arena = ArenaSettings(port, interface, not no_browser, duration)
    craft, table = inputs.read_belief(model), inputs.read_twin(settings)
    low_latency()
    figures = play_in_browser(craft, arena, level=level, settings=table, seed=seed, tell=say(quiet))
    left, right = figures["score"]
    report(
        figures,
        json_file,
        f"airpuck {left} : {right} you; physics behind real time at most "
        f"{figures['behind_real_time_ms']['max']:.1f} ms",
        quiet=quiet,
    )


@app.command(rich_help_panel="Air hockey")
def skills(
    episodes: Annotated[
        int, options.number("N", "Episodes of each skill.", numbers.EPISODES)
    ] = 100,
    only: Annotated[
        Literal["defend", "hit", "prepare"] | None, Option(help="One skill; by default all.")
    ] = None,
    model: Annotated[str, options.CONTROLLERS_MODEL] = "paper:M3",
    settings: options.TwinFile = None,
    seed: options.Seed = 0,
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
        inputs.read_belief(model),
        settings=inputs.read_twin(settings),
        episodes=episodes,
        seed=seed,
        names=(only,) if only else SKILLS,
        progress=progress,
    )
    figures = {name: skill.to_json() for name, skill in found.items()}
    lines = []
    for name, skill in found.items():
        low, high = skill.interval_95
        share = skill.successes / skill.episodes
        lines.append(f"{name:8}{share:6.1%} of {skill.episodes} ({low:.1%} to {high:.1%})")
    report(figures, json_file, *lines)
