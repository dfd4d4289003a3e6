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

if TYPE_CHECKING:
    from airpuck.control.reference import SetPoints
    from airpuck.craft.table import Table
    from airpuck.live.process import LiveSettings
    from airpuck.model.model_file import Model
    from airpuck.planning.plan import Plan

SETPOINT = "--setpoint"
_PANEL = "Live, on a ROS 2 graph"

Domain = Annotated[
    int | None,
    options.number("N", "DDS domain; by default $ROS_DOMAIN_ID, or 0.", numbers.DOMAIN, "--domain"),
]
Interface = Annotated[
    str | None,
    Option(
        "--interface",
        metavar="NAME",
        help="Network interface, such as eth0; by default nothing leaves this machine.",
    ),
]
Duration = Annotated[
    float | None,
    options.number("S", "Length; by default until Ctrl-C.", numbers.LIVE_DURATION, "--duration"),
]
Belief = Annotated[str, options.BELIEVED_MODEL]


@app.command(rich_help_panel=_PANEL)
def twin(
    model: Annotated[
        str, Option(metavar="MODEL", help="Truth of the simulated craft.")
    ] = "paper:M3",
    settings: options.TwinFile = None,
    pose: Annotated[
        tuple[float, float, float],
        options.number(
            "X Y YAW", r"Where the craft stands at first \[m, m, rad].", numbers.COORDINATE
        ),
    ] = (0.0, 0.0, 0.0),
    puck: Annotated[
        tuple[float, float, float, float] | None,
        options.number(
            "X Y VX VY", r"A puck, and how it moves at first \[m, m/s].", numbers.COORDINATE
        ),
    ] = None,
    human: Annotated[
        Literal["easy", "medium", "hard", "page"] | None,
        Option(
            help="A human on the right, with a mallet: a script, or who is at the page of "
            "airpuck play --live; for --puck."
        ),
    ] = None,
    seed: options.Seed = 0,
    domain: Domain = None,
    interface: Interface = None,
    mapping: options.MappingFile = None,
    duration: Duration = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Put a simulated table on the graph: poses out, commands in, in real time."""
    from airpuck.live.twin import serve_twin
    from airpuck.physics.puck import PuckState

    live = live_settings(domain, interface, mapping, duration, quiet)
    truth = airpuck.read_model(model)
    if human is not None and puck is None:
        raise InputError("is for --puck, which is not given", field="--human")
    start = None if puck is None else PuckState(*puck[:2], 0.0, *puck[2:])
    table = inputs.read_twin(settings)
    figures = serve_twin(truth, live, table, seed=seed, pose=pose, puck=start, human=human)
    report(
        figures,
        json_file,
        f"{figures['duration_s']:.1f} s: {figures['poses']} poses sent, {figures['commands']} "
        f"commands received, motors stopped {figures['stops']} times for lack of commands",
        quiet=quiet,
    )


@app.command(rich_help_panel=_PANEL, cls=repeated(setpoint=3))
def fly(
    model: Annotated[str | None, options.CONTROLLERS_MODEL] = None,
    setpoints: Annotated[
        list[str] | None,
        Option(SETPOINT, metavar="X Y YAW", help="Where to go; repeat for several, in order."),
    ] = None,
    dwell: Annotated[
        float | None,
        options.number("S", "Time at each --setpoint; by default 3 s.", numbers.DWELL),
    ] = None,
    setpoints_file: options.SetPointsFile = None,
    topic: Annotated[
        bool, Option("--topic", help="Go where the graph's reference topic says.")
    ] = False,
    excite: Annotated[
        bool, Option("--excite", help="Fly the excitation experiment instead.")
    ] = False,
    plan: Annotated[
        Path | None,
        Option(
            metavar="FILE",
            help="A time-optimal plan by airpuck plan; with --excite, one by airpuck design.",
        ),
    ] = None,
    amplitude: options.Amplitude = None,
    hold: options.Hold = None,
    pilot: options.PilotClass = None,
    vehicle: options.VehicleFile = None,
    geofence: Annotated[
        tuple[float, float] | None,
        options.number(
            "X Y",
            "Motors idle beyond ±X, ±Y; by default beyond the table's rails.",
            numbers.DISTANCE,
        ),
    ] = None,
    regulator: options.RegulatorName = None,
    tuning: options.TuningFile = None,
    seed: Annotated[
        int | None, options.number("N", "Seed of --excite; by default 0.", numbers.SEED)
    ] = None,
    domain: Domain = None,
    interface: Interface = None,
    mapping: options.MappingFile = None,
    duration: Duration = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Fly a craft on the graph, real or a twin; Ctrl-C lands it."""
    from airpuck.compute.process import low_latency
    from airpuck.control.excitation import Excitation
    from airpuck.control.reference import check_inside
    from airpuck.flight.pilot import Pilot, pilot_maker
    from airpuck.live.fly import fly_live
    from airpuck.live.safety import Limits
    from airpuck.live.setpoints import FollowedSetPoint, PlannedSetPoints
    from airpuck.planning.tracking import Departing, plan_tracker

    planned = None if excite else plan
    if sum([bool(setpoints), setpoints_file is not None, topic, excite, planned is not None]) > 1:
        words = "give one of --setpoint, --setpoints, --topic, --excite, --plan"
        raise InputError(words, field="fly")
    if dwell is not None and not setpoints:
        raise InputError("is the time at each --setpoint; none is given", field="--dwell")
    _refuse_unless_excited(excite, seed=seed, amplitude=amplitude, hold=hold)
    _refuse_a_pilot_of_another(excite, planned, pilot, regulator)
    if model is None and not excite:
        raise InputError("needs a model; without one only --excite can fly", field="--model")
    experiment = inputs.read_excitation(plan if excite else None, duration, amplitude, hold)
    if excite and plan is not None:
        duration = experiment.duration_s
    live = live_settings(domain, interface, mapping, duration, quiet)
    craft = inputs.model_or_nominal(model, vehicle)
    fence = _fence(geofence, craft)
    optimal = None if planned is None else _time_optimal(planned, craft, fence)
    controls = inputs.read_controls(tuning, regulator, craft)
    points = _set_points(setpoints, dwell, setpoints_file)
    check_inside(points, fence)
    reference = FollowedSetPoint(fence) if topic else PlannedSetPoints(points)
    make_own = None if pilot is None else pilot_maker(pilot)
    signals = {"hold": experiment.hold_s, "margin": experiment.margin_m, "seed": seed or 0}
    excitation = partial(Excitation, tuning=controls, amplitude=experiment.amplitude, **signals)
    if excite:
        excitation(craft)  # refuses numbers out of range before the graph is joined
    low_latency()

    def make_pilot() -> Pilot:
        if excite:
            return excitation(craft)
        if make_own is not None:
            return make_own(craft, reference)
        rails = _rails(geofence, craft)
        if optimal is not None:
            return Departing(plan_tracker(optimal, controls, rails), optimal)
        return airpuck.TrackingController(craft, reference, controls, table=rails)

    limits = Limits(geofence=fence)
    figures = fly_live(make_pilot, craft.vehicle, limits, live, period=controls.period_s)
    report_flight(figures, json_file, quiet)


@app.command(rich_help_panel=_PANEL)
def record(
    output: options.NewBag,
    vehicle: options.VehicleFile = None,
    domain: Domain = None,
    interface: Interface = None,
    duration: Duration = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Record the graph's traffic as a ROS 2 bag while it runs; Ctrl-C ends it."""
    from airpuck.live.record import record

    craft = inputs.read_craft(vehicle)
    motors = () if craft is None else craft.propeller_names
    live = live_settings(domain, interface, None, duration, quiet)
    figures = record(output, live, motors=motors)
    counts = [f"{count:8d}  {topic}" for topic, count in figures["messages"].items()]
    report(figures, json_file, *counts, output, quiet=quiet)


@app.command(rich_help_panel=_PANEL)
def preflight(
    model: Annotated[str | None, options.BELIEVED_MODEL] = None,
    vehicle: options.VehicleFile = None,
    recording: Annotated[
        Path | None,
        Option(metavar="RECORDING", help="Judge a recorded test instead of flying one."),
    ] = None,
    level: Annotated[
        float | None,
        options.number(
            "U", "Command of the motor whose turn it is; by default 0.25.", numbers.AMPLITUDE
        ),
    ] = None,
    rounds: Annotated[
        int | None,
        options.number("N", "How often each motor has a turn; by default 2.", numbers.PULSE_ROUNDS),
    ] = None,
    domain: Domain = None,
    interface: Interface = None,
    mapping: options.MappingFile = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Give each motor short pulses; say what is wrong with order, signs, frame, units and delay."""
    from airpuck.flight.preflight import judge_recording
    from airpuck.flight.pulses import PulsePlan
    from airpuck.live.fly import preflight_live

    craft = inputs.model_or_nominal(model, vehicle)
    pulses = {"level": level, "rounds": rounds}
    given = {k: v for k, v in pulses.items() if v is not None}
    if recording is not None:
        for name, value in {**pulses, "domain": domain, "interface": interface}.items():
            if value is not None:
                raise InputError("is for a test that is flown, not recorded", field=f"--{name}")
        found = judge_recording(craft, inputs.read_flight(recording, mapping))
    else:
        live = live_settings(domain, interface, mapping, None, quiet)
        found = preflight_live(craft, replace(PulsePlan(), **given), live)
    checks = [f"{check.verdict:6s}{check.name:17s}{check.words}" for check in found.checks]
    report(found.to_json(), json_file, *checks)
    if not found.ready:
        wrong = [check.name for check in found.checks if check.verdict == "wrong"]
        raise InputError(f"not ready to fly: mend {', '.join(wrong)}, then check again")


@app.command(rich_help_panel=_PANEL)
def watch(
    model: Belief,
    domain: Domain = None,
    interface: Interface = None,
    mapping: options.MappingFile = None,
    duration: Duration = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Compare a craft in flight with its model: prediction errors, each propeller, delay."""
    from airpuck.live.watch import watch_live

    live = live_settings(domain, interface, mapping, duration, quiet)
    silent = quiet or is_stdout(json_file)
    tell = (lambda _: None) if silent else show
    write_json(json_file, watch_live(inputs.read_belief(model), tell, live))


@app.command(rich_help_panel=_PANEL)
def view(
    model: Belief,
    port: Annotated[int, options.number("N", "Port of the page.", numbers.PORT)] = 8080,
    host: Annotated[
        str, Option(metavar="ADDRESS", help="Who may see it; by default this machine alone.")
    ] = "127.0.0.1",
    domain: Domain = None,
    interface: Interface = None,
    mapping: options.MappingFile = None,
    duration: Duration = None,
    json_file: options.Json = None,
    quiet: options.Quiet = False,
) -> None:
    """Show the table in the browser as it is; drag the set point of `airpuck fly --topic`."""
    from airpuck.web.view import view_live

    live = live_settings(domain, interface, mapping, duration, quiet)
    write_json(json_file, view_live(inputs.read_belief(model), live, host=host, port=port))


def _refuse_unless_excited(excite: bool, **given: Any) -> None:
    """Refuse options of the excitation experiment where another flight is asked for."""
    for name, value in given.items():
        if value is not None and not excite:
            raise InputError("is for --excite, which is not given", field=f"--{name}")


def _refuse_a_pilot_of_another(
    excite: bool, planned: Path | None, pilot: str | None, regulator: str | None
) -> None:
    """Refuse a pilot or a law where the flight brings its own."""
    for name, given in {"pilot": pilot, "regulator": regulator}.items():
        if excite and given is not None:
            words = "is for a flight to set points; --excite has its own"
            raise InputError(words, field=f"--{name}")
    if pilot is not None and regulator is not None:
        raise InputError("is for our controller; --pilot flies yours", field="--regulator")
    if pilot is not None and planned is not None:
        raise InputError("is for a flight to set points; --plan has its own", field="--pilot")


def _time_optimal(path: Path, craft: Model, fence: tuple[float, float]) -> Plan:
    """Read a time-optimal plan; refuse one that cannot be flown here from rest."""
    from airpuck.planning.plan import read_plan

    found = read_plan(path, craft)
    if found.states[0, 3:6].any():
        raise InputError("begins in motion; on the table it begins at rest", file=path)
    reach = abs(found.samples[1][:, :2]).max(axis=0)
    if (reach > fence).any():
        x, y = fence
        raise InputError(f"leaves the geofence, ±{x:g} m by ±{y:g} m", file=path)
    return found


def report_flight(
    figures: dict[str, Any], json_file: Path | None, quiet: bool, *lines: str
) -> None:
    """Report how a flight on the graph went; after other lines."""
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


def live_settings(
    domain: int | None,
    interface: str | None,
    mapping: Path | None,
    duration: float | None,
    quiet: bool,
) -> LiveSettings:
    """Return how to join the graph; refuse what is not there before anything is compiled."""
    from airpuck.live.process import LiveSettings
    from airpuck.recording.mapping import Topics, only_topics, read_mapping

    names = Topics() if mapping is None else only_topics(read_mapping(mapping), mapping)
    return LiveSettings(names, domain, interface, duration, quiet)


def _set_points(texts: list[str] | None, dwell: float | None, file: Path | None) -> SetPoints:
    """Return set points from a file, or one after the other; by default the table's middle."""
    from airpuck.control.reference import SetPoints, read_setpoints

    if file is not None:
        return read_setpoints(file)
    dwell = 3.0 if dwell is None else dwell
    words = "give three numbers: x [m], y [m], yaw [rad]"
    poses = inputs.rows(texts or ["0 0 0"], 3, SETPOINT, words)
    return SetPoints([k * dwell for k in range(len(poses))], poses)


def _rails(geofence: tuple[float, float] | None, craft: Model) -> Table:
    """Return the table that a predictive law stays on: within the geofence, if one is given."""
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
        # Noise of a craft that leans on a rail is inside.
        return x + 0.01, y + 0.01
    return given
