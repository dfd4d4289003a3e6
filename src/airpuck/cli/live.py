"""Commands that join a ROS 2 graph, or commission a craft there or on the twin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from typer import Argument, Option

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.settings import Setting, Settings
from airpuck.cli import options
from airpuck.cli.app import command
from airpuck.cli.output import json_on_stdout, page, report, say, show
from airpuck.cli.views import Without
from airpuck.live.settings import LiveSettings

if TYPE_CHECKING:
    from collections.abc import Callable

    from airpuck.control.law import Pilot
    from airpuck.control.tuning import Tuning
    from airpuck.craft.table import Table
    from airpuck.flight.preflight import Preflight
    from airpuck.live.fly import PlannedSetPoints
    from airpuck.model.model_file import Model
    from airpuck.planning.plan import Plan

_PANEL = "Live, on a ROS 2 graph"
#: Default time at each of several set points [s].
_DWELL = 3.0
#: Where the times of other references come from.
_TIMED = {
    "--setpoints": "times are in the file",
    "--plan": "the plan has its own times",
    "--follow": "the node that publishes the reference sets its times",
}


@dataclass(frozen=True, kw_only=True)
class Guarded(Settings):
    """Options of every flight on the graph: a tuning, and a fence that the guard enforces."""

    HEADING: ClassVar = ""

    tuning: options.TuningFile = None
    geofence: Annotated[
        tuple[float, float] | None,
        Setting(
            "Motors idle beyond ±X, ±Y; by default beyond the table's rails.",
            numbers.DISTANCE,
            "X Y",
        ),
    ] = None

    def bounds(self, craft: Model) -> tuple[tuple[float, float], Table]:
        """Return the geofence ±x, ±y [m], by default the rails, and the law's table within it."""
        from airpuck.craft.table import Table
        from airpuck.live.safety import within_rails

        radius, table = craft.vehicle.radius_m, Table()
        if self.geofence is None:
            return within_rails(table, radius), table
        x, y = (2 * (side + radius) for side in self.geofence)
        return self.geofence, table.model_copy(update={"length_m": x, "width_m": y})

    def fly(
        self, make: Callable[[], Pilot], craft: Model, controls: Tuning, live: LiveSettings
    ) -> None:
        """Fly a pilot on the graph, and report."""
        from airpuck.compute.process import low_latency
        from airpuck.control.pose_gate import longest_pause
        from airpuck.live.fly import fly_live
        from airpuck.live.safety import SafetyLimits

        low_latency()
        pause = longest_pause(craft, controls)
        limits = SafetyLimits(geofence=self.bounds(craft)[0], pose_timeout=pause)
        figures = fly_live(make, craft.vehicle, limits, live, period=controls.period_s)
        report_flight(figures)


@command(_PANEL)
def twin(
    live: LiveSettings,
    model: options.TwinModel = "paper:M3",
    settings: options.ReadTwin = None,
    pose: Annotated[
        tuple[float, float, float],
        Setting(r"Initial pose of the craft \[m, m, rad].", numbers.COORDINATE, "X Y YAW"),
    ] = (0.0, 0.0, 0.0),
    puck: Annotated[
        tuple[float, float, float, float] | None,
        Setting(r"Start of a puck: position, velocity \[m, m/s].", numbers.COORDINATE, "X Y VX VY"),
    ] = None,
    human: Annotated[
        str | None,
        Setting(
            "An opponent with a mallet on the right, by airpuck-hockey: easy, medium, hard, or "
            "page, the person at the page of `airpuck play-live`. The puck starts at the centre, "
            "or where --puck says.",
            metavar="NAME",
        ),
    ] = None,
    seed: options.Seed = 0,
) -> None:
    """Put a simulated table on the graph: poses out, commands in, in real time."""
    from airpuck.live.twin import serve_twin
    from airpuck.physics.puck import PuckState

    truth = airpuck.read_model(model)
    if human is not None and puck is None:
        puck = (0.0, 0.0, 0.0, 0.0)
    start = None if puck is None else PuckState(*puck[:2], 0.0, *puck[2:])
    figures = serve_twin(truth, live, settings, seed=seed, pose=pose, puck=start, human=human)
    report(
        figures,
        f"{figures['duration_s']:.1f} s: {figures['poses']} poses sent, {figures['commands']} "
        f"commands received, motors stopped {figures['stops']} times for lack of commands",
    )


