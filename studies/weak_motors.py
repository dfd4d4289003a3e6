"""Does the controller find out what its motors do? Faults in flight on the twin, with and without.

    OPENBLAS_NUM_THREADS=1 python studies/weak_motors.py --seeds 12

Three seconds into a flight through set points one motor falls to 60 % of its thrust, or stands, or
nothing happens; motors take turns over the seeds. Twin and controller are the published M4.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from typing import Any

import numpy as np

from airpuck.control.reference import SetPoints
from airpuck.control.tuning import ESTIMATORS, default_tuning
from airpuck.flight.track import Track
from airpuck.model.model_file import published_model
from airpuck.physics.angle import pose_difference
from airpuck.twin.experiments import track
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import Motors, Stall, TwinSettings, Weakness, default_twin_settings

POINTS = [(0, 0, 0), (0.3, 0.1, 1.0), (0.0, -0.2, -0.5), (0.3, -0.1, 0.7), (0, 0, 0)]
DWELL, FAULT = 3.0, 3.0
#: Errors count as settled in the second half of a dwell.
SETTLED = 0.5 * DWELL
FAULTS = ("none", "60 %", "stalled")


def with_fault(fault: str, motor: str) -> TwinSettings:
    """Return the packaged settings with a fault of a motor."""
    when = {"motor": motor, "start_s": FAULT, "stop_s": DWELL * len(POINTS)}
    motors = {
        "none": Motors(),
        "60 %": Motors(weak=(Weakness(**when, share=0.6),)),
        "stalled": Motors(stalls=(Stall(**when),)),
    }
    return default_twin_settings().model_copy(update={"motors": motors[fault]})


@cache
def _plant() -> Any:
    return build_plant(published_model("M4"))


def flown(fault: str, estimator: str, seed: int) -> list[float]:
    """Fly once; return the root mean square errors of x, y [mm] and yaw [rad], settled."""
    model, set_points = published_model("M4"), SetPoints(DWELL * np.arange(len(POINTS)), POINTS)
    names = model.vehicle.propeller_names
    recording, _ = track(
        model,
        set_points,
        DWELL * len(POINTS),
        seed=seed,
        settings=with_fault(fault, names[seed % len(names)]),
        tuning=default_tuning().with_estimator(estimator),
        plant=_plant(),
    )
    flight = Track.of(recording, model.vehicle, "")
    wanted = np.array([set_points.at(float(t), 0.0).state[:3] for t in flight.time])
    error = pose_difference(np, flight.pose.T, wanted.T).T
    settled = (flight.time > FAULT) & (flight.time % DWELL > SETTLED)
    return (np.sqrt(np.mean(error[settled] ** 2, axis=0)) * [1e3, 1e3, 1]).tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--workers", type=int, default=None)
    options = parser.parse_args()
    print("fault     estimator   median and largest of x mm, y mm, yaw rad")
    with ProcessPoolExecutor(options.workers) as pool:
        for fault in FAULTS:
            for estimator in ESTIMATORS:
                flights = [pool.submit(flown, fault, estimator, s) for s in range(options.seeds)]
                errors = np.array([flight.result() for flight in flights])
                middle, most = np.median(errors, axis=0), errors.max(axis=0)
                numbers = "   ".join(
                    f"{m:7.3f} {w:7.3f}" for m, w in zip(middle, most, strict=True)
                )
                print(f"{fault:9s} {estimator:11s} {numbers}", flush=True)


if __name__ == "__main__":
    from one_line import run

    run(main)
