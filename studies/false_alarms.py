"""False alarms of resid and watch on healthy craft, and their detections of wrong models.

    OPENBLAS_NUM_THREADS=1 python studies/false_alarms.py --seeds 12 --out false_alarms.jsonl

The twin flies with its packaged radio and noise, and its true model. Craft with four, six and
eight propellers fly the excitation experiment, hover, and go through set points, 20 s each. `watch`
is evaluated every second, as in use. Then wrong models are tested on the flights of the first
seeds. Prints a line of JSON for each flight, and rates with exact 95 % intervals (Clopper and
Pearson).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from airpuck import preprocess
from airpuck.control.reference import SetPoints
from airpuck.craft.vehicle import Vehicle
from airpuck.evaluation.residuals import resid
from airpuck.flight.health import HealthMonitor
from airpuck.model.model_file import Model, nominal_model, published_model
from airpuck.recording.stream import Recording
from airpuck.twin.experiments import excite, track
from airpuck.twin.plant import Plant, build_plant

CRAFT = (4, 6, 8)
KINDS = ("excitation", "hover", "set points")
WRONG = ("motor", "delay", "mass")
#: Length of a flight, and time at a set point [s].
DURATION, DWELL = 20.0, 2.0
POINTS = [(0.0, 0.0, 0.0), (0.3, 0.1, 1.0), (0.0, -0.2, -0.5), (0.3, -0.1, 0.7)] * 4
#: The true share of the modelled thrust of one motor; errors of a delay and a mass [s, 1].
MOTOR, SHARE, DELAY, MASS = 1, 0.8, 0.01, 0.1


@cache
def craft(propellers: int) -> Model:
    """Return a craft: the paper's with six propellers, made-up ones with four and eight."""
    if propellers == 6:
        return replace(published_model("M3"), frame="body", indexing="start")
    # On a circle, pushing along it, alternately in both directions.
    angles = np.radians(np.arange(propellers) * 360 / propellers + 180 / propellers)
    turned = [
        {
            "name": f"motor_{k + 1}",
            "position_m": (0.06 * np.cos(angle), 0.06 * np.sin(angle)),
            "direction_deg": float((np.degrees(angle) + (90 if k % 2 else 270)) % 360),
        }
        for k, angle in enumerate(angles)
    ]
    return nominal_model(
        Vehicle.model_validate(
            {
                "name": f"{propellers} propellers",
                "mass_kg": 0.035 * propellers,
                "radius_m": 0.08,
                "command_min": 0.05,
                "pairs": [],
                "propellers": turned,
                "nominal": {
                    "thrust_N": (0.0, 0.6),
                    "inertia_kg_m2": 1.1e-4 * propellers,
                    "motor_time_constant_s": 0.03,
                    "transport_delay_s": 0.02,
                },
            }
        )
    )


@cache
def _plant(propellers: int) -> Plant:
    return build_plant(craft(propellers))


def flown(propellers: int, kind: str, seed: int) -> Recording:
    """Fly once, with the packaged radio."""
    model, plant = craft(propellers), _plant(propellers)
    if kind == "excitation":
        return excite(model, DURATION, seed, amplitude=0.6, plant=plant)
    points = POINTS if kind == "set points" else POINTS[:1]
    set_points = SetPoints(DWELL * np.arange(len(points)), points)
    return track(model, set_points, DURATION, seed=seed, plant=plant).recording


def wrong(model: Model, what: str) -> Model:
    """Return a wrong model that claims to know its delay."""
    free = model.free | model.parameters.mask(frozenset({"transport_delay"}))
    model = replace(model, free=free)
    if what == "motor":
        thrust = np.array(model.parameters.thrust)
        thrust[MOTOR] /= SHARE
        return replace(model, parameters=replace(model.parameters, thrust=thrust))
    if what == "delay":
        return model.with_delay(model.transport_delay - DELAY)
    heavier = model.vehicle.model_copy(update={"mass_kg": model.vehicle.mass_kg * (1 + MASS)})
    return replace(model, vehicle=heavier)


