"""Replay real flights to the estimator that learns, and compare its gains with a fit's.

    OPENBLAS_NUM_THREADS=1 python studies/learning_replayed.py $AIRPUCK_DATA/experiments/2024_03*

M3 is identified from each whole flight. The estimator gets that model, or the same with all thrusts
times 1.2. Every 5 s, from 10 s on, its gains are compared with those of the fit.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import airpuck
from airpuck import SetPoint, TrackingController
from airpuck.control.tuning import tuning_for
from airpuck.estimate.estimator import Estimate
from airpuck.flight.replay import fly_through
from airpuck.model.model_file import Model
from airpuck.preprocessing.camera_clock import at_exposure
from airpuck.preprocessing.clock import seconds
from airpuck.preprocessing.pipeline import clean_streams, load_trajectory

#: When gains are compared for the first time, and how often [s].
FIRST, EVERY = 10.0, 5.0


class Flight(NamedTuple):
    """Poses with their stamps and arrivals, and commands with their times [s]."""

    stamps: np.ndarray
    arrivals: np.ndarray
    poses: np.ndarray
    times: np.ndarray
    commands: np.ndarray


def opened(folder: Path) -> tuple[Model, Flight]:
    """Read a raw recording, or else the one that its authors prepared, and identify M3."""
    raw = folder / folder.name
    if not raw.is_dir():
        prepared = load_trajectory(folder / "data.pt")
        model = airpuck.identify(prepared, "M3").model
        time, poses = np.asarray(prepared.time), np.asarray(prepared.state)[:, :3]
        sent = time - model.transport_delay
        return model, Flight(time, time, poses, sent, np.asarray(prepared.command))
    recording = airpuck.read_recording(raw)
    model = airpuck.identify(airpuck.preprocess(recording), "M3").model
    _, commands, aligned = clean_streams(recording, model.vehicle)
    pose, _ = at_exposure(recording["pose"])
    stamps = aligned.pose_time
    latency = np.median(seconds(pose.received_ns) - aligned.recorder_epoch - stamps)
    return model, Flight(stamps, stamps + latency, pose.values, commands.time, commands.values)


def learned(model: Model, flight: Flight) -> tuple[np.ndarray, np.ndarray]:
    """Return the gains found in flight, and their standard deviations."""
    tuning = tuning_for(model).with_estimator("learning")
    controller = TrackingController(model, SetPoint(0, 0, 0), tuning)
    gains, deviations, due = [], [], flight.stamps[0] + FIRST
    for time, known in zip(flight.times.tolist(), fly_through(controller, *flight), strict=True):
        if time > due and isinstance(known, Estimate):
            assert known.actuation is not None
            gains.append(known.actuation.effectiveness)
            deviations.append(known.actuation.deviation)
            due += EVERY
    return np.array(gains), np.array(deviations)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flights", type=Path, nargs="+", help="folders of flights")
    for folder in parser.parse_args().flights:
        model, flight = opened(folder)
        for factor in (1.0, 1.2):
            thrust = factor * model.parameters.thrust
            wrong = replace(model, parameters=replace(model.parameters, thrust=thrust))
            gains, deviations = learned(wrong, flight)
            off = gains - 1 / factor
            print(
                f"{folder.name}, thrusts x {factor}: error {np.sqrt(np.mean(off**2)):.3f}, "
                f"stated {np.sqrt(np.mean(deviations**2)):.3f}, "
                f"within 95 %: {np.mean(np.abs(off) < 1.96 * deviations):.3f} of {off.size}",
                flush=True,
            )


if __name__ == "__main__":
    from one_line import run

    run(main)
