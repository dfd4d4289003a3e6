"""How well does each rung predict the rest of a flight? Seven real flights of five craft.

    AIRPUCK_DATA=... python studies/held_out.py [--flights h1_blue,h2_red] [--json FILE]

Every rung is learned from the first 60 % of each available public recording and evaluated on the
last 40 %, from every start in overlapping windows. The delay is the authors' or learned. Prints
root mean square errors after 0.2 s with 95 % intervals by block bootstrap, and for each rung the
ratio to the previous one, over all flights. Faults are kept out of the fits; errors are given with
and without them.

The pooled ratio is the geometric mean over the flights. Its interval is Student's, from the
differences between flights: the expected range for another flight of another craft.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t

from airpuck import (
    InputError,
    Model,
    Preparation,
    Trajectory,
    Vehicle,
    default_vehicle,
    evaluate,
    find_faults,
    identify,
    load_trajectory,
)
from airpuck.evaluation.evaluate import EveryStart
from airpuck.evaluation.statistical_tests import rmse_interval, rmse_ratio
from airpuck.recording.dataset import dataset_folder

RUNGS = ("M0", "M1", "M2", "M3", "M4", "M5", "M5+drag", "M5+drag+idle")
#: Reference of each rung.
BEFORE = {"M1": "M0", "M2": "M0", "M3": "M2", "M4": "M3", "M5": "M3"}
BEFORE |= {"M5+drag": "M5", "M5+drag+idle": "M5+drag"}
#: After a fault, until motor speeds are known again: three time constants.
SETTLING_S = 0.08


def flights(names: list[str] | None) -> Iterator[tuple[str, Vehicle, Trajectory]]:
    """Load the authors' file of every available recording, with its craft."""
    for folder in sorted((dataset_folder() / "experiments").iterdir()):
        if not (folder / "data.pt").exists():
            continue
        if names and not any(name in folder.name for name in names):
            continue
        yield folder.name, craft(folder), load_trajectory(folder / "data.pt")


def craft(folder: Path) -> Vehicle:
    """Return the paper's vehicle, with the mass that the recording states."""
    vehicle, mass = default_vehicle(), folder / "mass.txt"
    if not mass.exists():
        return vehicle
    grams = float(mass.read_text().strip().removesuffix("g"))
    return vehicle.model_copy(update={"mass_kg": grams / 1e3})


def without_faults(trajectory: Trajectory, model: Model) -> Trajectory:
    """Leave out faults, and the time until motors are known again."""
    faults = find_faults(trajectory, model)
    return trajectory.leave_out([replace(f, stop=f.stop + SETTLING_S) for f in faults])


def position_and_yaw(errors: EveryStart) -> np.ndarray:
    """Return the distance from the measured position [m], and the yaw's error [rad]."""
    return np.stack([np.hypot(*errors.errors[:2]), errors.errors[2]])


def judged(
    vehicle: Vehicle, trajectory: Trajectory, rungs: list[str]
) -> Iterator[tuple[str, str, dict[str, EveryStart], Model]]:
    """Learn from the first part; predict all of the last part, and mark its healthy windows."""
    train, test = trajectory.slice(0, 0.6), trajectory.slice(0.6, 1)
    healthy = None
    for rung in sorted(rungs, key=lambda name: name != "M3"):  # M3 finds the faults
        for delay in ("fixed",) if rung in ("M0", "M1") else ("fixed", "fit"):
            preparation = Preparation(faults="exclude", delay=delay)
            model = identify(train, rung, vehicle=vehicle, preparation=preparation).model
            healthy = healthy or without_faults(test, model)
            parts = {"all": test, "healthy": healthy}
            found = {name: evaluate(model, part).every_start for name, part in parts.items()}
            yield rung, delay, found, model


