"""Time of one step of a player: decision and control, with pucks coming in.

    OPENBLAS_NUM_THREADS=1 python benchmarks/player_step.py --pucks 60

A new puck appears every three seconds: a shot at the goal, a slow puck, or a puck at rest. The
script prints wall time and processor time; other programs do not lengthen the latter.
"""

from __future__ import annotations

import argparse
import gc
import math
import time

import numpy as np

from airpuck.compute.process import low_latency
from airpuck.craft.table import AirHockey
from airpuck.flight.loop import control
from airpuck.model.model_file import read_model
from airpuck.physics.puck import PuckState
from airpuck.twin.settings import default_twin_settings
from airpuck.twin.twin import Twin
from airpuck_hockey.player.player import Player


def served(rng: np.random.Generator) -> PuckState:
    """Return a puck: a shot, a slow puck, or a puck at rest."""
    kind, y = rng.integers(3), rng.uniform(-0.4, 0.4)
    if kind == 0:
        speed, angle = rng.uniform(1.0, 4.0), rng.uniform(-0.4, 0.4)
        return PuckState(0.6, y, 0.0, -speed * math.cos(angle), speed * math.sin(angle), 5.0)
    speed = 0.5 if kind == 1 else 0.0
    return PuckState(rng.uniform(-0.6, -0.2), y, 0.0, *rng.uniform(-speed, speed, 2).tolist())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pucks", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    low_latency()
    model, rng = read_model("paper:M3"), np.random.default_rng(options.seed)
    player = Player(model, AirHockey())
    settings, pose = default_twin_settings(), (*player.pitch.home, 0.0)
    twin = Twin(model, settings, seed=options.seed, pose=pose, puck=served(rng), logs=False)
    assert twin.play is not None
    puck = twin.play.puck
    assert puck is not None
    processor, took = [], []
    plain = player.step

    def timed(now: float):
        began = time.thread_time()
        step = plain(now)
        processor.append(time.thread_time() - began)
        return step

    player.step = timed
    gc.disable()  # as a real-time process does
    for k, _ in enumerate(control(player, twin, 3.0 * options.pucks)):
        took.append((*player.took, sum(player.took)))
        if k % 300 == 299:
            puck.place(served(rng))
    columns = [*np.array(took).T, np.array(processor)]
    for name, seconds in zip(("decision", "control", "both", "processor"), columns, strict=True):
        values = np.percentile(seconds * 1e3, [50, 99, 99.9, 100])
        told = zip(("p50", "p99", "p99.9", "max"), values, strict=True)
        print(f"{name:9s} " + "   ".join(f"{label} {value:6.2f} ms" for label, value in told))


if __name__ == "__main__":
    main()
