"""Do poses of any rate give the same model? Twin flights at several rates, and a thinned real one.

    AIRPUCK_DATA=... python studies/pose_rates.py

Prints for each rate the samples of a healthy flight that preprocessing and the fault search leave
out, errors of the identified parameters, and errors after 0.2 s on another flight. The real
recording is thinned by taking the nearest samples. For it the study prints the distance of the
parameters from those of all poses, in units of their standard errors, and errors on the last 40 %.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from recovery import recovered, truth

from airpuck import evaluate, find_faults, identify, preprocess
from airpuck.identification.fit_result import Fit
from airpuck.recording.dataset import dataset_folder
from airpuck.recording.read import read_recording
from airpuck.recording.stream import Recording
from airpuck.twin.experiments import excite
from airpuck.twin.plant import Plant, build_plant
from airpuck.twin.settings import TwinSettings, default_twin_settings

TWIN_RATES = (50, 100, 120, 240, 360)
REAL_RATES = (240, 120, 100, 80, 60, 50)
REAL = "experiments/2024_03_05-16_12_50_sysid_h1_blue/2024_03_05-16_12_50_sysid_h1_blue"


def twin_with(rate: float) -> TwinSettings:
    """Return the packaged settings with cameras of another rate."""
    usual = default_twin_settings()
    cameras = usual.motion_capture.model_copy(update={"rate_hz": float(rate)})
    return usual.model_copy(update={"motion_capture": cameras})


def thinned(recording: Recording, rate: float) -> Recording:
    """Keep the poses that are nearest to the times of a lower rate."""
    pose = recording["pose"]
    time = (pose.stamp_ns - pose.stamp_ns[0]) * 1e-9
    wanted = np.arange(0.0, time[-1], 1 / rate)
    after = np.clip(np.searchsorted(time, wanted), 1, len(time) - 1)
    nearest = np.unique(after - (wanted - time[after - 1] < time[after] - wanted))
    kept = replace(
        pose,
        stamp_ns=pose.stamp_ns[nearest],
        received_ns=pose.received_ns[nearest],
        values=pose.values[nearest],
    )
    return replace(recording, streams={**recording.streams, "pose": kept})


def errors_of(evaluation) -> str:
    """Write the errors at the horizon in words."""
    x, y, yaw = evaluation.rmse
    after = evaluation.horizon_step * evaluation.sample_period
    return f"{1e3 * x:5.2f} {1e3 * y:5.2f} mm {1e3 * yaw:6.1f} mrad after {after:.3f} s"


def on_twin(rate: float, duration: float, plant: Plant) -> None:
    """Print the results at one rate for a flight whose truth is known."""
    craft, settings = truth(), twin_with(rate)
    flight, other = (
        preprocess(excite(craft, duration, seed, settings=settings, plant=plant)) for seed in (1, 2)
    )
    fit = identify(flight, "M3")
    found = [span.cause for span in (*flight.excluded, *find_faults(flight, craft))]
    left_out = fit.exclusion.share if fit.exclusion else 0.0
    errors = recovered(fit.model, craft)
    print(
        f"{rate:4.0f} Hz  left out {found or 'nothing'}, by the fit {100 * left_out:.1f} %;",
        {name: round(value, 2) for name, value in errors.items()},
        errors_of(evaluate(fit.model, other)),
        f"truth {errors_of(evaluate(craft, other))}",
        flush=True,
    )


def on_real() -> None:
    """Print the effect of thinning on a real flight."""
    recording = read_recording(dataset_folder() / REAL)
    whole: Fit | None = None
    for rate in REAL_RATES:
        flight = preprocess(thinned(recording, rate) if rate < 240 else recording)
        fit = identify(flight.slice(0.0, 0.6), "M3")
        whole = whole or fit
        known = whole.model.uncertainty
        assert known is not None
        moved = fit.model.parameters.to_vector() - whole.model.parameters.to_vector()
        sure = known.standard_errors > 0
        apart = moved[sure] / known.standard_errors[sure]
        share = 1 - flight.usable.mean()
        print(
            f"{rate:4.0f} Hz  {len(flight.excluded)} spans left out, {100 * share:.1f} %; apart by "
            f"{np.sqrt(np.mean(apart**2)):.2f} standard errors, at most {np.abs(apart).max():.2f};",
            f"tau {1e3 * float(fit.model.parameters.motor_time_constant):.2f} ms,",
            f"delay {1e3 * fit.model.transport_delay:.2f} ms;",
            errors_of(evaluate(fit.model, flight.slice(0.6, 1.0))),
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=90.0)
    options = parser.parse_args()
    on_real()
    plant = build_plant(truth())
    for rate in TWIN_RATES:
        on_twin(rate, options.duration, plant)


if __name__ == "__main__":
    from one_line import run

    run(main)
