"""Only the agreement of a fleet, for many crossings: craft that follow their paths exactly.

    OPENBLAS_NUM_THREADS=1 python studies/fleet_paths.py --flights 1000 --models fleet_models

The draws, messages and searches of `fleet.py`, without the twin and its controllers: a fifth of the
time. Prints when all paths have ended at the goals, and by how much the paths were farther apart
than both craft's rooms. `fleet.py` makes the folder of models beside its file.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from airpuck.control.law import Step
from airpuck.fleet.flight import _Air
from airpuck.fleet.pilot import FleetPilot, Sighting
from airpuck.fleet.scenario import Fleet
from fleet import crossing, prepare

PERIOD, NEAR = 0.01, 1e-6


class Nothing:
    """In the place of a controller."""

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def step(self, time: float) -> Step:
        """Return no command."""
        return Step(np.zeros(1))


def agreed(fleet: Fleet, seed: int) -> tuple[float, float]:
    """Return when all have arrived [s], and the least distance beyond both rooms [m]."""
    air = _Air(fleet.scenario.network, fleet.names, seed)
    with mock.patch("airpuck.fleet.pilot.TrackingController", Nothing):
        pilots = [
            FleetPilot(fleet, name, air.tell, seed=1000 * seed + k)
            for k, name in enumerate(fleet.names)
        ]
    rooms = np.array([one.reach.room for one in fleet.members])
    pairs, least = np.triu_indices(len(rooms), 1), math.inf
    for time in np.arange(0, fleet.scenario.duration_s, PERIOD):
        motions = [one.reference.path.moved(np.array([time])) for one in pilots]
        places = np.array([one.pose[0, :2] for one in motions])
        apart = np.hypot(*(places[pairs[0]] - places[pairs[1]]).T)
        least = min(least, float((apart - rooms[pairs[0]] - rooms[pairs[1]]).min()))
        seen = {
            name: Sighting(time, one.pose[0], one.rate[0, :2])
            for name, one in zip(fleet.names, motions, strict=True)
        }
        for one in pilots:
            one.heard(air.heard(one.member.name, time), time)
            one.saw(seen)
            one.step(time)
        if all(rests(one, time) for one in pilots):
            return float(time), least
    return math.inf, least


def rests(pilot: FleetPilot, time: float) -> bool:
    """Return whether a craft's path has ended at its goal."""
    path = pilot.reference.path
    return time >= path.end and float(np.abs(path.rest - pilot.member.goals[-1]).max()) < NEAR


def crossings(options: argparse.Namespace) -> Iterator[tuple[int, float, float]]:
    """Yield draw, time and least distance."""
    truths = prepare(options.models)
    for draw in range(options.first, options.first + options.flights):
        yield draw, *agreed(crossing(draw, options.models, truths, None), draw)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--models", type=Path, default=Path("fleet_models"))
    for draw, took, least in crossings(parser.parse_args()):
        print(f"{draw}: {took:.2f} s, {1e3 * least:.2f} mm", flush=True)


if __name__ == "__main__":
    from one_line import run

    run(main)
