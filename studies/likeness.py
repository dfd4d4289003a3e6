"""Does the twin resemble the real table? Table 2 and distributions of motion, side by side.

    AIRPUCK_DATA=... python studies/likeness.py --out out/

M0 … M4 are learned from one excitation flight on the twin and evaluated on others, without faults
and with the faults of `faults.toml`. Prints mean errors after 0.2 s over the validation flights.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from recovery import truth

from airpuck import compare, identify, load_trajectory, preprocess
from airpuck.data.trajectory import Trajectory
from airpuck.recording.dataset import dataset_folder
from airpuck.report.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PAGE_WIDTH,
    PURPLE,
    VERMILLION,
    drawn,
    key,
    new_figure,
    styled,
    top_legend,
)
from airpuck.twin.experiments import excite
from airpuck.twin.settings import TwinSettings, default_twin_settings, read_twin_settings

MODELS = ("M0", "M1", "M2", "M3", "M4")
#: Lengths of the paper's experiments [s], and the seeds flown on the twin.
TRAINING, VALIDATION = 84.0, 98.0
TRAINING_SEED, VALIDATION_SEEDS = 1, (2, 3, 4, 5)
COLORS = (GREY, BLUE, VERMILLION, GREEN, ORANGE, PURPLE)


def table_2(settings: TwinSettings) -> Trajectory:
    """Print the twin's Table 2; return its training flight."""
    # The faults belong to the validation flight; unarmed motors were cut from the training flight.
    armed = settings.model_copy(
        update={"motors": settings.motors.model_copy(update={"unarmed_s": 0.0})}
    )
    training = preprocess(excite(truth(), TRAINING, TRAINING_SEED, settings=armed))
    models = [identify(training, name).model for name in MODELS]
    errors = np.array(
        [
            [
                [*evaluation.rmse, *evaluation.median_abs]
                for evaluation in compare(
                    models, preprocess(excite(truth(), VALIDATION, seed, settings=settings))
                )
            ]
            for seed in VALIDATION_SEEDS
        ]
    ).mean(axis=0)
    for name, (x, y, yaw, mx, my, myaw) in zip(MODELS, errors, strict=True):
        print(
            f"{name}  RMS {1e3 * x:5.2f} {1e3 * y:5.2f} mm {yaw:.3f} rad   "
            f"median {1e3 * mx:5.2f} {1e3 * my:5.2f} mm {myaw:.3f} rad",
            flush=True,
        )
    return training


def motion(trajectory: Trajectory) -> dict[str, Float[np.ndarray, " M"]]:
    """Compute the compared quantities: magnitudes over all usable samples."""
    state = trajectory.state[trajectory.usable]
    acceleration = trajectory.acceleration[trajectory.usable]
    return {
        "speed [m/s]": np.hypot(state[:, 3], state[:, 4]),
        "spin |ω| [rad/s]": np.abs(state[:, 5]),
        "acceleration [m/s²]": np.hypot(acceleration[:, 0], acceleration[:, 1]),
        "angular acceleration [rad/s²]": np.abs(acceleration[:, 2]),
    }


@styled
def likeness_figure(flights: Mapping[str, Trajectory]) -> Figure:
    """Draw the share of time above each speed and acceleration, for several flights."""
    figure = new_figure(PAGE_WIDTH, 5.0)
    panels = figure.subplots(2, 2, sharey=True)
    handles = []
    for number, (name, trajectory) in enumerate(flights.items()):
        color, dashes = COLORS[number % len(COLORS)], "-" if number < 3 else "--"
        handles.append(key(name, color, linestyle=dashes))
        for axes, (label, values) in zip(panels.ravel(), motion(trajectory).items(), strict=True):
            ordered = np.sort(values)
            above = 1 - (np.arange(len(ordered)) + 0.5) / len(ordered)
            axes.semilogy(ordered, above, color=color, linestyle=dashes)
            axes.set(xlabel=label, ylim=(1e-3, 1.0))
            axes.set_xlim(left=0)
    for axes in panels[:, 0]:
        axes.set_ylabel("share of time above")
    top_legend(figure, handles)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out"))
    options = parser.parse_args()
    print("twin without faults")
    clean = table_2(default_twin_settings())
    print("twin with faults")
    faulty = table_2(read_twin_settings(Path(__file__).parent / "faults.toml"))
    folder = dataset_folder() / "experiments"
    real = {
        f"real, {day}": load_trajectory(folder / name / "data.pt")
        for day, name in (
            ("training", "2023_10_18-11_28_12_sysid_h1_old"),
            ("validation", "2023_11_22-11_57_44_sysid_h1_old"),
        )
    }
    figure = likeness_figure({**real, "twin": clean, "twin with faults": faulty})
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "likeness.png").write_bytes(drawn(figure, "png"))
    print(options.out / "likeness.png")


if __name__ == "__main__":
    from one_line import run

    run(main)
