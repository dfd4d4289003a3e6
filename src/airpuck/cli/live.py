"""Commands that join a ROS 2 graph."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from typer import Option

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.cli import inputs, options
from airpuck.cli.app import app, repeated
from airpuck.cli.output import is_stdout, report, show, write_json
from airpuck.cli.views import Without
from airpuck.live.settings import LiveSettings

if TYPE_CHECKING:
    from collections.abc import Callable

    from airpuck.control.pilot import Pilot
    from airpuck.control.tuning import Tuning
    from airpuck.craft.table import Table
    from airpuck.model.model_file import Model
    from airpuck.planning.plan import Plan

SETPOINT = "--setpoint"
_PANEL = "Live, on a ROS 2 graph"

Belief = Annotated[str, options.BELIEVED_MODEL]
Geofence = Annotated[
    tuple[float, float] | None,
    options.number(
        "X Y", "Motors idle beyond ±X, ±Y; by default beyond the table's rails.", numbers.DISTANCE
    ),
]


@app.command(rich_help_panel=_PANEL)
def twin(
    live: LiveSettings,
    model: Annotated[
        str, Option(metavar="MODEL", help="Truth of the simulated craft.")
    ] = "paper:M3",
    settings: options.TwinFile = None,
    pose: Annotated[
        tuple[float, float, float],
        options.number("X Y YAW", r"Initial pose of the craft \[m, m, rad].", numbers.COORDINATE),
    ] = (0.0, 0.0, 0.0),
    puck: Annotated[
        tuple[float, float, float, float] | None,
        options.number(
            "X Y VX VY", r"A puck: its initial position and velocity \[m, m/s].", numbers.COORDINATE
        ),
    ] = None,
    human: Annotated[
        Literal["easy", "medium", "hard", "page"] | None,
        Option(
            help="A human with a mallet on the right: a script, or the person at the page of "
            "`airpuck play --live`. With a puck at the centre, unless --puck says where."
        ),
    ] = None,
    seed: options.Seed = 0,
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
) -> None:
    """Put a simulated table on the graph: poses out, commands in, in real time."""
    from airpuck.live.twin import serve_twin
    from airpuck.physics.puck import PuckState

    live = on_topics(live, mapping)
    truth = airpuck.read_model(model)
    if human is not None and puck is None:
        puck = (0.0, 0.0, 0.0, 0.0)
    start = None if puck is None else PuckState(*puck[:2], 0.0, *puck[2:])
    table = inputs.read_twin(settings)
    figures = serve_twin(truth, live, table, seed=seed, pose=pose, puck=start, human=human)
    report(
        figures,
        json_file,
        f"{figures['duration_s']:.1f} s: {figures['poses']} poses sent, {figures['commands']} "
        f"commands received, motors stopped {figures['stops']} times for lack of commands",
        quiet=live.quiet,
    )


@app.command(rich_help_panel=_PANEL, cls=repeated(setpoint=3))
def fly(
    live: LiveSettings,
    model: Annotated[str, options.CONTROLLERS_MODEL],
    setpoints: Annotated[
        list[str] | None,
        Option(SETPOINT, metavar="X Y YAW", help="A set point; repeat for several, in order."),
    ] = None,
    dwell: Annotated[float, options.number("S", "Time at each --setpoint.", numbers.DWELL)] = 3.0,
    setpoints_file: options.SetPointsFile = None,
    pilot: options.PilotClass = None,
    regulator: options.RegulatorName = None,
    tuning: options.TuningFile = None,
    geofence: Geofence = None,
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
) -> None:
    """Fly a craft on the graph, real or a twin, to set points; Ctrl-C lands it."""
    from airpuck.control.reference import SetPoints, check_inside, read_setpoints
    from airpuck.live.fly import PlannedSetPoints

    if setpoints_file is not None and setpoints:
        raise InputError("give set points or a file of them, not both", field=SETPOINT)
    if setpoints_file is not None:
        points = read_setpoints(setpoints_file)
    else:
        words = "give three numbers: x [m], y [m], yaw [rad]"
        poses = inputs.rows(setpoints or ["0 0 0"], 3, SETPOINT, words)
        points = SetPoints([k * dwell for k in range(len(poses))], poses)
    craft = inputs.read_belief(model)
    check_inside(points, _fence(geofence, craft))
    controls = inputs.read_controls(tuning, regulator, craft)
    make = _steered(craft, PlannedSetPoints(points), pilot, regulator, controls, geofence)
    _flown(make, craft, controls, geofence, on_topics(live, mapping), json_file)


@app.command("fly-topic", rich_help_panel=_PANEL)
def fly_topic(
    live: LiveSettings,
    model: Annotated[str, options.CONTROLLERS_MODEL],
    pilot: options.PilotClass = None,
    regulator: options.RegulatorName = None,
    tuning: options.TuningFile = None,
    geofence: Geofence = None,
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
) -> None:
    """Fly a craft on the graph to the pose on the graph's reference topic."""
    from airpuck.live.fly import FollowedSetPoint

    craft = inputs.read_belief(model)
    controls = inputs.read_controls(tuning, regulator, craft)
    reference = FollowedSetPoint(_fence(geofence, craft))
    make = _steered(craft, reference, pilot, regulator, controls, geofence)
    _flown(make, craft, controls, geofence, on_topics(live, mapping), json_file)


