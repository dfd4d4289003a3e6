"""Does the controller find failed motors? Faults in flight on the twin.

    OPENBLAS_NUM_THREADS=1 python studies/weak_motors.py --seeds 12
    OPENBLAS_NUM_THREADS=1 python studies/weak_motors.py --seeds 6 --fault stalled --law mpc
    OPENBLAS_NUM_THREADS=1 python studies/weak_motors.py --seeds 6 --fault stalled --law converged

Three seconds into a flight through set points one motor falls to 60 % of its thrust, or stops, or
nothing happens; the seeds cycle through the motors. Twin and controller use the published M4.
known: the fault exists from the start, and the controller's model includes it. converged: nonlinear
predictive control solved to convergence, every 20 ms.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from predictive_limits.converged import Converged, Problem

from airpuck.control.laws import LAWS
from airpuck.control.predictive import PredictiveSettings
from airpuck.control.reference import Reference, SetPoints
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import ESTIMATORS, default_tuning
from airpuck.flight.track import Track
from airpuck.model.model_file import Model, published_model
from airpuck.physics.rigid_body import pose_difference
from airpuck.twin.experiments import track
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import Motors, Stall, TwinSettings, Weakness, default_twin_settings

POINTS = [(0, 0, 0), (0.3, 0.1, 1.0), (0.0, -0.2, -0.5), (0.3, -0.1, 0.7), (0, 0, 0)]
DWELL, FAULT = 3.0, 3.0
#: Errors count as settled in the second half of a dwell.
SETTLED = 0.5 * DWELL
#: Share of its thrust that the motor then gives. A model needs curves that rise.
FAULTS = {"none": 1.0, "60 %": 0.6, "stalled": 1e-3}
#: Tuning of the converged solution.
_SLOW = default_tuning().model_copy(update={"period_s": 0.02})


def with_fault(fault: str, motor: str, start: float) -> TwinSettings:
    """Return the packaged settings with a fault of a motor."""
    when = {"motor": motor, "start_s": start, "stop_s": DWELL * len(POINTS)}
    motors = {
        "none": Motors(),
        "60 %": Motors(weak=(Weakness(**when, share=0.6),)),
        "stalled": Motors(stalls=(Stall(**when),)),
    }
    return default_twin_settings().model_copy(update={"motors": motors[fault]})


@cache
def _plant() -> Any:
    return build_plant(published_model("M4"))


def knowing(
    fault: str, motor: int, law: str, model: Model, reference: Reference
) -> TrackingController:
    """Return a controller whose model has the fault."""
    thrust = model.parameters.thrust.copy()
    thrust[motor] *= FAULTS[fault]
    faulty = replace(model, parameters=replace(model.parameters, thrust=thrust))
    if law == "converged":
        return Converged(faulty, reference, _SLOW, Problem(faulty, _SLOW.of(PredictiveSettings)))
    return TrackingController(faulty, reference, default_tuning().with_law(law))


def flown(fault: str, law: str, estimator: str, seed: int) -> list[float]:
    """Fly once; return the root mean square errors of x, y [mm] and yaw [rad], settled."""
    model, set_points = published_model("M4"), SetPoints(DWELL * np.arange(len(POINTS)), POINTS)
    names, known = model.vehicle.propeller_names, estimator == "known"
    motor, tuning = seed % len(names), default_tuning()
    if not known:
        tuning = tuning.with_estimator(estimator).with_law(law)
    recording = track(
        model,
        set_points,
        DWELL * len(POINTS),
        seed=seed,
        settings=with_fault(fault, names[motor], 0.0 if known else FAULT),
        tuning=_SLOW if law == "converged" else tuning,
        plant=_plant(),
        make_pilot=partial(knowing, fault, motor, law) if known else None,
    ).recording
    flight = Track.of(recording, model.vehicle, "")
    wanted = np.array([set_points.at(float(t), 0.0).state[:3] for t in flight.time])
    error = pose_difference(np, flight.pose.T, wanted.T).T
    settled = (flight.time > FAULT) & (flight.time % DWELL > SETTLED)
    return (np.sqrt(np.mean(error[settled] ** 2, axis=0)) * [1e3, 1e3, 1]).tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--fault", choices=FAULTS, help="by default all in turn")
    parser.add_argument("--law", choices=(*LAWS, "converged"), default="lqr")
    options = parser.parse_args()
    law, estimators = options.law, ("known",)
    if law in LAWS:
        estimators = (*ESTIMATORS, *estimators)
    print(f"{law}\nfault     estimator   median and largest of x mm, y mm, yaw rad")
    with ProcessPoolExecutor(options.workers) as pool:
        for fault in [options.fault] if options.fault else FAULTS:
            for estimator in estimators:
                seeds = range(options.seeds)
                flights = [pool.submit(flown, fault, law, estimator, seed) for seed in seeds]
                errors = np.array([flight.result() for flight in flights])
                middle, most = np.median(errors, axis=0), errors.max(axis=0)
                numbers = "   ".join(
                    f"{m:7.3f} {w:7.3f}" for m, w in zip(middle, most, strict=True)
                )
                print(f"{fault:9s} {estimator:11s} {numbers}", flush=True)


if __name__ == "__main__":
    from one_line import run

    run(main)
