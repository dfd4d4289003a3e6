"""Do two parts of one flight give the same model? Differences against their standard errors.

    AIRPUCK_DATA=... python studies/halves.py [--models M3,M5] [--ways kept] [--bootstrap 40]

Each flight of the data set is cut in two, in two ways: into halves, and into alternating blocks of
five seconds. A change during the flight, such as a falling battery voltage, makes the halves differ
but not the blocks. Standard errors that are too small make both differ.

Prints for each way of fitting the differences in standard errors (root mean square over the
quantities of `drift`, which is 1 if intervals are right) and the share within 95 %, with 95 %
intervals over the flights. It also counts flights in which `drift` reports a change. Then it prints
the same with each thrust as a fraction of all, and the change of all thrusts together. With
--bootstrap, it prints how many resampled intervals of the differences contain zero. Flights with a
motor lag at its bound in one part, which other parameters compensate, are only named.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.stats import t as student

from airpuck import Fit, Loss, Model, Preparation, identify, load_trajectory
from airpuck.data.trajectory import Span, Trajectory
from airpuck.evaluation.drift import drift
from airpuck.evaluation.presentation import MainQuantity, main_quantities
from airpuck.identification.bootstrap import resampled_estimates
from airpuck.recording.dataset import dataset_folder

#: Length of the alternating blocks [s].
BLOCK = 5.0
SPLITS = ("halves", "in-turn")
#: Treatment of faults, and whether badly predicted windows have less weight.
WAYS = {"left-out": ("exclude", False), "kept": ("keep", False), "robust": ("keep", True)}


def parts(flight: Trajectory, split: str) -> list[Trajectory]:
    """Cut a flight in two."""
    if split == "halves":
        return [flight.slice(0, 0.5), flight.slice(0.5, 1)]
    edges = np.linspace(flight.time[0], flight.time[-1], 2 * round(flight.duration / BLOCK / 2) + 1)
    blocks = [Span(a, b, "other part") for a, b in pairwise(edges)]
    return [flight.leave_out(blocks[1::2]), flight.leave_out(blocks[::2])]


def fitted(part: Trajectory, rung: str, way: str, delay: str) -> Fit:
    """Identify a part."""
    faults, robust = WAYS[way]
    preparation = Preparation(faults=faults, delay=delay)  # type: ignore[arg-type]
    return identify(part, rung, loss=Loss(robust=robust), preparation=preparation)


def quantities(models: Iterable[Model]) -> list[MainQuantity]:
    """Return what all models learned."""
    models = list(models)
    listed = main_quantities(models[0], speeds=(0.5, 1.0))
    return [q for q in listed if all(q.used(m) and q.learned(m) for m in models)]


def total_thrust(model: Model) -> float:
    """Add up the thrusts at full speed [N]."""
    thrusts = [q for q in main_quantities(model) if q.parameter == "thrust"]
    return float(sum(q.value(model) for q in thrusts))


def in_errors(models: list[Model]) -> np.ndarray:
    """Return differences in standard errors, each thrust as a fraction of all."""
    found = []
    for quantity in quantities(models):

        def value(m: Model, q: MainQuantity = quantity) -> float:
            return float(q.value(m)) / (total_thrust(m) if q.parameter == "thrust" else 1.0)

        error = np.hypot(*(float(m.standard_error(value)) for m in models))
        if error > 0:
            found.append((value(models[1]) - value(models[0])) / error)
    return np.array(found)


def held_by_resampling(fits: list[Fit], replicates: int) -> float:
    """Return the share of intervals of the differences between two fits that contain zero [%]."""
    shared = quantities(fit.model for fit in fits)
    drawn = []
    for fit in fits:
        known = [fit.model.parameters.with_vector(e) for e in resampled_estimates(fit, replicates)]
        models = [replace(fit.model, parameters=parameters) for parameters in known]
        drawn.append(np.array([[float(q.value(m)) for q in shared] for m in models]))
    pairs = (drawn[1][:, None] - drawn[0]).reshape(-1, len(shared))
    low, high = np.percentile(pairs, [2.5, 97.5], axis=0)
    return 100 * float(np.mean((low <= 0) & (high >= 0)))


class Tally:
    """Results of all flights for one way of fitting."""

    def __init__(self) -> None:
        self._rows: dict[str, list[float]] = {}
        self._moved, self._bound = 0, list[str]()

    def add(self, fits: list[Fit], replicates: int = 0) -> None:
        """Compare the two parts of a flight."""
        models = [fit.model for fit in fits]
        if any("motor_time_constant is at its bound" in fit.warnings for fit in fits):
            self._bound.append(models[0].source)
            return
        found = drift(*models)
        blocks = sum(m.uncertainty.clusters for m in models if m.uncertainty)
        widest = float(student.ppf(0.975, blocks - 2))
        self._moved += any(change.moved for change in found.changes)
        for title, differences in (
            ("all", np.array([change.z for change in found.changes])),
            ("thrusts as shares", in_errors(models)),
        ):
            self._note(f"{title}: mean square", np.mean(differences**2))
            self._note(f"{title}: within", 100 * np.mean(np.abs(differences) <= widest))
        before, after = map(total_thrust, models)
        error = np.hypot(*(float(m.standard_error(total_thrust)) for m in models))
        self._note("change", 100 * (after / before - 1))
        self._note("error", 100 * float(error) / before)
        if replicates:
            self._note("resampled", held_by_resampling(fits, replicates))

    def _note(self, name: str, value: float) -> None:
        self._rows.setdefault(name, []).append(float(value))

    def __str__(self) -> str:
        flights, lines = len(self._rows["change"]), []
        for title in ("all", "thrusts as shares"):
            rms = np.sqrt(np.maximum(mean_and_interval(self._rows[f"{title}: mean square"]), 0))
            within = mean_and_interval(self._rows[f"{title}: within"])
            lines.append(
                f"{title}: RMS {rms[0]:.2f} ({rms[1]:.2f} to {rms[2]:.2f}), within 95 % "
                f"{within[0]:.1f} % ({within[1]:.0f} to {min(within[2], 100):.0f})"
            )
        lines[0] += f", moved in {self._moved} of {flights} flights"
        pairs = zip(self._rows["change"], self._rows["error"], strict=True)
        lines.append("all thrusts: " + ", ".join(f"{c:+.1f} ± {e:.1f} %" for c, e in pairs))
        if "resampled" in self._rows:
            lines.append(f"by resampling, within: {np.mean(self._rows['resampled']):.1f} %")
        lines += [f"motor lag at its bound: {name}" for name in self._bound]
        return "\n  ".join(lines)


def mean_and_interval(values: list[float]) -> np.ndarray:
    """Return the mean over flights and the ends of its 95 % interval."""
    count = len(values)
    reach = student.ppf(0.975, count - 1) * np.std(values, ddof=1) / count**0.5 if count > 1 else 0
    return np.mean(values) + np.array([0, -reach, reach])


def flights(folder: Path) -> list[Trajectory]:
    """Read all flights of the data set."""
    return [load_trajectory(path) for path in sorted(folder.glob("experiments/*/data.pt"))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", default="M3", help="rungs, separated by commas")
    parser.add_argument("--splits", default=",".join(SPLITS))
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--delays", default="fixed,fit")
    parser.add_argument("--bootstrap", type=int, default=0, metavar="N")
    options = parser.parse_args()
    given = flights(dataset_folder())
    for rung in options.models.split(","):
        for split in options.splits.split(","):
            for way in options.ways.split(","):
                for delay in options.delays.split(","):
                    tally = Tally()
                    for flight in given:
                        pair = [fitted(p, rung, way, delay) for p in parts(flight, split)]
                        tally.add(pair, options.bootstrap)
                    print(f"{rung}, {split}, faults {way}, delay {delay}\n  {tally}", flush=True)


if __name__ == "__main__":
    from one_line import run

    run(main)
