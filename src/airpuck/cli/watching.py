"""Commands that watch a ROS 2 graph."""

from __future__ import annotations

from typing import Annotated

import typer

from airpuck.cli.app import app
from airpuck.cli.inputs import read_belief
from airpuck.cli.live import (
    PANEL,
    Domain,
    Duration,
    Interface,
    check_network,
    run_length,
    topic_names,
)
from airpuck.cli.options import Json, Quiet, TopicsFile
from airpuck.cli.output import check_destinations, is_stdout, write_json

Belief = Annotated[
    str, typer.Option("--model", metavar="MODEL", help="What the craft is believed to be.")
]


@app.command(rich_help_panel=PANEL)
def watch(
    model: Belief,
    domain: Domain = None,
    interface: Interface = None,
    topics: TopicsFile = None,
    duration: Duration = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Compare a craft in flight with its model: prediction errors, each propeller, delay."""
    from airpuck.live.watch import watch_live

    check_destinations(json=json_file)
    check_network(domain, interface)
    silent = quiet or is_stdout(json_file)
    figures = watch_live(
        read_belief(model),
        (lambda line: None) if silent else (lambda line: print(line, flush=True)),
        topics=topic_names(topics),
        domain=domain,
        interface=interface,
        duration=run_length(duration),
    )
    write_json(json_file, figures)


@app.command(rich_help_panel=PANEL)
def view(
    model: Belief,
    port: Annotated[
        int, typer.Option(metavar="N", help="Port of the page.", min=1, max=65535)
    ] = 8080,
    host: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="Who may see it; by default this machine alone."),
    ] = "127.0.0.1",
    domain: Domain = None,
    interface: Interface = None,
    topics: TopicsFile = None,
    duration: Duration = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Show the table in the browser as it is; drag the set point of `airpuck fly --topic`."""
    from airpuck.live.view import view_live

    check_destinations(json=json_file)
    check_network(domain, interface)
    figures = view_live(
        read_belief(model),
        host=host,
        port=port,
        topics=topic_names(topics),
        domain=domain,
        interface=interface,
        duration=run_length(duration),
        quiet=quiet,
    )
    write_json(json_file, figures)
