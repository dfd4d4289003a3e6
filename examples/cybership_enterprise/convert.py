"""Convert the runs of CyberShip Enterprise I to CSV: python convert.py FOLDER OUTPUT."""

import csv
import sys
from pathlib import Path

from scipy.io import loadmat

RUNS = "10 prev work/2011 Skåtun/MatlabSystemIdentificationToolbox/realWorldData"
HEADER = ["time_s", "north_m", "east_m", "yaw_rad", "u1", "u2", "u3", "u4", "u5"]
#: The drives push only at full speed: rows of the speeds of bow thruster and of both Voith
#: Schneider propellers, and what is logged at full speed.
BOW_SPEED, VOITH_SPEED, FULL_BOW, FULL_VOITH = 12, 13, 0.95, 0.35


def rows(data):
    """Yield time, pose and commands; blank where the cameras lost the ship (logged as zeros)."""
    for row in data.T:
        pose = [""] * 3 if row[1] == 0 else row[[1, 2, 6]].tolist()
        driven = [row[VOITH_SPEED] > FULL_VOITH] * 4 + [row[BOW_SPEED] > FULL_BOW]
        commands = [min(max(u, -1.0), 1.0) * on for u, on in zip(row[7:12], driven, strict=True)]
        yield [row[0], *pose, *commands]


def main(folder, output):
    """Write a file for each run."""
    output.mkdir(parents=True, exist_ok=True)
    for number in (1, 3, 4):
        data = loadmat(folder / RUNS / f"CSE1_data_random_run{number}.mat")["cse1_data"]
        with (output / f"run{number}.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([HEADER, *rows(data.astype(float))])


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