@command(_PANEL, rare=("dwell", "estimator", "tuning", "domain", "topics"))
def fly(
    model: options.ModelName,
    *,
    setpoints: Annotated[
        list[tuple[float, float, float]] | None,
        Setting(
            "A set point; repeat for several, in order.",
            numbers.COORDINATE,
            "X Y YAW",
            "--setpoint",
        ),
    ] = None,
    dwell: Annotated[
        float | None,
        Setting("Time at each of several set points; by default 3.", numbers.DWELL, "S"),
    ] = None,
    file: Annotated[
        Path | None,
        Setting("Set points and their times, as TOML.", metavar="FILE", option="--setpoints"),
    ] = None,
    plan: Annotated[
        Path | None,
        Setting("A time-optimal plan, flown once the craft is at its start.", metavar="FILE"),
    ] = None,
    follow: Annotated[
        bool, Option("--follow", help="Follow the reference that another node publishes.")
    ] = False,
    law: options.LawName = None,
    estimator: options.Estimator = None,
    guarded: Guarded,
    live: LiveSettings,
) -> None:
    """Fly a craft on the graph, real or a twin, to set points or on a path; Ctrl-C lands it."""
    from airpuck.flight.loop import pilot_named
    from airpuck.live.fly import FollowedSetPoint
    from airpuck.planning.tracking import Departing, plan_tracker

    asked = {"--setpoint": setpoints, "--setpoints": file, "--plan": plan, "--follow": follow}
    first, *others = [name for name, value in asked.items() if value] or ["--setpoint"]
    if others:
        raise InputError(f"cannot be combined with {first}", field=others[0])
    if dwell is not None and len(setpoints or ()) < 2:
        times = _TIMED.get(first, "give more than one, or leave it out")
        raise InputError(f"applies to several --setpoint; {times}", field="--dwell")
    own = None if law is None or plan else pilot_named(law)
    craft = options.read_belief(model)
    controls = options.read_controls(guarded.tuning, None if own else law, craft)
    if own is not None and estimator is not None:
        raise InputError(f"{law} has its own estimator", field="--estimator")
    if estimator is not None:
        controls = controls.with_estimator(estimator)
    fence, rails = guarded.bounds(craft)
    if plan is not None:
        optimal = _time_optimal(plan, craft, fence)

        def make() -> Pilot:
            return Departing(plan_tracker(optimal, controls, rails), optimal)
    else:
        where = FollowedSetPoint(fence) if follow else _planned(setpoints, dwell, file, fence)
        ours = partial(airpuck.TrackingController, craft, where, controls, table=rails)
        make = partial(own, craft, where) if own else ours
    guarded.fly(make, craft, controls, live)


def _planned(
    poses: list[tuple[float, float, float]] | None,
    dwell: float | None,
    file: Path | None,
    fence: tuple[float, float],
) -> PlannedSetPoints:
    """Return set points that begin when the flight does; all are within the fence."""
    from airpuck.control.reference import SetPoints, check_inside, read_setpoints
    from airpuck.live.fly import PlannedSetPoints

    poses = poses or [(0.0, 0.0, 0.0)]
    times = [k * (dwell or _DWELL) for k in range(len(poses))]
    points = SetPoints(times, poses) if file is None else read_setpoints(file)
    check_inside(points, fence)
    return PlannedSetPoints(points)


_SCENARIO = Argument(metavar="SCENARIO", help="A scenario (TOML), or the name of a packaged one.")


