"""Does the search find the faults given to the twin? Flights with random faults, and healthy ones.

    python studies/faults_found.py --flights 40

Every flight is identified (M3) as a user would do it, and searched with that fit; the search uses
no truth. A fault is *visible* if some motor's thrust differs by a tenth of a newton from its
command for at least 50 ms. A radio outage while the command does not change has no visible effect.
Prints by kind the share of faults found (by a span with the right cause that overlaps), the share
of their time, and the share of spans that were no fault (precision).
"""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from recovery import truth

from airpuck import Loss, Span, find_faults, identify, preprocess
from airpuck.compute.process import usable_cores
from airpuck.control.excitation import Excitation
from airpuck.data.sampling import hold, runs
from airpuck.flight.loop import fly
from airpuck.model.model_file import nominal_model
from airpuck.physics.motor import motor_speeds
from airpuck.physics.thrust import thrust
from airpuck.recording.stream import Recording
from airpuck.twin.sensors import EPOCH_NS
from airpuck.twin.settings import Stall, TwinSettings, default_twin_settings
from airpuck.twin.twin import Twin

KINDS = ("stalled", "radio out", "frozen pose", "stalled", "radio out", "jumping pose")
DURATIONS = (0.15, 0.2, 0.3, 0.5, 1.0)
#: Thrust error, and its duration, from which a fault is visible [N, s].
SHOWS, FOR = 0.1, 0.05
#: Time between faults, and around a camera fault in which others may be reported [s].
APART, AROUND = 3.0, 0.05


@dataclass(frozen=True)
class Injected:
    """A fault that was given to the twin, on the time axis of its flight.

    Attributes
    ----------
    cause : str
        As `find_faults` and `preprocess` name it.
    start, stop : float
        When [s].
    """

    cause: str
    start: float
    stop: float


def drawn(duration: float, names: Sequence[str], rng: np.random.Generator) -> list[Injected]:
    """Draw faults of all kinds: one at the start, the others a few seconds apart."""
    faults = [Injected("not armed", 0.0, float(rng.uniform(0.5, 2.0)))]
    for number, earliest in enumerate(np.arange(5.0, duration - 2.0, APART).tolist()):
        kind = KINDS[number % len(KINDS)]
        cause = f"{rng.choice(list(names))} stalled" if kind == "stalled" else kind
        start = earliest + float(rng.uniform())
        faults.append(Injected(cause, start, start + float(rng.choice(DURATIONS))))
    return faults


def settings_with(faults: Sequence[Injected]) -> TwinSettings:
    """Return the packaged settings with faults of motors and radio."""
    base = default_twin_settings()
    unarmed = max((f.stop for f in faults if f.cause == "not armed"), default=0.0)
    outages = tuple((f.start, f.stop) for f in faults if f.cause == "radio out")
    stalls = tuple(
        Stall(motor=f.cause.removesuffix(" stalled"), start_s=f.start, stop_s=f.stop)
        for f in faults
        if f.cause.endswith(" stalled")
    )
    return base.model_copy(
        update={
            "radio": base.radio.model_copy(update={"outages_s": outages}),
            "motors": base.motors.model_copy(update={"unarmed_s": unarmed, "stalls": stalls}),
        }
    )


def with_bad_poses(
    recording: Recording, faults: Sequence[Injected], rng: np.random.Generator
) -> Recording:
    """Freeze poses, and make them jump by some centimetres and back."""
    pose = recording["pose"]
    time = (pose.stamp_ns - EPOCH_NS) / 1e9
    values = pose.values.copy()
    for fault in faults:
        inside = np.flatnonzero((time >= fault.start) & (time <= fault.stop))
        if fault.cause == "frozen pose":
            values[inside] = values[inside[0]]
        elif fault.cause == "jumping pose":
            values[inside] += rng.choice([-1, 1], 3) * [0.02, 0.01, 0.1]
    streams = {**recording.streams, "pose": replace(pose, values=values)}
    return replace(recording, streams=streams)


def shows(twin: Twin, told: np.ndarray) -> np.ndarray:
    """Return the frames of the twin at which a motor's thrust differs from its command."""
    time, states = twin.truth
    curves = np.asarray(twin.model.parameters.thrust)
    expected = motor_speeds(time, told, float(twin.model.parameters.motor_time_constant))
    missing = np.abs(thrust(curves, states[:, 6:].T) - thrust(curves, expected.T)) > SHOWS
    marked = np.zeros(len(time), dtype=bool)
    for motor in missing:
        for first, last in runs(motor):
            marked[first:last] |= time[last - 1] - time[first] >= FOR
    return marked


@dataclass(frozen=True)
class Outcome:
    """Result of one flight.

    Attributes
    ----------
    faults : tuple of (Injected, bool, bool, float)
        For each fault: whether it is visible, whether it was found, the marked share of its time.
    told : int
        Spans reported for motors and radio.
    wrong : int
        Reported spans that overlap no fault and no contact with a rail.
    lost : float
        Share of the windows of a fit that the reported spans remove [-].
    """

    faults: tuple[tuple[Injected, bool, bool, float], ...]
    told: int
    wrong: int
    lost: float


