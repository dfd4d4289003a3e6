"""Seconds of flight per second of a batch of twins.

    python benchmarks/twin_throughput.py

Every craft has a separate radio, so each steps at different times. Values are medians. "same radio"
means that all craft share their step times.
"""

from __future__ import annotations

import argparse
import statistics
import time

import numpy as np

from airpuck.model.model_file import read_model
from airpuck.twin.batch import TwinBatch


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
    print(f"{'craft':>7} {'own radio':>13} {'same radio':>13}   seconds of flight per second")
    for craft in options.craft:
        batch = TwinBatch(model, craft, options.seconds)
        speeds = []
        for seeds in (range(craft), [0] * craft):

            def fly(batch=batch, seeds=seeds, craft=craft):
                begun = time.perf_counter()
                batch.reset(np.arange(craft), np.zeros((craft, 3)), seeds)
                for row in command:
                    batch.step(np.broadcast_to(row, (craft, n)))
                return craft * options.seconds / (time.perf_counter() - begun)

            fly()  # compiles
            speeds.append(statistics.median(fly() for _ in range(options.runs)))
        print(f"{craft:7d} {speeds[0]:13.0f} {speeds[1]:13.0f}", flush=True)


if __name__ == "__main__":
    main()
