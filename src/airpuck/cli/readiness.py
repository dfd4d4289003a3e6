"""The check before flight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from airpuck.cli.app import app
from airpuck.cli.inputs import read_belief, read_craft
from airpuck.cli.live import PANEL, Domain, Interface, topic_names
from airpuck.cli.options import Json, Quiet, TopicsFile, VehicleFile
from airpuck.cli.output import check_destinations, is_stdout, write_json


@app.command(rich_help_panel=PANEL)
def preflight(
    model: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help="What the craft is believed to be."),
    ] = None,
    vehicle: VehicleFile = None,
    recording: Annotated[
        Path | None,
        typer.Option(metavar="RECORDING", help="Judge a recorded test instead of flying one."),
    ] = None,
    level: Annotated[
        float | None,
        typer.Option(help="Command of the motor whose turn it is; by default 0.25."),
    ] = None,
    rounds: Annotated[
        int | None, typer.Option(help="How often each motor has its turn; by default 2.")
    ] = None,
    domain: Domain = None,
    interface: Interface = None,
    topics: TopicsFile = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Give each motor short pulses; say what is wrong with order, signs, frame, units and delay."""
    from airpuck.boundary.errors import InputError
    from airpuck.cli.inputs import read_flight
    from airpuck.craft.vehicle import default_vehicle
    from airpuck.flight.preflight import judge_recording
    from airpuck.flight.pulses import PulsePlan
    from airpuck.model.model_file import nominal_model

    if model is not None and vehicle is not None:
        raise InputError("a model has its vehicle in it; give one of the two", field="--vehicle")
    flown = {"level": level, "rounds": rounds, "domain": domain, "interface": interface}
    given = [name for name, value in flown.items() if value is not None]
    if recording is not None and given:
        raise InputError("is for a test that is flown, not recorded", field=f"--{given[0]}")
    check_destinations(json=json_file)
    craft = None if model is None else read_belief(model)
    if craft is None:
        craft = nominal_model(read_craft(vehicle) or default_vehicle())
    if recording is not None:
        found = judge_recording(craft, read_flight(recording, topics))
    else:
        from airpuck.live.preflight import preflight_live

        plan = PulsePlan()
        found = preflight_live(
            craft,
            replace(
                plan,
                level=plan.level if level is None else level,
                rounds=plan.rounds if rounds is None else rounds,
            ),
            topics=topic_names(topics),
            domain=domain,
            interface=interface,
            quiet=quiet,
        )
    write_json(json_file, found.to_json())
    if not is_stdout(json_file):
        for check in found.checks:
            print(f"{check.verdict:6s}{check.name:17s}{check.words}")
    if not found.ready:
        wrong = [check.name for check in found.checks if check.verdict == "wrong"]
        raise InputError(f"not ready to fly: mend {', '.join(wrong)}, then check again")