def watched(recording: Recording, model: Model) -> list[str]:
    """Return all findings of a monitor that is evaluated once a second."""
    monitor, begin = HealthMonitor(model), int(recording["pose"].stamp_ns[0])
    heard = [
        ((int(stamp) - begin) / 1e9, kind == "pose", values)
        for kind in ("command", "pose")
        for stamp, values in zip(recording[kind].stamp_ns, recording[kind].values, strict=True)
    ]
    findings, asked = set(), 1.0
    for time, is_pose, values in sorted(heard, key=lambda entry: entry[:2]):
        if time > asked:
            findings.update(monitor.health().findings)
            asked += 1.0
        (monitor.pose if is_pose else monitor.command)(time, values)
    return sorted(findings)


def judged(
    propellers: int, kind: str, seed: int, what: str, recording: Recording
) -> dict[str, Any]:
    """Return the findings of both commands on one flight and one model."""
    true = craft(propellers)
    model = true if what == "nothing" else wrong(true, what)
    tests = resid(model, preprocess(recording, true.vehicle))
    structure = [one for one in tests.structure if not one.passed]
    return {
        "propellers": propellers,
        "kind": kind,
        "seed": seed,
        "wrong": what,
        "whiteness": [test.channel for test in tests.whiteness if not test.passed],
        "correlation": [t.motor for t in tests.correlations if not t.passed],
        "errors": [error.name for error in tests.errors if not error.passed],
        "structure": [f"{one.channel} on {one.regressor}" for one in structure],
        "not_tested": [error.name for error in tests.errors if not error.tested],
        "watch": watched(recording, model),
    }


def one_flight(item: tuple[int, int, str, bool]) -> list[dict[str, Any]]:
    """Fly and judge, with wrong models as well if requested."""
    seed, propellers, kind, power = item
    recording = flown(propellers, kind, seed)
    models = ("nothing", *WRONG) if power else ("nothing",)
    return [judged(propellers, kind, seed, what, recording) for what in models]


def rate(found: Sequence[bool]) -> str:
    """Write a count with its exact 95 % interval."""
    from scipy.stats import binomtest

    low, high = binomtest(sum(found), len(found)).proportion_ci(method="exact")
    return f"{sum(found)} of {len(found)} ({100 * low:.1f} to {100 * high:.1f} %)"


def report(rows: Sequence[dict[str, Any]]) -> None:
    """Print the rates of false alarms and of detections."""
    families = ("whiteness", "correlation", "errors", "structure")
    healthy = [row for row in rows if row["wrong"] == "nothing"]
    for kind in (*KINDS, "all"):
        chosen = [row for row in healthy if kind in (row["kind"], "all")]
        print(f"healthy, {kind}: resid {rate([any(row[f] for f in families) for row in chosen])}")
        for family in families:
            print(f"    {family}: {rate([bool(row[family]) for row in chosen])}")
        print(f"  watch {rate([bool(row['watch']) for row in chosen])}")
    for what in WRONG:
        for kind in KINDS:
            chosen = [row for row in rows if (row["wrong"], row["kind"]) == (what, kind)]
            if not chosen:
                continue
            names = [craft(row["propellers"]).vehicle.propeller_names[MOTOR] for row in chosen]
            names = names if what == "motor" else [what] * len(chosen)
            pairs = list(zip(chosen, names, strict=True))
            any_test = rate([any(row[f] for f in families) for row in chosen])
            named = rate([name in row["errors"] for row, name in pairs])
            others = rate([bool(set(row["errors"]) - {name}) for row, name in pairs])
            told = rate([name not in row["not_tested"] for row, name in pairs])
            watch = rate([any(name in said for said in row["watch"]) for row, name in pairs])
            print(
                f"{what} wrong, {kind}: rejected {any_test}, named {named}, something else named "
                f"{others}, tested {told}; watch names it {watch}"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--power-seeds", type=int, default=2)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("false_alarms.jsonl"))
    options = parser.parse_args()
    items = [
        (seed, propellers, kind, seed < options.power_seeds)
        for seed in range(options.seeds)
        for propellers in CRAFT
        for kind in KINDS
    ]
    rows = []
    # JAX has threads, which do not survive a fork.
    with (
        multiprocessing.get_context("spawn").Pool(options.processes) as pool,
        options.out.open("w") as file,
    ):
        for found in pool.imap_unordered(one_flight, items):
            rows += found
            file.writelines(json.dumps(row) + "\n" for row in found)
            file.flush()
    report(rows)


if __name__ == "__main__":
    from one_line import run

    run(main)
