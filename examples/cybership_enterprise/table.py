"""Compare predictions of held-out runs with coasting: python table.py FOLDER MODEL MODEL."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import airpuck

#: The laboratory's grey-box model (cse1_m.m) with the start values of its fit (identify.m): mass
#: and damping forward, to starboard and clockwise; thrusters, and their forces at full command [N].
COUPLING = 14.1 * 0.03 + 0.1
MASS = np.array([[14.1 + 0.6, 0, 0], [0, 14.1 + 15, COUPLING], [0, COUPLING, 1.4 + 0.7]])
DAMPING = np.array([[0.55, 0, 0], [0, 3.94, 0.1], [0, -1.0, 0.3]])
LAYOUT = np.array([[1, 0, 1, 0, 0], [0, 1, 0, 1, 1], [0.055, -0.425, -0.055, -0.425, 0.415]])
FORCE = LAYOUT * np.array([1.28, 1.05, 1.28, 1.05, 2.14])
#: From our axes to north, east, down, and back.
DOWN = np.array([1, -1, -1])


def turned(yaw, forward, right):
    """Turn velocities of a body into the world's frame."""
    return np.cos(yaw) * forward - np.sin(yaw) * right, np.sin(yaw) * forward + np.cos(yaw) * right


def rates(pose, body, command):
    """Return the laboratory's derivatives of pose and velocities."""
    moved = np.array([*turned(pose[2], body[0], body[1]), body[2]])
    return moved, np.linalg.solve(MASS, FORCE @ command - DAMPING @ body)


def laboratory(found, flight):
    """Predict the same windows with the laboratory's model, which starts as a ship that coasts."""
    first = np.searchsorted(flight.time, found.start - flight.sample_period / 2)
    state = flight.state[first].reshape(-1, 2, 3) * DOWN
    pose, velocity = np.moveaxis(state, 0, -1)
    body = np.array([*turned(-pose[2], velocity[0], velocity[1]), velocity[2]])
    errors, now = [], flight.time[first]
    for step in range(1, len(found.errors) + 1):
        later = first + step
        held = np.searchsorted(flight.command_time, now + 1e-6, side="right") - 1
        ahead, astern = np.split(flight.command[held].T, 2)
        h, now = flight.time[later] - now, flight.time[later]
        moved, pushed = rates(pose, body, ahead - astern)
        moved, pushed = rates(pose + h / 2 * moved, body + h / 2 * pushed, ahead - astern)
        pose, body = pose + h * moved, body + h * pushed
        errors.append(DOWN[:, None] * pose - flight.state[later, :3].T)
        errors[-1][:, ~flight.measured[later]] = np.nan
    return replace(found, model="the laboratory's", errors=np.array(errors))


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
                coasts = airpuck.coasting(found, flight).rmse
                shown = {file.stem: found}
                if file == files[-1]:
                    shown["laboratory"] = laboratory(found, flight)
                for name, one in shown.items():
                    cells = (f"{100 * share:.0f} %" for share in one.rmse / coasts)
                    print(f"{name}, {run}, {horizon:g} |", " | ".join(cells))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
