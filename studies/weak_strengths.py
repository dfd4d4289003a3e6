"""Is a weak motor named, and only that one? Short flights on the twin, identified with M3.

    OPENBLAS_NUM_THREADS=1 python studies/weak_strengths.py --flights 100
    OPENBLAS_NUM_THREADS=1 python studies/weak_strengths.py --flights 12 --resume weak.jsonl

The motors of each craft differ by the usual spread: full thrusts are uniform in a band as wide as
the vehicle file's `thrust_spread`. In every second flight one motor gives 70 to 90 % of the median
of the others. Craft have four, six and eight propellers, cameras 60 to 240 Hz. Prints how often
the weak motor was named, with the true factor in its 95 % interval, and the flights in which a
sound motor was named. With --resume, flights are kept in a file, and those in it are not repeated.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from false_alarms import CRAFT, craft
from kept import Kept
from one_line import run

from airpuck import excite, identify, preprocess
from airpuck.evaluation.statistical_tests import wilson_interval
from airpuck.faults.strengths import find_strengths
from airpuck.twin.settings import default_twin_settings

#: Length of a flight [s], rates of the cameras [Hz], and factors of a weak motor [1].
DURATION, RATES, WEAK = 15.0, (60.0, 120.0, 240.0), (0.7, 0.9)


def flown(seed: int) -> dict[str, Any]:
    """Fly and identify once; return the truth and what was named."""
    rng = np.random.default_rng(seed)
    model = craft(CRAFT[seed // 2 % len(CRAFT)])
    vehicle, names = model.vehicle, model.vehicle.propeller_names
    nominal = model.parameters.thrust
    factors = 1 + vehicle.nominal.thrust_spread * (rng.random(len(names)) - 0.5)
    weak = int(rng.integers(len(names)))
    if seed % 2:
        factors[weak] = rng.uniform(*WEAK) * np.median(np.delete(factors, weak))
    # The vehicle file's thrusts are equal, so the true ones differ by these factors only.
    alike = np.mean(nominal, axis=0) * factors[:, None]
    model = replace(model, parameters=replace(model.parameters, thrust=alike))
    settings, rate = default_twin_settings(), float(rng.choice(RATES))
    cameras = settings.motion_capture.model_copy(update={"rate_hz": rate})
    settings = settings.model_copy(update={"motion_capture": cameras})
    flight = preprocess(excite(model, DURATION, seed=seed, settings=settings), vehicle)
    strengths = find_strengths(identify(flight, "M3", vehicle=vehicle).model, flight)
    rows = {}
    for k, one in enumerate(strengths.actuators):
        truth = float(factors[k] / np.median(np.delete(factors, k)))
        rows[one.name] = [truth, one.of_others, one.of_others_error, one.verdict]
    found = strengths.actuators[weak]
    low, high = found.of_others_interval_95 or (np.nan, np.nan)
    return {
        "seed": seed,
        "weak": names[weak] if seed % 2 else None,
        "rate_hz": rate,
        "named": [one.name for one in strengths.remarkable],
        "holds": bool(low <= rows[found.name][0] <= high),
        "motors": rows,
        "sentences": strengths.sentences,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=100, help="with, and without a weak motor")
    parser.add_argument("--resume", type=Path, help="file of results, one JSON object a line")
    parser.add_argument("--workers", type=int, default=None)
    options = parser.parse_args()
    kept = Kept(options.resume)
    seeds = [seed for seed in range(2 * options.flights) if not kept.have(seed=seed)]
    with ProcessPoolExecutor(options.workers) as pool:
        for result in pool.map(flown, seeds):
            kept.add(result)
    weak = [one for one in kept.lines if one["weak"]]
    false = [one for one in kept.lines if set(one["named"]) - {one["weak"]}]
    named = sum(one["weak"] in one["named"] for one in weak)
    holds = sum(one["holds"] for one in weak)
    errors = [
        (seen - truth) / error
        for one in kept.lines
        for truth, seen, error, _ in one["motors"].values()
        if error > 0
    ]
    print(f"weak motor named: {named} of {len(weak)}, {wilson_interval(named, len(weak))}")
    print(f"its factor in the 95 % interval: {holds} of {len(weak)}")
    print(f"flights with a sound motor named: {len(false)} of {len(kept.lines)}")
    size = np.sqrt(np.mean(np.square(errors)))
    print(f"root mean square of errors over standard errors: {size:.2f}")
    for one in (*false, *(w for w in weak if w["weak"] not in w["named"])):
        print(json.dumps(one))


if __name__ == "__main__":
    run(main)