def flown(seed: int, duration: float, healthy: bool) -> Outcome:
    """Fly, identify, search; compare with the injected faults."""
    rng = np.random.default_rng([seed, 5])
    model = truth()
    faults = [] if healthy else drawn(duration, model.vehicle.propeller_names, rng)
    settings = settings_with(faults)
    twin = Twin(model, settings, seed=seed)
    pilot = Excitation(nominal_model(model.vehicle), seed=seed, table=settings.table)
    fly(pilot, twin, duration, pilot.controller.tuning.period_s)
    recording = with_bad_poses(twin.recording(), faults, rng)
    trajectory = preprocess(recording)
    begin = (recording["command"].stamp_ns[0] - EPOCH_NS) / 1e9 - trajectory.command_time[0]
    told = find_faults(trajectory, identify(trajectory, "M3", loss=Loss(robust=True)).model)
    spans = [replace(s, start=s.start + begin, stop=s.stop + begin) for s in told]
    measured = [replace(s, start=s.start + begin, stop=s.stop + begin) for s in trajectory.excluded]
    held = hold(
        trajectory.command_time + trajectory.delay + begin, trajectory.command, twin.truth[0]
    )
    visible = shows(twin, held)
    faults += [Injected("contact", time, time) for time in twin.contacts]
    windows = len(trajectory.window_starts(90, 7))
    left = replace(trajectory, excluded=(*trajectory.excluded, *told)).window_starts(90, 7)
    return Outcome(
        tuple(judged(fault, twin.truth[0], visible, [*spans, *measured]) for fault in faults),
        told=len(spans),
        wrong=sum(not any(overlap(s, f) for f in faults) for s in spans),
        lost=1 - len(left) / windows,
    )


def overlap(span: Span, fault: Injected) -> bool:
    """Return whether a span and a fault overlap."""
    return span.start <= fault.stop + AROUND and span.stop >= fault.start - AROUND


def judged(
    fault: Injected, time: np.ndarray, visible: np.ndarray, spans: Sequence[Span]
) -> tuple[Injected, bool, bool, float]:
    """Return whether a fault is visible, whether it was found, and the marked share of its time."""
    during = (time >= fault.start) & (time <= fault.stop)
    if fault.cause == "radio out" or "stalled" in fault.cause or fault.cause == "not armed":
        during &= visible
    found = any(overlap(span, fault) and span.cause == fault.cause for span in spans)
    inside = [during & (time >= span.start) & (time <= span.stop) for span in spans]
    marked = np.logical_or.reduce(inside).sum() if inside else 0
    return (
        fault,
        bool(during.any()) or fault.cause == "contact",
        found,
        marked / max(during.sum(), 1),
    )


def report(outcomes: Sequence[Outcome], healthy: Sequence[Outcome]) -> None:
    """Print recall by kind, precision, and the windows lost in healthy flights."""
    everything = [fault for outcome in outcomes for fault in outcome.faults]
    kinds: dict[str, list[tuple[Injected, bool, bool, float]]] = {}
    for entry in everything:
        kinds.setdefault("stalled" if "stalled" in entry[0].cause else entry[0].cause, []).append(
            entry
        )
    for kind, entries in kinds.items():
        seen = [entry for entry in entries if entry[1]]
        print(
            f"{kind:14s} {len(entries):4d} injected, {len(seen):4d} visible: "
            f"found {share(seen, 2)}, {share(seen, 3)} of their time; of all {share(entries, 2)}"
        )
    told, wrong = (sum(getattr(o, name) for o in outcomes) for name in ("told", "wrong"))
    print(f"{told} spans of motors and radio reported, {wrong} of them without a fault")
    lost = 100 * np.array([outcome.lost for outcome in healthy])
    print(
        f"{len(healthy)} healthy flights lose {lost.mean():.2f} % of their windows on average, "
        f"at most {lost.max():.2f} %; {sum(o.told for o in healthy)} spans reported"
    )


def share(entries: Sequence[tuple[Injected, bool, bool, float]], column: int) -> str:
    """Format a mean as a percentage."""
    return f"{100 * np.mean([entry[column] for entry in entries]):5.1f} %" if entries else "    -"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--duration", type=float, default=60.0)
    options = parser.parse_args()
    # JAX has threads, which do not survive a fork.
    context = multiprocessing.get_context("spawn")
    with context.Pool(usable_cores()) as pool:
        found = [
            list(
                pool.imap(
                    partial(flown, duration=options.duration, healthy=healthy),
                    range(options.flights),
                )
            )
            for healthy in (False, True)
        ]
    report(*found)


if __name__ == "__main__":
    from one_line import run

    run(main)