@command(_PANEL)
def fly_fleet(
    scenario: Annotated[str, _SCENARIO],
    craft: Annotated[str, Setting("Craft of the scenario to fly.", metavar="NAME", option="--as")],
    live: LiveSettings,
) -> None:
    """Fly one craft of a fleet on the graph; the others are other processes. Ctrl-C lands it.

    Its name is the namespace of its topics. All craft begin together, once each is at its start.
    """
    from airpuck.compute.process import low_latency
    from airpuck.live.fleet import fly_in_fleet

    low_latency()
    report_flight(fly_in_fleet(airpuck.read_fleet(scenario), craft, live))


@command(_PANEL)
def twin_fleet(
    scenario: Annotated[str, _SCENARIO], live: LiveSettings, seed: options.Seed = 0
) -> None:
    """Put all craft of a scenario on one simulated table on the graph, in real time."""
    from airpuck.live.twin import serve_fleet

    figures = serve_fleet(airpuck.read_fleet(scenario), live, seed=seed)
    contacts = len(figures["contacts"])
    words = f"{figures['duration_s']:.1f} s: {contacts} contacts between craft"
    report(figures, words)


@command(_PANEL, rare=("tuning", "domain", "topics", "seed", "vehicle"))
def fly_excitation(
    experiment: options.Experiment,
    guarded: Guarded,
    live: Annotated[LiveSettings, Without(("duration",))],
    model: Annotated[
        str | None, Setting("Model of the craft; by default nominal.", metavar="MODEL")
    ] = None,
    vehicle: options.ReadVehicle = None,
    seed: options.Seed = 0,
) -> None:
    """Fly the excitation experiment on the graph; it needs no model."""
    from airpuck.control.excitation import Excitation

    craft = options.model_or_nominal(model, vehicle)
    controls = options.read_controls(guarded.tuning, None, craft)
    make = partial(
        Excitation,
        craft,
        tuning=controls,
        amplitude=experiment.amplitude,
        hold=experiment.hold_s,
        margin=experiment.margin_m,
        seed=seed,
    )
    make()  # before joining the graph, rejects signals that the craft cannot produce
    live = replace(live, duration=experiment.duration_s)
    guarded.fly(make, craft, controls, live)


@command(_PANEL)
def record(
    output: options.NewBag,
    live: Annotated[LiveSettings, Without(("topics",))],
    vehicle: options.ReadVehicle = None,
) -> None:
    """Record the graph's traffic as a ROS 2 bag while it runs; Ctrl-C ends it."""
    from airpuck.live.record import record

    figures = record(output, live, motors=() if vehicle is None else vehicle.columns)
    counts = [f"{count:8d}  {topic}" for topic, count in figures["messages"].items()]
    report(figures, *counts, output)


@command(_PANEL)
def preflight(
    live: Annotated[LiveSettings, Without(("duration",))],
    model: Annotated[str | None, options.BELIEVED] = None,
    vehicle: options.ReadVehicle = None,
    level: Annotated[float, Setting("Command of the tested motor.", numbers.AMPLITUDE, "U")] = 0.25,
    rounds: Annotated[int, Setting("Pulses for each motor.", numbers.PULSE_ROUNDS, "N")] = 2,
) -> None:
    """Give each motor short pulses; report errors of order, signs, frame, units and delay."""
    from airpuck.flight.pulses import PulsePlan
    from airpuck.live.fly import preflight_live

    plan = PulsePlan(level=level, rounds=rounds)
    _report_checks(preflight_live(options.model_or_nominal(model, vehicle), plan, live))


@command(_PANEL)
def preflight_recording(
    recording: options.RecordingPath,
    model: Annotated[str | None, options.BELIEVED] = None,
    vehicle: options.ReadVehicle = None,
    mapping: options.ReadMapping = None,
) -> None:
    """Evaluate a recorded test of `airpuck preflight`."""
    from airpuck.flight.preflight import judge_recording

    craft = options.model_or_nominal(model, vehicle)
    flown = options.read_recording(recording, mapping)
    _report_checks(judge_recording(craft, flown))