@app.command("fly-plan", rich_help_panel=_PANEL)
def fly_plan(
    plan: Annotated[Path, Option(metavar="FILE", help="A time-optimal plan by `airpuck plan`.")],
    live: LiveSettings,
    model: Annotated[str, options.CONTROLLERS_MODEL],
    regulator: options.RegulatorName = None,
    tuning: options.TuningFile = None,
    geofence: Geofence = None,
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
) -> None:
    """Fly a time-optimal plan on the graph, once the craft is at its start."""
    from airpuck.planning.tracking import Departing, plan_tracker

    craft = inputs.read_belief(model)
    optimal = _time_optimal(plan, craft, _fence(geofence, craft))
    controls, rails = inputs.read_controls(tuning, regulator, craft), _rails(geofence, craft)

    def make() -> Pilot:
        return Departing(plan_tracker(optimal, controls, rails), optimal)

    _flown(make, craft, controls, geofence, on_topics(live, mapping), json_file)


@app.command("fly-excitation", rich_help_panel=_PANEL)
def fly_excitation(
    experiment: options.Experiment,
    live: Annotated[LiveSettings, Without(("duration",))],
    model: Annotated[
        str | None,
        Option(metavar="MODEL", help="Model of the craft; by default nominal."),
    ] = None,
    vehicle: options.VehicleFile = None,
    tuning: options.TuningFile = None,
    geofence: Geofence = None,
    seed: options.Seed = 0,
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
) -> None:
    """Fly the excitation experiment on the graph; it needs no model."""
    from airpuck.control.excitation import Excitation

    craft = inputs.model_or_nominal(model, vehicle)
    controls = inputs.read_controls(tuning)
    make = partial(
        Excitation,
        craft,
        tuning=controls,
        amplitude=experiment.amplitude,
        hold=experiment.hold_s,
        margin=experiment.margin_m,
        seed=seed,
    )
    make()  # rejects signals that the craft cannot produce before the graph is joined
    live = replace(on_topics(live, mapping), duration=experiment.duration_s)
    _flown(make, craft, controls, geofence, live, json_file)


def _steered(
    craft: Model,
    reference: Any,
    pilot: str | None,
    regulator: str | None,
    controls: Tuning,
    geofence: tuple[float, float] | None,
) -> Callable[[], Pilot]:
    """Return a factory for our controller, or for a user's pilot."""
    from airpuck.flight.pilot import pilot_maker

    if pilot is None:
        rails = _rails(geofence, craft)
        return lambda: airpuck.TrackingController(craft, reference, controls, table=rails)
    if regulator is not None:
        raise InputError(
            "chooses a law of our controller; --pilot flies your own", field="--regulator"
        )
    return partial(pilot_maker(pilot), craft, reference)


def _flown(
    make: Callable[[], Pilot],
    craft: Model,
    controls: Tuning,
    geofence: tuple[float, float] | None,
    live: LiveSettings,
    json_file: Path | None,
) -> None:
    """Fly a pilot on the graph, and report the results."""
    from airpuck.compute.process import low_latency
    from airpuck.live.fly import fly_live
    from airpuck.live.safety import SafetyLimits

    low_latency()
    limits = SafetyLimits(geofence=_fence(geofence, craft))
    figures = fly_live(make, craft.vehicle, limits, live, period=controls.period_s)
    report_flight(figures, json_file, live.quiet)


@app.command(rich_help_panel=_PANEL)
def record(
    output: options.NewBag,
    live: LiveSettings,
    vehicle: options.VehicleFile = None,
    json_file: options.Json = None,
) -> None:
    """Record the graph's traffic as a ROS 2 bag while it runs; Ctrl-C ends it."""
    from airpuck.live.record import record

    craft = inputs.read_craft(vehicle)
    motors = () if craft is None else craft.propeller_names
    figures = record(output, live, motors=motors)
    counts = [f"{count:8d}  {topic}" for topic, count in figures["messages"].items()]
    report(figures, json_file, *counts, output, quiet=live.quiet)


