"""Improvement by each term of the physics, on data that no fit has used.

    AIRPUCK_DATA=... python studies/rungs.py [--robust] [--models M3,M3+drag,M5]

Rungs are learned from one recording or span and evaluated on another, which shares no window with
it: the paper's training and validation experiments, and the first 60 % and the last 40 % of
h1_blue. Every rung is judged with the same encoders. Prints errors after 0.2 s, the change of the
position error against the first rung, and the coefficients of the terms.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from airpuck import Loss, Model, Preparation, evaluate, identify, load_trajectory
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.evaluate import ENCODERS
from airpuck.model.quantities import QUANTITIES
from airpuck.model.rungs import TERMS, named_rung
from airpuck.recording.dataset import dataset_folder

MODELS = (
    "M3",
    *(f"M3+{term}" for term in TERMS if term != "residual"),
    "M5",
    "M5+drag",
    "M5+drag+sag",
)


def pairs(folder: Path) -> Iterator[tuple[str, Trajectory, Trajectory]]:
    """Return names, training data and validation data."""
    training = load_trajectory(folder / "2023_10_18-11_28_12_sysid_h1_old" / "data.pt")
    validation = load_trajectory(folder / "2023_11_22-11_57_44_sysid_h1_old" / "data.pt")
    yield "training to validation experiment", training, validation
    blue = load_trajectory(folder / "2024_03_05-16_12_50_sysid_h1_blue")
    yield "h1_blue, first 60 % to last 40 %", blue.slice(0, 0.6), blue.slice(0.6, 1)


def coefficients(model: Model) -> str:
    """Return the terms' coefficients in words."""
    told = []
    for quantity in QUANTITIES:
        if quantity.name in model.parameters.effects:
            values = np.ravel(getattr(model.parameters, quantity.name))
            for k, value in enumerate(values):
                symbol, unit = quantity.of_entry(k)
                told.append(f"{symbol} {value:.3g} {unit}")
    return ", ".join(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", default=",".join(MODELS), help="rungs, separated by commas")
    parser.add_argument("--robust", action="store_true", help="as identify --robust")
    options = parser.parse_args()
    rungs = [named_rung(name) for name in options.models.split(",")]
    for title, training, validation in pairs(dataset_folder() / "experiments"):
        print(title)
        first: dict[str, np.ndarray] = {}
        for rung in rungs:
            # Delay and windows as prepared, faults as found: the same for all rungs.
            model = identify(
                training,
                rung,
                loss=Loss(robust=options.robust),
                preparation=Preparation(delay="fixed", faults="exclude"),
            ).model
            print(f"  {rung.name}  {coefficients(model)}")
            for encoder in ENCODERS:
                found = evaluate(model, validation, encoder=encoder)
                errors = np.array([found.rmse, found.median_abs])
                position = np.hypot(*errors[:, :2].T)
                change = 100 * (position / first.setdefault(encoder, position) - 1)
                for name, (x, y, yaw), percent in zip(
                    ("RMS", "median"), errors, change, strict=True
                ):
                    print(
                        f"    {encoder:9} {name:6} {1e3 * x:6.2f} {1e3 * y:6.2f} mm "
                        f"{yaw:.3f} rad   position {percent:+5.1f} %",
                        flush=True,
                    )


if __name__ == "__main__":
    from one_line import run

    run(main)
