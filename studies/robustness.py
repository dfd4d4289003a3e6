"""Does the controller survive a bad radio? Set points on the twin, one flight for each seed.

    python studies/robustness.py --seeds 100

The jitter of the radio grows from 0 to 60 ms over the seeds. 30 % of the packets are lost, and an
outage of 100 ms begins at random once in two seconds. The controller (published M4, delay
compensated, disturbances rejected) visits the paper's set points, six seconds each.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from typing import Any

import numpy as np

from airpuck.control.reference import SetPoints
from airpuck.flight.track import Track
from airpuck.model.model_file import published_model
from airpuck.twin.experiments import track
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.tracking_study import SET_POINTS

DWELL, LONGEST_JITTER, LOSS, OUTAGE, OUTAGES_PER_S = 6.0, 0.06, 0.3, 0.1, 0.5
#: Mean over the last second of a dwell, for a set point to count as reached [m, m, rad].
REACHED = (0.02, 0.02, 0.1)


def bad_radio(jitter: float, seed: int, duration: float) -> TwinSettings:
    """Return the packaged settings with jitter, packet loss and outages."""
    rng = np.random.default_rng([seed, 99])
    starts = np.sort(rng.uniform(0, duration, rng.poisson(OUTAGES_PER_S * duration)))
    settings = default_twin_settings()
    radio = settings.radio.model_copy(
        update={
            "jitter_s": jitter,
            "loss": LOSS,
            "outages_s": tuple((t, t + OUTAGE) for t in starts.tolist()),
        }
    )
    return settings.model_copy(update={"radio": radio})


@cache
def _plant() -> Any:
    return build_plant(published_model("M4"))


def flown(seed: int, seeds: int = 100) -> dict[str, float]:
    """Fly once; return the distances from the set points and the clearance from the rails."""
    model, duration = published_model("M4"), DWELL * len(SET_POINTS)
    jitter = LONGEST_JITTER * seed / max(seeds - 1, 1)
    set_points = SetPoints(DWELL * np.arange(len(SET_POINTS)), SET_POINTS)
    log = track(
        model,
        set_points,
        duration,
        seed=seed,
        settings=bad_radio(jitter, seed, duration),
        plant=_plant(),
    )
    recording = log.recording
    flight = Track.of(recording, model.vehicle, "")
    # Missing poses give nan, which counts as not reached.
    unknown = (np.nan, np.nan, np.nan)
    errors = np.abs([result.steady_state_error or unknown for result in flight.results()])
    reach = default_twin_settings().table.reach(model.vehicle.radius_m)
    clearance = reach - np.abs(flight.pose[:, :2]).max(axis=0)
    return {
        "jitter ms": 1e3 * jitter,
        "x mm": 1e3 * float(errors[:, 0].max()),
        "y mm": 1e3 * float(errors[:, 1].max()),
        "yaw rad": float(errors[:, 2].max()),
        "clearance mm": 1e3 * float(clearance.min()),
        "overshoot mm": 1e3 * max(max(r.overshoot[:2]) for r in flight.results()),
        "failed": float(sum(s not in ("exact", "scaled", "nearest") for s in log.status)),
        "reached": float((errors < REACHED).all()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--workers", type=int, default=None)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.workers) as pool:
        rows = list(pool.map(partial(flown, seeds=options.seeds), range(options.seeds)))
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        print(
            f"{name:13s} median {np.median(values):8.3f}   "
            f"smallest {values.min():8.3f}   largest {values.max():8.3f}"
        )
    for row in rows:
        if not row["reached"] or row["clearance mm"] <= 0:
            print("missed:", {name: round(value, 3) for name, value in row.items()})


if __name__ == "__main__":
    from one_line import run

    run(main)
