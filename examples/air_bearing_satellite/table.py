"""Compare identified forces with the load cell, and predictions with coasting and nominal values.

python table.py FOLDER WHOLE.toml START.toml: the dataset, and models identified on the whole flight
and on its first 60 %.
"""

import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

import airpuck

GRAVITY = 9.81  # m/s²
#: The scale needs this long to follow a change of the force [s].
SETTLED = 3.0
FLIGHT = "Data/Real_Test/Test/real_test_data.csv"


def load_cell(folder):
    """Return each thruster's force and its scatter from pulse to pulse [N]."""
    pulses = defaultdict(list)
    for file in sorted((folder / "Thruster_Test/Thruster_Data").glob("*.csv")):
        rows = np.genfromtxt(file, delimiter=",", names=True, dtype=None, encoding="utf-8")
        for number in range(1, rows["pulse_number"].max() + 1):
            pulse = rows[rows["pulse_number"] == number]
            firing = pulse[pulse["phase"] == "firing"]
            steady = firing["t_s"] > firing["t_s"][0] + SETTLED
            before = np.nanmedian(pulse["weight_g"][pulse["phase"] == "pre_pulse"])
            grams = np.nanmedian(firing["weight_g"][steady]) - before
            # Thruster k is bit k - 1 of the mask.
            thruster = int(firing["bitmask"][0]).bit_length()
            pulses[thruster].append(1e-3 * GRAVITY * grams)
    return {k: (np.mean(forces), np.std(forces)) for k, forces in sorted(pulses.items())}


def main(folder, whole, start):
    """Print both tables."""
    model = airpuck.read_model(whole)
    forces = model.parameters.thrust[:, 0]
    assert model.known is not None  # since identify wrote it
    errors = model.known.standard_errors[: len(forces)]
    print("thruster | load cell N | identified N")
    for k, (force, scatter) in load_cell(folder).items():
        print(f"{k} | {force:.3f} ± {scatter:.3f} | {forces[k - 1]:.3f} ± {errors[k - 1]:.3f}")

    mapping, vehicle = airpuck.read_mapping(folder / "mapping.toml"), model.vehicle
    rest = airpuck.load_trajectory(folder / FLIGHT, vehicle, mapping=mapping).slice(0.6, 1.0)
    nominal = airpuck.nominal_model(vehicle)
    still = replace(nominal.parameters, thrust=np.zeros_like(nominal.parameters.thrust))
    candidates = {
        "coasting": replace(nominal, parameters=still),
        "nominal": nominal,
        "identified": airpuck.read_model(start),
    }
    print("\nmodel, horizon s | x mm | y mm | yaw rad (95 % intervals)")
    for horizon in (1.0, 2.0, 3.0):
        for name, candidate in candidates.items():
            protocol = airpuck.Protocol().after(horizon)
            found = airpuck.evaluate(candidate, rest, protocol=protocol).every_start
            ends = found.interval.T * [[1e3], [1e3], [1.0]]
            cells = [
                f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"
                for value, (low, high), digits in zip(
                    found.rmse * [1e3, 1e3, 1], ends, (1, 1, 3), strict=True
                )
            ]
            print(f"{name}, {horizon:g} |", " | ".join(cells))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
