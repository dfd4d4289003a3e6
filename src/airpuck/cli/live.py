"""Commands that join a ROS 2 graph."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from airpuck.cli.app import app
from airpuck.cli.inputs import read_belief, read_controls, read_craft
from airpuck.cli.options import Json, Quiet, Seed, TopicsFile, TuningFile, TwinFile, VehicleFile
from airpuck.cli.output import check_destinations, is_stdout, write_json

if TYPE_CHECKING:
    from airpuck.control.reference import SetPoints
    from airpuck.recording.topics import Topics

SETPOINT = "--setpoint"
_DWELL = 3.0
PANEL = "Live, on a ROS 2 graph"

Domain = Annotated[
    int | None,
    typer.Option("--domain", metavar="N", help="DDS domain; by default $ROS_DOMAIN_ID, or 0."),
]
Interface = Annotated[
    str | None,
    typer.Option(
        "--interface",
        metavar="NAME",
        help="Network interface, such as eth0; by default nothing leaves this machine.",
    ),
]
Duration = Annotated[
    float | None,
    typer.Option("--duration", metavar="S", help=r"Length \[s]; by default until Ctrl-C."),
]


@app.command(rich_help_panel=PANEL)
def twin(
    model: Annotated[
        str, typer.Option(metavar="MODEL", help="Truth of the simulated craft.")
    ] = "paper:M3",
    settings: TwinFile = None,
    pose: Annotated[
        tuple[float, float, float],
        typer.Option(metavar="X Y YAW", help=r"Where the craft stands at first \[m, m, rad]."),
    ] = (0.0, 0.0, 0.0),
    seed: Seed = 0,
    domain: Domain = None,
    interface: Interface = None,
    topics: TopicsFile = None,
    duration: Duration = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Put a simulated table on the graph: poses out, commands in, in real time."""
    from airpuck.live.twin import serve_twin
    from airpuck.model.model_file import read_model
    from airpuck.twin.settings import read_twin_settings

    check_destinations(json=json_file)
    check_network(domain, interface)
    report = serve_twin(
        read_model(model),
        None if settings is None else read_twin_settings(settings),
        topics=topic_names(topics),
        domain=domain,
        interface=interface,
        duration=run_length(duration),
        seed=seed,
        pose=pose,
        quiet=quiet,
    )
    write_json(json_file, report.to_json())
    if not quiet and not is_stdout(json_file):
        print(
            f"{report.duration:.1f} s: {report.poses} poses sent, {report.commands} commands "
            f"received, motors stopped {report.stops} times for want of them"
        )


class _Triples(TyperCommand):
    """A command whose --setpoint takes three numbers and may be repeated; Typer knows only one."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the three numbers to one argument."""
        joined = []
        left = iter(args)
        for arg in left:
            joined.append(arg)
            if arg == SETPOINT:
                joined.append(" ".join(islice(left, 3)))
        return super().parse_args(ctx, joined)