@app.command(rich_help_panel=_PANEL)
def preflight(
    live: Annotated[LiveSettings, Without(("duration",))],
    model: Annotated[str | None, options.BELIEVED_MODEL] = None,
    vehicle: options.VehicleFile = None,
    recording: Annotated[
        Path | None,
        Option(metavar="RECORDING", help="Evaluate a recorded test instead of flying one."),
    ] = None,
    level: Annotated[
        float, options.number("U", "Command of the motor under test.", numbers.AMPLITUDE)
    ] = 0.25,
    rounds: Annotated[int, options.number("N", "Pulses of each motor.", numbers.PULSE_ROUNDS)] = 2,
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
) -> None:
    """Give each motor short pulses; say what is wrong with order, signs, frame, units and delay."""
    from airpuck.flight.preflight import judge_recording
    from airpuck.flight.pulses import PulsePlan
    from airpuck.live.fly import preflight_live

    craft = inputs.model_or_nominal(model, vehicle)
    flown = {"level": (level, 0.25), "rounds": (rounds, 2), "domain": (live.domain, None),
             "interface": (live.interface, None)}  # fmt: skip
    if recording is not None:
        for name, (given, usual) in flown.items():
            if given != usual:
                raise InputError(
                    "applies to a flown test, not to a recorded one", field=f"--{name}"
                )
        found = judge_recording(craft, inputs.read_flight(recording, mapping))
    else:
        plan = PulsePlan(level=level, rounds=rounds)
        found = preflight_live(craft, plan, on_topics(live, mapping))
    checks = [f"{check.verdict:6s}{check.name:17s}{check.words}" for check in found.checks]
    report(found.to_json(), json_file, *checks)
    if not found.ready:
        wrong = [check.name for check in found.checks if check.verdict == "wrong"]
        raise InputError(f"not ready to fly: fix {', '.join(wrong)}, then check again")


@app.command(rich_help_panel=_PANEL)
def watch(
    model: Belief,
    live: LiveSettings,
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
) -> None:
    """Compare a craft in flight with its model: prediction errors, each propeller, delay."""
    from airpuck.live.watch import watch_live

    silent = live.quiet or is_stdout(json_file)
    tell = (lambda _: None) if silent else show
    found = watch_live(inputs.read_belief(model), tell, on_topics(live, mapping))
    write_json(json_file, found)


@app.command(rich_help_panel=_PANEL)
def view(
    model: Belief,
    live: LiveSettings,
    port: Annotated[int, options.number("N", "Port of the page.", numbers.PORT)] = 8080,
    host: Annotated[
        str, Option(metavar="ADDRESS", help="Address to serve on; by default this machine only.")
    ] = "127.0.0.1",
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
) -> None:
    """Show the table in the browser, live; drag the set point of `airpuck fly-topic`."""
    from airpuck.web.view import view_live

    belief = inputs.read_belief(model)
    write_json(json_file, view_live(belief, on_topics(live, mapping), host=host, port=port))


def on_topics(live: LiveSettings, mapping: Path | None) -> LiveSettings:
    """Return settings with the topics of a mapping file, if there is one."""
    from airpuck.recording.mapping import only_topics, read_mapping

    if mapping is None:
        return live
    return replace(live, topics=only_topics(read_mapping(mapping), mapping))


def _time_optimal(path: Path, craft: Model, fence: tuple[float, float]) -> Plan:
    """Read a time-optimal plan; raise InputError if it cannot be flown here from rest."""
    from airpuck.planning.plan import read_plan

    found = read_plan(path, craft)
    if found.states[0, 3:6].any():
        raise InputError("begins in motion; flights on the table begin at rest", file=path)
    reach = abs(found.samples[1][:, :2]).max(axis=0)
    if (reach > fence).any():
        x, y = fence
        raise InputError(f"leaves the geofence, ±{x:g} m by ±{y:g} m", file=path)
    return found


def report_flight(
    figures: dict[str, Any], json_file: Path | None, quiet: bool, *lines: str
) -> None:
    """Report the results of a flight on the graph below the given lines."""
    outcomes = ", ".join(f"{count} {name}" for name, count in figures["outcomes"].items())
    jitter, latency = figures["period_jitter_ms"], figures["pose_to_command_ms"]
    report(
        figures,
        json_file,
        *lines,
        f"{figures['duration_s']:.1f} s, periods: {outcomes}",
        f"period jitter p99 {jitter['p99']:.2f} ms, pose to command p50 {latency['p50']:.2f} "
        f"ms, p99 {latency['p99']:.2f} ms, {figures['missed_deadlines']} missed deadlines",
        quiet=quiet,
    )


def _rails(geofence: tuple[float, float] | None, craft: Model) -> Table:
    """Return the table that a predictive law stays on, limited by the geofence if given."""
    from airpuck.craft.table import Table

    if geofence is None:
        return Table()
    x, y = (2 * (side + craft.vehicle.radius_m) for side in geofence)
    return Table().model_copy(update={"length_m": x, "width_m": y})


def _fence(given: tuple[float, float] | None, craft: Model) -> tuple[float, float]:
    """Return the geofence ±x, ±y [m]; by default the rails."""
    from airpuck.craft.table import Table

    if given is None:
        x, y = Table().reach(craft.vehicle.radius_m)
        # Allow for the noise of a craft that leans on a rail.
        return x + 0.01, y + 0.01
    return given
