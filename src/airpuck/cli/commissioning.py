"""The command from the box to a trusted flight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Setting
from airpuck.cli import options
from airpuck.cli.app import command
from airpuck.cli.output import page, report, say
from airpuck.cli.views import Without
from airpuck.live.settings import LiveSettings


@command("Control and flight", rare=("domain", "interface", "topics", "seed", "table"))
def commission(
    output: Annotated[Path, options.output("DIR", "Folder of the model, recordings and page.")],
    live: Annotated[LiveSettings, Without(("duration",))],
    vehicle: options.ReadVehicle = None,
    truth: Annotated[
        str | None,
        Setting("Fly the twin of this true model, not the graph.", metavar="MODEL"),
    ] = None,
    twin: options.ReadTwin = None,
    table: options.ReadTable = None,
    seed: options.Seed = 0,
    json_file: options.Json = None,
) -> None:
    """Fly a new craft from rest to a trusted model, alone: pulses, hover, excitations, studies.

    Put the craft at rest in the middle of the table. Any key stops it. Status 2 if the model is not
    trusted; the last line then says why, and what to do.
    """
    craft = vehicle or airpuck.default_vehicle()
    if truth is None and twin is not None:
        raise InputError("needs --truth MODEL, which the twin flies", field="--twin")
    tell = say(live.quiet)
    if truth is None:
        from airpuck.commissioning.on_graph import commission_live

        rails = None if table is None else table.table
        found = commission_live(craft, output, live, table=rails, seed=seed, tell=tell)
    else:
        from airpuck.live.fly import keyboard

        if table is not None:
            raise InputError("comes with the twin's settings; leave it out", field="--table")
        from airpuck.twin.experiments import check_same_craft

        true = airpuck.read_model(truth)
        check_same_craft(craft, true.vehicle)
        link = airpuck.Twin(true, twin, seed=seed)
        with keyboard() as pressed:
            given = {"tell": tell, "stopped": lambda: bool(pressed and pressed())}
            rails = link.settings.table
            found = airpuck.commission(link, craft, output, table=rails, seed=seed, **given)
    written = page(output, "commissioning_report.commissioning_report", found)
    report(found.to_json(), json_file, *found.sentences, written, quiet=live.quiet)
    if not found.trusted:
        raise InputError(f"not trusted: {found.findings[0].sentence.removesuffix('.')}")