@app.command(rich_help_panel=PANEL, cls=_Triples)
def fly(
    model: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help="What the controller believes the craft to be."),
    ] = None,
    setpoints: Annotated[
        list[str] | None,
        typer.Option(
            SETPOINT, metavar="X Y YAW", help="Where to go; repeat for several, in order."
        ),
    ] = None,
    dwell: Annotated[
        float | None,
        typer.Option(metavar="S", help=r"Time at each --setpoint \[s]; by default 3."),
    ] = None,
    setpoints_file: Annotated[
        Path | None,
        typer.Option("--setpoints", metavar="FILE", help="Set points and their times, as TOML."),
    ] = None,
    topic: Annotated[
        bool, typer.Option("--topic", help="Go where the graph's reference topic says.")
    ] = False,
    excite: Annotated[
        bool, typer.Option("--excite", help="Fly the excitation experiment instead.")
    ] = False,
    vehicle: VehicleFile = None,
    geofence: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="X Y",
            help=r"Motors idle beyond ±X, ±Y \[m]; by default beyond the table's rails.",
        ),
    ] = None,
    tuning: TuningFile = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Seed of --excite; by default 0.", min=0)
    ] = None,
    domain: Domain = None,
    interface: Interface = None,
    topics: TopicsFile = None,
    duration: Duration = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Fly a craft on the graph, real or a twin; Ctrl-C lands it."""
    from airpuck.boundary.errors import InputError
    from airpuck.compute.process import low_latency
    from airpuck.control.excitation import Excitation
    from airpuck.control.tracking import TrackingController
    from airpuck.control.tuning import default_tuning
    from airpuck.craft.table import Table
    from airpuck.craft.vehicle import default_vehicle
    from airpuck.flight.loop import Pilot
    from airpuck.live.fly import fly_live
    from airpuck.live.safety import Limits
    from airpuck.live.setpoints import (
        FollowedSetPoint,
        PlannedSetPoints,
        check_inside,
        read_setpoints,
    )
    from airpuck.model.model_file import nominal_model

    ways = [bool(setpoints), setpoints_file is not None, topic, excite]
    if sum(ways) > 1:
        raise InputError("give one of --setpoint, --setpoints, --topic, --excite", field="fly")
    if model is not None and vehicle is not None:
        raise InputError("a model has its vehicle in it; give one of the two", field="--vehicle")
    if dwell is not None and not setpoints:
        raise InputError("is the time at each --setpoint; none is given", field="--dwell")
    if seed is not None and not excite:
        raise InputError("is that of --excite; nothing else is random", field="--seed")
    if model is None and not excite:
        raise InputError("needs a model; without one only --excite can fly", field="--model")
    check_destinations(json=json_file)
    check_network(domain, interface)
    length = run_length(duration)
    craft = None if model is None else read_belief(model)
    if craft is None:
        craft = nominal_model(read_craft(vehicle) or default_vehicle())
    fence = geofence or _rails(Table().reach(craft.vehicle.radius_m))
    if not all(0 < distance < float("inf") for distance in fence):
        raise InputError("must be two finite distances above 0", field="--geofence")
    settings = read_controls(tuning) or default_tuning()
    points = _points(setpoints, dwell) if setpoints_file is None else read_setpoints(setpoints_file)
    check_inside(points, fence)
    reference = FollowedSetPoint(fence) if topic else PlannedSetPoints(points)
    low_latency()

    def pilot() -> Pilot:
        if excite:
            return Excitation(craft, tuning=settings, seed=seed or 0)
        return TrackingController(craft, reference, settings)

    report = fly_live(
        pilot,
        craft.vehicle,
        Limits(geofence=fence),
        period=settings.period_s,
        reference=reference,
        topics=topic_names(topics),
        domain=domain,
        interface=interface,
        duration=length,
        quiet=quiet,
    )
    figures = report.to_json()
    write_json(json_file, figures)
    if not quiet and not is_stdout(json_file):
        outcomes = ", ".join(f"{count} {name}" for name, count in figures["outcomes"].items())
        jitter, latency = figures["period_jitter_ms"], figures["pose_to_command_ms"]
        print(
            f"{report.duration:.1f} s, periods: {outcomes}\n"
            f"period jitter p99 {jitter['p99']:.2f} ms, pose to command p50 {latency['p50']:.2f} "
            f"ms, p99 {latency['p99']:.2f} ms, {figures['missed_deadlines']} missed deadlines"
        )


@app.command(rich_help_panel=PANEL)
def record(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="BAG", help="Folder to record to; new.")
    ],
    vehicle: VehicleFile = None,
    domain: Domain = None,
    interface: Interface = None,
    duration: Duration = None,
    json_file: Json = None,
    quiet: Quiet = False,
) -> None:
    """Record the graph's traffic as a ROS 2 bag while it runs; Ctrl-C ends it."""
    from airpuck.live.record import record

    check_destinations(output=output, json=json_file)
    craft = read_craft(vehicle)
    report = record(
        output,
        motors=() if craft is None else craft.propeller_names,
        domain=domain,
        interface=interface,
        duration=run_length(duration),
        quiet=quiet,
    )
    write_json(json_file, report.to_json())
    if not quiet and not is_stdout(json_file):
        for topic, count in report.messages.items():
            print(f"{count:8d}  {topic}")
        print(output)


def check_network(domain: int | None, interface: str | None) -> None:
    """Refuse a domain or an interface that is not there, before anything is compiled."""
    from airpuck.live.domain import domain_config, domain_id

    domain_id(domain)
    domain_config(interface)


def topic_names(topics: Path | None) -> Topics | None:
    """Read the names of topics, if a file is given."""
    if topics is None:
        return None
    from airpuck.recording.topics import read_topics

    return read_topics(topics)


def run_length(duration: float | None) -> float:
    """Return how long to go on."""
    from airpuck.boundary.errors import InputError

    if duration is not None and not 0 < duration < float("inf"):
        raise InputError("must be a number of seconds above 0", field="--duration")
    return float("inf") if duration is None else duration


def _points(texts: list[str] | None, dwell: float | None) -> SetPoints:
    """Return set points one after the other; by default the middle of the table."""
    from airpuck.boundary.errors import InputError
    from airpuck.control.reference import SetPoints

    dwell = _DWELL if dwell is None else dwell
    if not 0 < dwell < float("inf"):
        raise InputError("must be a number of seconds above 0", field="--dwell")
    try:
        poses = [tuple(map(float, text.split())) for text in texts or ["0 0 0"]]
    except ValueError:
        poses = [()]
    if any(len(pose) != 3 for pose in poses):
        raise InputError("give three numbers: x [m], y [m], yaw [rad]", field=SETPOINT)
    return SetPoints([k * dwell for k in range(len(poses))], poses)


def _rails(reach: tuple[float, float]) -> tuple[float, float]:
    """Return the geofence at the rails: noise of a craft that leans on one is inside."""
    return reach[0] + 0.01, reach[1] + 0.01
