"""How often does `drift` report false and true changes? Pairs of flights on the twin.

    python studies/drift_rates.py --pairs 20 --duration 60

Each pair is one craft flown twice. In a third flight the propeller `--motor` is weakened by
`--loss`. Prints how often anything moved between the first two (the test allows 5 %), how often the
weakened propeller is found between the first and the third, and which others are named wrongly.
"""

from __future__ import annotations

import argparse
import multiprocessing
from dataclasses import replace
from functools import partial

import numpy as np

from airpuck import drift, identify, preprocess
from airpuck.compute.process import usable_cores
from airpuck.evaluation.drift import Drift
from airpuck.model.model_file import Model, published_model
from airpuck.twin.experiments import excite


def truth() -> Model:
    """Return the craft: the published M3, its centre of mass fixed to the body."""
    return replace(published_model("M3"), frame="body", indexing="start")


def weakened(model: Model, motor: str, loss: float) -> Model:
    """Return the craft with one weakened propeller."""
    thrust = np.array(model.parameters.thrust)
    thrust[model.vehicle.propeller_names.index(motor)] *= 1 - loss
    return replace(model, parameters=replace(model.parameters, thrust=thrust))


def learned(model: Model, seed: int, duration: float) -> Model:
    """Fly the excitation experiment and identify."""
    return identify(preprocess(excite(model, duration, seed)), "M3").model


def moved(found: Drift) -> list[str]:
    """Return the quantities that drift reports as moved."""
    return [change.quantity.words for change in found.changes if change.moved]


def pair(number: int, motor: str, loss: float, duration: float) -> tuple[list[str], list[str]]:
    """Fly three times; return the changes reported without and with a weakened propeller."""
    model = truth()
    crafts = model, model, weakened(model, motor, loss)
    before, same, weak = (
        learned(craft, 3 * number + k, duration) for k, craft in enumerate(crafts)
    )
    return moved(drift(before, same)), moved(drift(before, weak))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--motor", default="motor_b_1")
    parser.add_argument("--loss", type=float, default=0.1)
    parser.add_argument("--processes", type=int, default=usable_cores())
    options = parser.parse_args()
    task = partial(pair, motor=options.motor, loss=options.loss, duration=options.duration)
    # JAX has threads, which do not survive a fork.
    with multiprocessing.get_context("spawn").Pool(options.processes) as pool:
        results = []
        for same, weak in pool.imap(task, range(options.pairs)):
            results.append((same, weak))
            print(f"{len(results)}: same craft: {same or 'nothing'}; weakened: {weak}", flush=True)
    false = sum(bool(same) for same, _ in results)
    named = sum(any(options.motor in words for words in weak) for _, weak in results)
    others = sum(any(options.motor not in words for words in weak) for _, weak in results)
    count = len(results)
    print(f"something moved between two flights of one craft: {false} of {count}")
    print(f"{options.motor} weakened by {options.loss:.0%}: named in {named} of {count}")
    print(f"another quantity named as well: {others} of {count}")


if __name__ == "__main__":
    from one_line import run

    run(main)
