"""Compare predictions of held-out runs with coasting: python table.py FOLDER MODEL MODEL."""

import sys
from pathlib import Path

import airpuck


def main(folder, *files):
    """Print errors relative to those of a ship that coasts."""
    mapping = airpuck.read_mapping(folder / "mapping.toml")
    print("model, run, after s | x | y | yaw, relative to coasting")
    for file in files:
        model = airpuck.read_model(file)
        for run in (4, 3):
            flight = airpuck.load_trajectory(
                folder / f"runs/run{run}.csv", model.vehicle, mapping=mapping
            )
            for horizon in (1.0, 3.0, 5.0):
                protocol = airpuck.Protocol("ship", encoder_time=1.0).after(horizon)
                found = airpuck.evaluate(model, flight, protocol=protocol)
                share = found.rmse / airpuck.coasting(found, flight).rmse
                cells = (f"{100 * one:.0f} %" for one in share)
                print(f"{file.stem}, {run}, {horizon:g} |", " | ".join(cells))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
