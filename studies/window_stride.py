"""How much information do windows further apart lose? M3 of real and of simulated flights.

    AIRPUCK_DATA=... python studies/window_stride.py --flights 2

Prints for each stride the mean ratio of the standard errors to those with all windows, and the root
mean square change of the parameters in units of the latter. If a stride raises the variance of an
efficient estimate by a share e, the estimate moves by about √e standard errors.
"""

from __future__ import annotations

import argparse

import numpy as np

from airpuck import Loss, Preparation, excite, identify, load_trajectory, preprocess
from airpuck.data.trajectory import Trajectory
from airpuck.model.model_file import published_model
from airpuck.model.uncertainty import Uncertainty
from airpuck.recording.dataset import dataset_folder

TRAINING = "experiments/2023_10_18-11_28_12_sysid_h1_old"
STRIDES = (4, 7, 14, 28)


def fitted(trajectory: Trajectory, stride: int) -> Uncertainty:
    """Return the parameters and standard errors of a fit to the windows of a stride."""
    known = identify(
        trajectory,
        loss=Loss(spacing=stride * trajectory.sample_period),
        preparation=Preparation(faults="keep"),
    ).model.uncertainty
    assert known is not None
    return known


def compare(name: str, trajectory: Trajectory) -> None:
    """Print a line for each stride."""
    whole = fitted(trajectory, 1)
    for stride in STRIDES:
        known = fitted(trajectory, stride)
        ratio = known.standard_errors / whole.standard_errors
        both = np.isfinite(ratio)
        change = ((known.estimate - whole.estimate) / whole.standard_errors)[both]
        print(
            f"{name}, stride {stride}: standard errors × {ratio[both].mean():.3f}, "
            f"parameters moved by {np.sqrt(np.mean(change**2)):.2f} of them",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=2, help="simulated flights, of 60 s")
    options = parser.parse_args()
    compare("training experiment", load_trajectory(dataset_folder() / TRAINING))
    for seed in range(options.flights):
        flight = excite(published_model("M3"), 60.0, seed=seed)
        compare(f"twin, seed {seed}", preprocess(flight))


if __name__ == "__main__":
    from one_line import run

    run(main)
