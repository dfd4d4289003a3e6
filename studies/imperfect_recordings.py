"""Do lost frames, bad stamps and steps of clocks change a model or its verdict? Twin flights.

    OPENBLAS_NUM_THREADS=1 python studies/imperfect_recordings.py --flights 200 --resume found.jsonl
    OPENBLAS_NUM_THREADS=1 python studies/imperfect_recordings.py --flights 4 --duration 16

Each flight of the twin is recorded twice: as it was, and as laboratories record. In that one,
single frames are lost, and up to four bursts of up to 0.1 s. Stamps jitter. A bag has clocks that
step by 20 to 50 ms or drift by 5 to 30 ms; a table has poses that a faster logger repeats, or that
a client stamps when it polls them. Which of them, how many and where follows from the printed
seed. Both recordings are identified with M3 and judged. Prints how often 95 % intervals contain the
truth, how often the verdict is that of the untouched recording, how often a wrong model was
trusted, and how far parameters moved. With --resume, flights are kept in a file, and those in it
are not repeated. Details: imperfect_recordings.md.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from coverage import derived
from kept import Kept
from one_line import run
from recovery import true_delay, truth

from airpuck import excite, identify, preprocess
from airpuck.boundary.errors import InputError
from airpuck.evaluation.statistical_tests import wilson_interval
from airpuck.judgement.verdict import verdict
from airpuck.model.model_file import Model
from airpuck.recording.stream import Recording, Stream
from airpuck.twin.settings import default_twin_settings

#: Rate of the cameras [Hz].
RATE = 120.0
#: Fractions of single frames that are lost, and standard deviations of the stamps' jitter [s].
LOSSES, JITTERS = (0.0, 0.02, 0.05, 0.12, 0.2), (0.0, 1e-4, 3e-4)
#: Ratios of the logger's rate to the cameras', period of a client that polls, and its latency [s].
FASTER, POLLS, LATENCY = (1.25, 2.0, 4.0), 0.01, 5e-4
#: Errors of the response time [s] and of a full thrust with which no model may be trusted.
WRONG_TIME, WRONG_THRUST = 0.015, 0.1


def spoilt(recording: Recording, rng: np.random.Generator) -> tuple[Recording, dict[str, Any]]:
    """Return the recording as a laboratory might have made it, and what was done to it."""
    pose = recording["pose"]
    stamp, received = pose.stamp_ns / 1e9, pose.received_ns / 1e9
    begin, length = stamp[0], stamp[-1] - stamp[0]
    done: dict[str, Any] = {"lost": float(rng.choice(LOSSES)), "jitter": float(rng.choice(JITTERS))}
    kept = rng.random(len(stamp)) >= done["lost"]
    done["bursts"] = rng.uniform(0.02, 0.1, rng.integers(5)).tolist()
    for burst in done["bursts"]:
        first = rng.uniform(begin, begin + length)
        kept &= (stamp < first) | (stamp > first + burst)
    stamp, received, values = stamp[kept], received[kept], pose.values[kept]
    done["form"] = str(rng.choice(["bag", "repeated", "polled"]))
    late = 0.0
    if done["form"] == "bag":
        stamp = stamp + rng.normal(0, done["jitter"], len(stamp))
        if rng.random() < 0.5:
            done["step"] = float(rng.choice([-1, 1]) * rng.uniform(0.02, 0.05))
            at = received[0] + rng.uniform(0.2, 0.8) * length
            stamp = stamp + done["step"] * (received > at)
        if rng.random() < 0.5:
            done["drift"] = float(rng.choice([-1, 1]) * rng.uniform(0.005, 0.03))
            stamp = stamp + done["drift"] * (received - received[0]) / length
    elif done["form"] == "repeated":
        done["faster"] = float(rng.choice(FASTER))
        logged = np.arange(stamp[0] + 1e-4, stamp[-1], 1 / (done["faster"] * RATE))
        values = values[np.searchsorted(stamp, logged, side="right") - 1]
        stamp = received = logged
    else:
        polled = np.ceil((stamp + LATENCY) / POLLS) * POLLS
        late = float(np.min(polled - stamp))
        stamp = received = np.maximum.accumulate(polled + 3e-5 * (np.arange(len(polled)) % 5))
    done["late"] = late
    made = Stream(
        np.rint(stamp * 1e9).astype(np.int64),
        np.rint(received * 1e9).astype(np.int64),
        values,
        pose.columns,
    )
    return replace(recording, streams={**recording.streams, "pose": made}), done


def judged(model: Model, recording: Recording, late: float) -> dict[str, Any]:
    """Identify and judge; return errors with respect to the truth, and their standard errors."""
    try:
        trajectory = preprocess(recording)
        fit = identify(trajectory, "M3")
    except InputError as error:
        return {"outcome": "rejected", "why": error.problem}
    known = fit.uncertainty
    assert known is not None
    # Stamps that are late by the client's shortest latency make the delay longer by as much.
    true = model.with_delay(true_delay(model) + late).parameters
    error = fit.model.parameters.to_vector() - true.to_vector()
    thrusts = derived(fit.model) / derived(model) - 1
    slow = fit.model.parameters.motor_time_constant + fit.model.transport_delay
    right = true.motor_time_constant + true.transport_delay
    return {
        "outcome": verdict(fit.model, trajectory).outcome,
        "error": [*error.tolist(), *(derived(fit.model) - derived(model)).tolist()],
        "spread": [*known.standard_errors.tolist(), *fit.model.standard_error(derived).tolist()],
        "quantile": known.quantile,
        "response": float(slow - right),
        "thrust": float(np.abs(thrusts[1::2]).max()),
        "warnings": list(trajectory.warnings),
    }


def flown(seed: int, number: int, duration: float) -> dict[str, Any]:
    """Fly once; return what was done to the recording, and both results."""
    settings = default_twin_settings()
    cameras = settings.motion_capture.model_copy(update={"rate_hz": RATE})
    settings = settings.model_copy(update={"motion_capture": cameras})
    model, rng = truth(), np.random.default_rng([seed, number])
    recording = excite(model, duration, seed=1000 * seed + number, settings=settings)
    other, done = spoilt(recording, rng)
    whole = judged(model, recording, 0.0)
    return {
        "number": number,
        "seed": seed,
        "duration": duration,
        "done": done,
        "whole": whole,
        "spoilt": judged(model, other, done["late"]),
    }


def covered(results: list[dict[str, Any]], which: str) -> float:
    """Return how many intervals contain the truth [%]."""
    inside = []
    for one in results:
        if "error" in (found := one[which]):
            error, spread = np.array(found["error"]), np.array(found["spread"])
            known = np.isfinite(spread) & (spread > 0)
            inside += (np.abs(error) <= found["quantile"] * spread)[known].tolist()
    return 100 * float(np.mean(inside))


def report(results: list[dict[str, Any]]) -> None:
    """Print the rates, and every flight with another verdict."""
    both = [one for one in results if "error" in one["whole"] and "error" in one["spoilt"]]
    moved = [
        np.abs(np.array(one["spoilt"]["error"]) - np.array(one["whole"]["error"]))
        / np.array(one["spoilt"]["spread"])
        for one in both
        if not one["done"]["late"]
    ]
    same = sum(one["whole"]["outcome"] == one["spoilt"]["outcome"] for one in results)
    false = [
        one
        for one in both
        if one["spoilt"]["outcome"] == "trusted"
        and (abs(one["spoilt"]["response"]) > WRONG_TIME or one["spoilt"]["thrust"] > WRONG_THRUST)
    ]
    print(f"{len(results)} flights of {results[0]['duration']:g} s, seed {results[0]['seed']}")
    for which in ("whole", "spoilt"):
        print(f"95 % intervals contain the truth, {which}: {covered(results, which):.1f} %")
    low, high = (100 * x for x in wilson_interval(same, len(results)))
    print(f"same verdict: {same} of {len(results)} ({low:.0f} to {high:.0f} %)")
    print(f"wrong model trusted: {len(false)}")
    joined = np.concatenate(moved)
    joined = joined[np.isfinite(joined)]
    print(f"parameters moved by {np.median(joined):.2f} standard errors (median)", end="")
    print(f", {np.quantile(joined, 0.95):.2f} (95 % of them)")
    for one in results:
        if one["whole"]["outcome"] != one["spoilt"]["outcome"] or one in false:
            outcomes = one["whole"]["outcome"], one["spoilt"]["outcome"]
            print(one["number"], *outcomes, json.dumps(one["done"]), one["spoilt"].get("why", ""))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--duration", type=float, default=20.0, help="length of a flight [s]")
    parser.add_argument("--seed", type=int, default=43)
    parser.add_argument("--resume", type=Path, help="file of results, one JSON object a line")
    options = parser.parse_args()
    kept = Kept(options.resume)
    for number in range(options.flights):
        if not kept.have(number=number):
            kept.add(flown(options.seed, number, options.duration))
            print(f"{len(kept.lines)} of {options.flights} flights", flush=True)
    report(kept.lines)


if __name__ == "__main__":
    run(main)
