"""The table of shortest times, built by a campaign, and its errors at random states.

python studies/minimal_times.py -o campaign/ --table minimal_times.toml
"""

from __future__ import annotations

import argparse
import itertools
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import airpuck
from airpuck.planning.minimal_time import TERMINAL_CONDITIONS, MinimalTimes, craft_of, shortest_time

DISTANCE = [0.0, 0.1, 0.3, 0.7, 1.3, 2.2]
SPEED = [0.0, 0.7, 1.4, 2.1]
DIRECTION = [0.0, 1.570796, 3.141592]
#: Number of random states at which the table is tested.
CHECKS = 100


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--model", default="paper:M3")
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--table", type=Path, required=True)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    spec = given.output / "spec.toml"
    grid = {"distance_m": DISTANCE, "speed_m_s": SPEED, "direction_rad": DIRECTION}
    lines = [f"{name} = {values}" for name, values in grid.items()]
    spec.write_text(
        f'kind = "shortest_time"\nseeds = 1\nbase.model = "{given.model}"\n[grid]\n'
        + "\n".join(lines)
        + f"\narrival = {list(TERMINAL_CONDITIONS)}\n"
    )
    done = airpuck.campaign(spec, given.output, workers=given.workers, retry=True)
    found = {
        tuple(entry.setting[name] for name in ("arrival", *grid)): result.rows[0]["time_s"]
        for entry, result in zip(done.entries, done.results, strict=True)
    }
    shape = (len(TERMINAL_CONDITIONS), *map(len, grid.values()))
    times = [found[key] for key in itertools.product(TERMINAL_CONDITIONS, *grid.values())]
    axes = [np.array(values) for values in grid.values()]
    model, random = airpuck.read_model(given.model), np.random.default_rng(1)
    table = MinimalTimes(given.model, craft_of(model), *axes, np.reshape(times, shape), {})
    errors = []
    for k in range(CHECKS):
        distance, speed = random.uniform(0.02, 2.2), random.uniform(0, 2)
        angle, yaw = random.uniform(0, np.pi), random.uniform(-np.pi, np.pi)
        velocity = speed * np.array([np.cos(angle), np.sin(angle)])
        planned = shortest_time(model, distance, velocity.tolist(), yaw, TERMINAL_CONDITIONS[k % 2])
        errors.append(
            abs(float(table((distance, 0.0), velocity, TERMINAL_CONDITIONS[k % 2])) - planned)
        )
    error = dict(zip(("median", "p95", "worst"), np.quantile(errors, (0.5, 0.95, 1)), strict=True))
    error = {name: round(float(value), 4) for name, value in error.items()}
    replace(table, error=error).save(given.table)
    away, velocity = random.uniform(-1, 1, (2, 1000)), random.uniform(-1, 1, (2, 1000))
    begun = time.perf_counter()
    table(away, velocity)
    batch = time.perf_counter() - begun
    begun = time.perf_counter()
    for k in range(1000):
        table(away[:, k], velocity[:, k])
    single = time.perf_counter() - begun
    print(f"{len(times)} plans; error {error}")
    print(f"a look-up {1e3 * single:.0f} µs, in a batch of 1000 {1e3 * batch:.1f} µs")


if __name__ == "__main__":
    from one_line import run

    run(main)
