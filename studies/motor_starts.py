"""Count how often motors of real flights fail to start, and try what helps.

    AIRPUCK_DATA=... python studies/motor_starts.py real [--flights h1_blue,h2_red]
    python studies/motor_starts.py noticed [--count 10]
    python studies/motor_starts.py twin [--count 20] [--json FILE]

`real`: a start is a command that rises above idle for at least 80 ms. The share of its thrust that
a motor gives in the first 150 ms is a regression of the craft's changes of velocity, in steps of
25 ms, on those that the model expects of this motor alone. A start below 0.4 counts as failed, by
how long the motor had rested. The same for commands that rise while the motor turns tells how many
of these are errors of the regression. Silent radios are left out. Last, the share against the time
since the start, over all failed starts.

`noticed`: 15 s of random commands each, with the twin's noise and late packets, in which every
twentieth start fails. A failure counts if it lasts for 80 ms and the mean command of these is 0.3
or more; whatever is reported although the motor turned up is a false alarm.

`twin`: set points every 2 s, then a fast circle, on the twin with the packaged rates
(`paper:starts`): the usual controller, the same with `least_command = 0.08`, and both without
failures. Settling times, contacts with rails, and the distance from the circle.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from held_out import flights
from one_line import run

from airpuck import (
    Loss,
    Model,
    Preparation,
    SetPoints,
    TimedPath,
    TrackingController,
    Trajectory,
    Twin,
    Vehicle,
    find_faults,
    fly,
    identify,
    read_twin_settings,
)
from airpuck.control.tuning import default_tuning
from airpuck.deviation.packet_delays import commands_at
from airpuck.estimate.starts import FailedStart, StartMonitor
from airpuck.evaluation.hindsight import Increments
from airpuck.flight.track import Track
from airpuck.model.model_file import published_model
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import default_twin_settings

#: Commands below this rest a motor, a start is one above `HIGH` for at least `LONG` [1, 1, s].
IDLE, HIGH, LONG = 0.05, 0.15, 0.08
#: Time after a start from which its share is found, and of the steps [s].
LOOKED_AT, STEP = 0.15, 0.025
#: Weights of x, y and yaw [1/m, 1/m, 1/rad].
WEIGHTS = np.array([1.0, 1.0, 0.04])
#: Shares below this are failures.
FAILED = 0.4
#: Rests of a motor before a start [s].
RESTS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0, np.inf)


def starts_of(trajectory: Trajectory, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray, list]:
    """Return rest, share and motor of each start, shares of rises, and products over time."""
    robust, without = Loss(robust=True), Preparation(faults="exclude")
    model = identify(trajectory, "M3", vehicle=vehicle, loss=robust, preparation=without).model
    silent = [f for f in find_faults(trajectory, model) if f.cause in ("radio out", "not armed")]
    held = commands_at(trajectory, model.transport_delay if model.delay_learned else 0.0)
    design = Increments(model.dynamics, trajectory, held)
    caused, time = design.summed(design.by_motor), trajectory.time
    step, length = trajectory.steps(STEP), trajectory.steps(LOOKED_AT)

    def products(motor: int, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        knots = np.arange(first, last + 1, step)
        expected = np.diff(caused[knots, :, motor], axis=0) * WEIGHTS
        left = np.diff(design.residual[knots], axis=0) * WEIGHTS
        return (expected * (left + expected)).sum(axis=1), (expected**2).sum(axis=1)

    starts, rises, courses = [], [], []
    for motor, command in enumerate(held.T):
        rests = command < IDLE
        jumps = np.flatnonzero((np.diff(command) > HIGH - IDLE) & ~rests[:-1]) + 1
        begins = np.flatnonzero(rests[:-1] & ~rests[1:]) + 1
        for first in (*begins.tolist(), *jumps.tolist()):
            run = command[first : first + length] > IDLE
            last = first + (len(run) if run.all() else int(np.argmin(run)))
            if last >= len(time) - 2 * length or time[last] - time[first] < LONG:
                continue
            if command[first:last].max() < HIGH:
                continue
            if any(f.start - 0.1 < time[last] and f.stop + 0.1 > time[first] for f in silent):
                continue
            up, down = products(motor, first, last)
            share = up.sum() / down.sum()
            if not rests[first - 1]:
                rises.append(share)
                continue
            turned = np.flatnonzero(~rests[:first])
            rest = time[first] - time[turned[-1] + 1] if len(turned) else time[first] - time[0]
            starts.append((rest, share, motor))
            if share < FAILED and command[first : first + 2 * length].min() > IDLE:
                courses.append(products(motor, first, first + 2 * length))
    return np.array(starts), np.array(rises), courses


def real(names: list[str] | None) -> dict[str, Any]:
    """Print how many starts failed on real flights, by rest."""
    found, rises, courses = [], [], []
    for name, vehicle, trajectory in flights(names):
        starts, risen, course = starts_of(trajectory, vehicle)
        failed = int((starts[:, 1] < FAILED).sum())
        print(f"{name}: {failed} of {len(starts)} starts failed", flush=True)
        found.append(starts)
        rises.append(risen)
        courses += course
    starts, risen = np.concatenate(found), np.concatenate(rises)
    print(f"rises of turning motors: {(risen < FAILED).sum()} of {len(risen)} look like failures")
    rows = []
    for low, high in pairwise(RESTS):
        some = starts[(starts[:, 0] >= low) & (starts[:, 0] < high), 1]
        rows.append((low, len(some), int((some < FAILED).sum())))
        share = rows[-1][2] / max(len(some), 1)
        print(f"rested {low:4.2f} to {high:4.2f} s: {rows[-1][2]:3} of {len(some):4}, {share:.3f}")
    size = min(len(up) for up, _ in courses)
    up, down = (np.array([one[k][:size] for one in courses]).sum(axis=0) for k in (0, 1))
    print(f"share over time, {len(courses)} failed starts:", np.round(up / down, 2).tolist())
    return {"rests": rows, "rises": [int((risen < FAILED).sum()), len(risen)]}


@dataclass(frozen=True)
class Excited:
    """A craft without rails under random commands, some of whose starts fail."""

    #: Times and commands as sent, every 10 ms; times and poses of the cameras.
    sent: np.ndarray
    command: np.ndarray
    time: np.ndarray
    pose: np.ndarray
    #: Motor, when its command was sent, and for how long it idles; zero: it starts.
    starts: list[tuple[int, float, float]]


def excited(model: Model, seconds: float, seed: int, failing: float = 0.05) -> Excited:
    """Simulate pairs that push to and fro, each for 0.2 s; packets are late by 7 ms (normal)."""
    random, n = np.random.default_rng(seed), model.vehicle.n_propellers
    count, idle, step = round(seconds / 0.01), model.vehicle.command_min, 1 / 960
    signal = random.uniform(-1, 1, (round(seconds / 0.2) + 1, n // 2))
    shifts = random.integers(0, 20, n // 2)
    held = np.array([signal[(k + shifts) // 20, range(n // 2)] for k in range(count)])
    command = np.clip(np.stack([held, -held], axis=2).reshape(count, n), idle, 1.0)
    sent = 0.01 * np.arange(count)
    arrives = np.maximum.accumulate(sent + model.transport_delay + random.normal(0, 7e-3, count))
    followed, starts = command.copy(), []
    for motor in range(n):
        rises = np.flatnonzero((command[1:, motor] >= IDLE) & (command[:-1, motor] < IDLE)) + 1
        for k in rises:
            lasts = random.exponential(0.3) if random.random() < failing else 0.0
            starts.append((motor, float(sent[k]), float(lasts)))
            ends = np.flatnonzero(command[k:, motor] < IDLE)
            stop = k + int(min(ends[0] if len(ends) else count, round(lasts / 0.01)))
            followed[k:stop, motor] = idle
    grid = step * np.arange(round(seconds / step))
    acting = np.searchsorted(arrives, grid, side="right") - 1
    held = np.where(acting[:, None] >= 0, followed[np.maximum(acting, 0)], idle)
    start = np.concatenate([np.zeros(6), np.full(n, idle)])
    path = np.concatenate([start[None], model.simulate(start, held, step)])[:-1]
    pose = path[::4, :3] + random.normal(0, [4.5e-5, 4.5e-5, 6.5e-4], (len(path[::4]), 3))
    return Excited(sent, command, grid[::4], pose, starts)


def told(model: Model, flight: Excited) -> list[FailedStart]:
    """Let a monitor see a flight, in order of time."""
    monitor, found, next_pose = StartMonitor(model), [], 0
    for sent, command in zip(flight.sent, flight.command, strict=True):
        while next_pose < len(flight.time) and flight.time[next_pose] <= sent:
            found += monitor.pose(float(flight.time[next_pose]), flight.pose[next_pose])
            next_pose += 1
        monitor.command(float(sent), command)
    return found


def noticed(count: int) -> dict[str, Any]:
    """Print how many failed starts the monitor notices, and how soon."""
    model = published_model("M4")
    lag = model.transport_delay + float(model.dynamics.motor_time_constant)
    strengths = (0.3, 0.45, 0.6, 0.8, 1.01)
    hits, missed = np.zeros(len(strengths) - 1, int), np.zeros(len(strengths) - 1, int)
    alarms, healthy, delays = 0, 0, []
    for seed in range(count):
        flight = excited(model, 15.0, seed)
        found = told(model, flight)
        for motor, sent, lasts in flight.starts:
            k = round(sent / 0.01)
            run = flight.command[k : k + 8, motor]
            if sent > 14.8 or run.min() < IDLE:
                continue
            reported = [f for f in found if f.motor == motor and f.sent == sent]
            if not lasts:
                healthy, alarms = healthy + 1, alarms + bool(reported)
            elif lasts >= 0.08 and run.mean() >= strengths[0]:
                place = int(np.searchsorted(strengths, run.mean(), side="right")) - 1
                hits[place], missed[place] = (
                    hits[place] + bool(reported),
                    missed[place] + (not reported),
                )
                delays += [one.noticed - sent - lag for one in reported]
    print(f"false alarms: {alarms} of {healthy} starts")
    for low, yes, no in zip(strengths, hits.tolist(), missed.tolist(), strict=False):
        print(f"failed starts to {low} and more: {yes} of {yes + no} noticed")
    print(f"after {1e3 * np.median(delays):.0f} ms (median), at most {1e3 * max(delays):.0f} ms")
    return {"noticed": hits.tolist(), "missed": missed.tolist(), "false": [alarms, healthy]}


def circle(period: float = 4.0, radius: float = 0.3, duration: float = 12.0) -> TimedPath:
    """Return a fast circle during which the craft turns, too."""
    times = np.arange(0.0, duration, 0.1)
    angle = 2 * np.pi * times / period
    poses = np.stack([radius * np.cos(angle) - radius, radius * np.sin(angle), angle / 2], axis=1)
    return TimedPath(times, poses)


def twin(count: int) -> dict[str, Any]:
    """Print what failed starts do to a controlled craft, and what helps."""
    model, failing = published_model("M4"), read_twin_settings("paper:starts").without_on_board()
    usual = default_twin_settings().without_on_board()
    turning = default_tuning().model_copy(update={"least_command": 0.08})
    plant, found = build_plant(model, usual), {}
    times = 0.5 + 2.0 * np.arange(10)
    for name, settings, tuning in (
        ("no failures", usual, default_tuning()),
        ("no failures, turning", usual, turning),
        ("failures", failing, default_tuning()),
        ("failures, turning", failing, turning),
    ):
        settled, never, contacts, errors, failed, started = [], 0, 0, [], 0, 0
        for seed in range(count):
            random = np.random.default_rng(seed)
            points = random.uniform((-0.9, -0.4, -2.0), (0.9, 0.4, 2.0), (len(times), 3))
            points[0] = 0.0
            craft = Twin(model, settings, seed=seed, plant=plant)
            log = fly(TrackingController(model, SetPoints(times, points), tuning), craft, 20.4)
            moves = Track.of(craft.recording(), model.vehicle, name).results()[1:]
            settled += [one.settling_time for one in moves if one.settling_time is not None]
            never += sum(one.settling_time is None for one in moves)
            contacts += len(craft.contacts)
            failed += len(craft.craft.motors.failed_starts)
            started += int(((log.command[1:] >= IDLE) & (log.command[:-1] < IDLE)).sum())
            craft, path = Twin(model, settings, seed=seed, plant=plant), circle()
            fly(TrackingController(model, path, tuning), craft, 11.5)
            at, states = craft.truth
            wanted = np.array([path.at(float(t), 0.0).state[:2] for t in at])
            errors.append(np.hypot(*(states[:, :2] - wanted)[at > 2.0].T))
            contacts += len(craft.contacts)
        error = np.concatenate(errors)
        quantiles = np.quantile(settled, [0.5, 0.9, 0.99])
        print(
            f"{name:22} settled after {quantiles.round(3)} s, never {never}; circle rms "
            f"{1e3 * np.sqrt(np.mean(error**2)):.1f} mm, largest {1e3 * error.max():.0f}; "
            f"{contacts} contacts; {failed} failed of {started} starts (set points)",
            flush=True,
        )
        found[name] = {"settled_s": settled, "never": never, "contacts": contacts}
        found[name] |= {"circle_rms_m": [float(np.sqrt(np.mean(e**2))) for e in errors]}
        found[name] |= {"failed": failed, "starts": started}
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("real", "noticed", "twin"))
    parser.add_argument("--flights", help="parts of their names, separated by commas")
    parser.add_argument("--count", type=int, default=10, help="number of flights on the twin")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.part == "real":
        result = real(options.flights.split(",") if options.flights else None)
    else:
        result = {"noticed": noticed, "twin": twin}[options.part](options.count)
    if options.json:
        options.json.write_text(json.dumps(result))


if __name__ == "__main__":
    run(main)
