"""The exported controller against the one in Python: commands, states and statuses step by step.

    python studies/exported_c.py --steps 100000
    python studies/exported_c.py --law mpc --steps 10000
    python studies/exported_c.py --single

Targets are random, many out of reach; poses are lost, not finite, stale, or jump; commands are lost
or reported late. Both controllers get the same poses and commands. The predictive law's plan is
copied before each step, because every plan depends on the previous plan.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

import airpuck
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import default_tuning

#: The tests' apparatus is imported from here.
ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    sys.path.insert(0, str(ROOT))
    from tests.apparatus.compiled_controllers import CompiledController, compare, library

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--model", default="paper:M4")
    parser.add_argument("--law", default="lqr", choices=("lqr", "mpc"))
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--single", action="store_true", help="compile in single precision")
    options = parser.parse_args()
    model = airpuck.read_model(options.model)
    tuning = default_tuning().with_law(options.law)
    with tempfile.TemporaryDirectory() as folder:
        flags = ("-O2", *["-DAIRPUCK_SINGLE"] * options.single)
        shared = library(model, Path(folder), *flags, tuning=tuning)
        python = TrackingController(model, SetPoint(0.0, 0.0, 0.0), tuning)
        c = CompiledController(shared, model, tuning)
        iterations = []
        found = compare(
            python, c, options.steps, options.seed, lambda: iterations.append(c.iterations)
        )
    print(f"{options.steps} steps, {options.model}, {options.law}, seed {options.seed}")
    worst = found.worst("state")
    print(f"equal statuses: {found.same:.4%}; largest difference of a state {worst:.2g}")
    for k, (one, done) in enumerate(zip(found.steps, iterations, strict=True)):
        if one.statuses[0] != one.statuses[1]:
            print(f"step {k}: {' in Python, '.join(one.statuses)} in C, {done} iterations")
    print(f"iterations: mean {np.mean(iterations):.1f}, most {max(iterations)}")
    print(
        f"{'status':>16} {'steps':>7} {'p50':>8} {'p99.9':>8} {'max':>8}   difference of commands"
    )
    for status, count in found.seen.most_common():
        apart = [s.command for s in found.steps if s.statuses == (status, status)]
        if apart:
            p50, high = np.quantile(apart, [0.5, 0.999])
            print(f"{status:>16} {count:>7} {p50:8.1g} {high:8.1g} {max(apart):8.1g}")


if __name__ == "__main__":
    from one_line import run

    run(main)
