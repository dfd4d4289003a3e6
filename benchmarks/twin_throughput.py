"""Integration steps per second of a fleet of twins.

    python benchmarks/twin_throughput.py

Every craft has a separate radio, so each steps at different times; every 24th frame is kept. Values
are medians. "same radio" means that all craft share their step times.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

from airpuck.model.model_file import read_model
from airpuck.twin.fleet import fly_fleet


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--craft", type=int, nargs="+", default=[1, 100, 10_000])
    parser.add_argument("--seconds", type=float, default=5.0, help="length of the flights")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--model", default="paper:M3")
    options = parser.parse_args()
    import jax

    model = read_model(options.model)
    n = model.vehicle.n_propellers
    held = np.random.default_rng(0).uniform(0.03, 1, (round(options.seconds / 0.2), n))
    command = np.repeat(held, 20, axis=0)
    print(f"{options.model}, {options.seconds:g} s of flight, on {jax.devices()[0].device_kind}")
    print(f"{'craft':>7} {'precision':>9} {'own radio':>13} {'same radio':>13}   steps/s")
    for craft in options.craft:
        for precision in ("double", "single"):
            speeds = []
            for seeds in (range(craft), (0,)):
                poses = np.zeros((3, craft))

                def fly(seeds=seeds, poses=poses, precision=precision):
                    begun = time.perf_counter()
                    flight = fly_fleet(
                        model, command, seeds=seeds, poses=poses, every=24, precision=precision
                    )
                    return flight.steps / (time.perf_counter() - begun)

                fly()  # compiles
                speeds.append(statistics.median(fly() for _ in range(options.runs)))
            print(f"{craft:7d} {precision:>9} {speeds[0]:13.2e} {speeds[1]:13.2e}", flush=True)


if __name__ == "__main__":
    main()