def _report_checks(found: Preflight) -> None:
    """Report the checks of a preflight; raise InputError if one failed."""
    checks = [f"{check.verdict:6s}{check.name:17s}{check.words}" for check in found.checks]
    report(found.to_json(), *checks)
    if not found.ready:
        wrong = [check.name for check in found.checks if check.verdict == "wrong"]
        raise InputError(f"not ready to fly: fix {', '.join(wrong)}, then check again")


@command(_PANEL)
def watch(model: options.ModelName, live: LiveSettings) -> None:
    """Compare a craft in flight with its model: prediction errors, each propeller, delay."""
    from airpuck.live.watch import watch_live

    tell = (lambda _: None) if json_on_stdout() else show
    report(watch_live(options.read_belief(model), tell, live))


@command(_PANEL)
def view(
    model: options.ModelName,
    live: LiveSettings,
    port: Annotated[int, Setting("Port of the page.", numbers.PORT, "N")] = 8080,
    host: Annotated[
        str, Setting("Address to serve on; by default this machine only.", metavar="ADDRESS")
    ] = "127.0.0.1",
) -> None:
    """Show the table in the browser, live; drag the set point of `airpuck fly --follow`."""
    from airpuck.web.view import view_live

    report(view_live(options.read_belief(model), live, host=host, port=port))


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


def report_flight(figures: dict[str, Any], *lines: str) -> None:
    """Report the results of a flight on the graph below the given lines."""
    outcomes = ", ".join(f"{count} {name}" for name, count in figures["outcomes"].items())
    jitter, latency = figures["period_jitter_ms"], figures["pose_to_command_ms"]
    report(
        figures,
        *lines,
        f"{figures['duration_s']:.1f} s, periods: {outcomes}",
        f"period jitter p99 {jitter['p99']:.2f} ms, pose to command p50 {latency['p50']:.2f} "
        f"ms, p99 {latency['p99']:.2f} ms, {figures['missed_deadlines']} missed deadlines",
    )


@command("Control and flight", rare=("domain", "interface", "topics", "seed", "table"))
def commission(
    output: Annotated[Path, options.output("DIR", "Folder of the model, recordings and page.")],
    live: Annotated[LiveSettings, Without(("duration",))],
    vehicle: options.ReadVehicle = None,
    truth: Annotated[
        str | None, Setting("Fly the twin of this true model, not the graph.", metavar="MODEL")
    ] = None,
    twin: options.ReadTwin = None,
    table: options.ReadTable = None,
    seed: options.Seed = 0,
) -> None:
    """Fly a new craft from rest to a trusted model, alone: pulses, hover, excitations, studies.

    Put the craft at rest in the middle of the table. Any key stops it.

    Status 2 if the model is not trusted; the last line then says why, and what to do.
    """
    craft = vehicle or airpuck.default_vehicle()
    if truth is None and twin is not None:
        raise InputError("needs --truth MODEL, which the twin flies", field="--twin")
    if truth is None:
        from airpuck.commissioning.commission import commission_live

        rails = None if table is None else table.table
        found = commission_live(craft, output, live, table=rails, seed=seed, tell=say)
    else:
        from airpuck.live.fly import keyboard

        if table is not None:
            raise InputError("comes with the twin's settings; leave it out", field="--table")
        from airpuck.twin.experiments import check_same_craft

        true = airpuck.read_model(truth)
        check_same_craft(craft, true.vehicle)
        link = airpuck.Twin(true, twin, seed=seed)
        with keyboard() as pressed:
            given = {"tell": say, "stopped": lambda: bool(pressed and pressed())}
            rails = link.settings.table
            found = airpuck.commission(link, craft, output, table=rails, seed=seed, **given)
    written = page(output, "commissioning_report.commissioning_report", found)
    # The last line is the first finding of a craft that is not trusted.
    report(found.to_json(), *found.sentences[0 if found.trusted else 1 :], written)
    if not found.trusted:
        raise InputError(f"not trusted: {found.findings[0].sentence.removesuffix('.')}")