def pooled(logs: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the geometric mean of ratios over flights, and its 95 % interval."""
    values = np.array(logs)
    count = len(values)
    mean = values.mean(axis=0)
    half = t.ppf(0.975, count - 1) * values.std(axis=0, ddof=1) / np.sqrt(count)
    return np.exp(mean), np.exp([mean - half, mean + half])


def in_words(values: np.ndarray, interval: np.ndarray) -> str:
    """Write position and yaw, each with its interval."""
    ends = zip(values, *interval, strict=True)
    return "   ".join(f"{v:.3f} ({low:.3f} to {high:.3f})" for v, low, high in ends)


def report_flight(name: str, found: dict[tuple[str, str], dict[str, EveryStart]]) -> list[Any]:
    """Print and return the errors of one flight."""
    rows = []
    for (rung, delay), errors in found.items():
        for part, of_part in errors.items():
            values, both = of_part.rmse, position_and_yaw(of_part)
            ends = rmse_interval(both, of_part.start)
            mm, rad = 1e3 * np.hypot(*values[:2]), values[2]
            print(
                f"  {rung:8} {delay:5} {part:8} {mm:6.2f} mm ({1e3 * ends[0, 0]:.2f} to "
                f"{1e3 * ends[1, 0]:.2f})   {rad:.4f} rad ({ends[0, 1]:.4f} to {ends[1, 1]:.4f})"
                f"   x {1e3 * values[0]:.2f} y {1e3 * values[1]:.2f} mm",
                flush=True,
            )
            figures = of_part.to_json()
            rows.append({"flight": name, "model": rung, "delay": delay, "part": part, **figures})
    return rows


def report_ratios(title: str, pairs: list[tuple[EveryStart, EveryStart]]) -> dict[str, Any]:
    """Print and return a ratio of errors, second over first, of each flight and pooled."""
    ratios = [rmse_ratio(position_and_yaw(a), position_and_yaw(b), a.start) for a, b in pairs]
    mean, interval = pooled([np.log(ratio) for ratio, _, _ in ratios])
    print(f"  {title:34} {in_words(mean, interval)}", flush=True)
    return {
        "ratio": title,
        "pooled": mean.tolist(),
        "pooled_interval_95": interval.tolist(),
        "of_flight": [ratio.tolist() for ratio, _, _ in ratios],
        "of_flight_interval_95": [ends.tolist() for _, ends, _ in ratios],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", help="parts of their names, separated by commas")
    parser.add_argument("--rungs", default=",".join(RUNGS), help="separated by commas")
    parser.add_argument("--json", type=Path, help="file for all figures")
    options = parser.parse_args()
    names, rungs = options.flights and options.flights.split(","), options.rungs.split(",")
    results, rows = [], []
    for name, vehicle, trajectory in flights(names):
        print(f"{name}, {trajectory.duration:.0f} s", flush=True)
        found = {}
        for rung, delay, errors, model in judged(vehicle, trajectory, rungs):
            found[rung, delay] = errors
            lag = 1e3 * float(model.parameters.motor_time_constant)
            total = lag + 1e3 * model.transport_delay
            print(f"  {rung} {delay}: lag {lag:.1f} ms, lag and delay {total:.1f} ms", flush=True)
        results.append(found)
        rows += report_flight(name, found)
    if len(results) < 2:
        raise InputError("is fewer than two flights: nothing to pool", field="--flights")
    print("ratios over flights: position, yaw (95 % interval)")
    ratios = []
    for part in ("all", "healthy"):
        for rung, delay in results[0]:
            for other in [(BEFORE.get(rung, ""), delay), (BEFORE.get(rung, ""), "fixed")]:
                if other in results[0]:
                    pairs = [(found[other][part], found[rung, delay][part]) for found in results]
                    title = f"{rung} over {other[0]}, delay {delay}, {part}"
                    ratios.append(report_ratios(title, pairs))
                    break
            if delay == "fit":
                pairs = [(f[rung, "fixed"][part], f[rung, delay][part]) for f in results]
                title = f"{rung}, delay fit over fixed, {part}"
                ratios.append(report_ratios(title, pairs))
    if options.json:
        options.json.write_text(json.dumps({"errors": rows, "ratios": ratios}, indent=2) + "\n")


if __name__ == "__main__":
    from one_line import run

    run(main)
