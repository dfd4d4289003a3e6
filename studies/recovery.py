"""Is the truth recovered? Excitation flights of a known craft on the twin, identified one by one.

    python studies/recovery.py --seeds 20

Prints the error of every quantity over the seeds: mean, standard deviation, worst.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from airpuck import identify, preprocess
from airpuck.campaigns.items import recovery_errors
from airpuck.control.tuning import default_tuning
from airpuck.model.model_file import Model, published_model
from airpuck.twin.experiments import excite
from airpuck.twin.plant import build_plant
from airpuck.twin.radio import as_received
from airpuck.twin.settings import default_twin_settings

#: Upper limits of the errors; thrust: of the worst motor.
BOUNDS = {
    "thrust %": 2.0,
    "tau %": 5.0,
    "I %": 2.0,
    "alpha mrad": 5.0,
    "r mm": 0.3,
    "delay ms": 1.0,
}


def truth() -> Model:
    """Return the craft: the published M3, its centre of mass fixed to the body."""
    return replace(published_model("M3"), frame="body", indexing="start")


def true_delay(model: Model) -> float:
    """Return the mean delay of the default radio, whose packets never overtake each other [s]."""
    return as_received(model, default_twin_settings(), default_tuning().period_s).transport_delay


def recovered(found: Model, model: Model) -> dict[str, float]:
    """Compare what was identified with the truth."""
    errors = recovery_errors(found, model)
    return {
        "thrust %": 100 * errors["thrust"],
        "tau %": 100 * errors["motor_time_constant"],
        "I %": 100 * errors["inertia"],
        "alpha mrad": 1e3 * errors["angle_offset_rad"],
        "r mm": 1e3 * errors["center_of_mass_m"],
        "delay ms": 1e3 * (found.transport_delay - true_delay(model)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--duration", type=float, default=90.0)
    options = parser.parse_args()
    model = truth()
    plant = build_plant(model)
    rows = []
    for seed in range(options.seeds):
        flight = preprocess(excite(model, options.duration, seed, plant=plant))
        rows.append(recovered(identify(flight, "M3").model, model))
        print(seed, {name: round(value, 3) for name, value in rows[-1].items()}, flush=True)
    for name, bound in BOUNDS.items():
        values = np.array([row[name] for row in rows])
        print(
            f"{name:12s} mean {values.mean():7.3f}   spread {values.std(ddof=1):6.3f}   "
            f"worst {np.abs(values).max():6.3f}   bound {bound}"
        )


if __name__ == "__main__":
    from one_line import run

    run(main)
