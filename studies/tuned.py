"""Tune both laws by flights, and compare margins by flights with those of the linear loop.

    OPENBLAS_NUM_THREADS=1 python studies/tuned.py -o tuned.json

The start is the packaged tuning, whose gains are the authors' to within 2 %. Other seeds give other
craft for the trials and for the flights afterwards. Disk margins are python-control's, of the loop
that is broken where accelerations act: the regulator, the stationary Kalman filter with its
disturbance, the prediction over the delay, and the inverted lag, axis by axis.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
from scipy.linalg import solve_discrete_are

import airpuck
from airpuck.control.lqr import LQRSettings, lqr_gain, point_mass
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.estimate.axis_filter import process_noise
from airpuck.model.model_file import Model, published_model

MODEL = replace(published_model("M3"), frame="body", indexing="start")
CAMERA_HZ = 240.0


def loop(model: Model, tuning: Tuning, axis: int) -> tuple[Any, Any]:
    """Return controller (pose to acceleration) and plant (acceleration to pose) of one axis."""
    h, noise = tuning.period_s, tuning.estimation.noise
    late = round(model.transport_delay / h)
    a = np.array([[1.0, h, h * h / 2], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    b, c = np.array([h * h / 2, h, 0.0]), np.array([1.0, 0.0, 0.0])
    densities = (np.square([each[axis]]) for each in (noise.acceleration, noise.disturbance))
    # Frames between two commands count as one of less noise.
    variance = noise.pose[axis] ** 2 / (CAMERA_HZ * h)
    p = solve_discrete_are(a.T, c[:, None], process_noise(np, h, *densities)[0], [[variance]])
    blend = p @ c / (c @ p @ c + variance)
    whole = lqr_gain(tuning.of(LQRSettings).weights, h)
    gain = whole[axis, [axis, axis + 3]]
    # Mean acceleration in a period is a mix of the last request and the one before.
    ratio = float(np.mean(model.dynamics.lag)) / h
    old = ratio * -np.expm1(-1 / ratio)

    def mean_at(ago: int) -> np.ndarray:
        """Weights of the memory u[k-1], u[k-2], … in the period whose request was sent then."""
        row = np.zeros(late + 1)
        row[ago - 1] = 1 - old
        row[ago] += old
        return row

    n = 3 + late + 1
    estimate = np.hstack([np.eye(3) - np.outer(blend, c), np.zeros((3, late + 1))])
    state, by_pose = estimate.copy(), blend.copy()
    for ago in range(late, 0, -1):
        state, by_pose = a @ state, a @ by_pose
        state[:, 3:] += np.outer(b, mean_at(ago))
    # The last period is predicted with the acceleration before it.
    state, by_pose = a @ state, a @ by_pose
    state[:, 3] += b
    law = np.array([*gain, 1.0])
    out, through = -law @ state, float(-law @ by_pose)
    following = np.vstack([a @ estimate, np.zeros((late + 1, n))])
    following[:3, 3:] += np.outer(b, mean_at(late))
    following[3] = out
    following[4:, 3:-1] = np.eye(late)
    pilot = control.ss(
        following, np.r_[a @ blend, through, np.zeros(late)][:, None], [out], [[through]], h
    )
    free, push = point_mass(h)
    free, push = free[np.ix_([0, 3], [0, 3])], push[[0, 3], 0]
    motion = np.zeros((2 + late + 1, 2 + late + 1))
    motion[:2, :2] = free
    motion[:2, 2:] = np.outer(push, mean_at(late))
    motion[3:, 2:-1] = np.eye(late)
    enters = np.zeros((2 + late + 1, 1))
    enters[2] = 1.0
    return pilot, control.ss(motion, enters, np.eye(1, 2 + late + 1), [[0.0]], h)


def margins(model: Model, tuning: Tuning) -> dict[str, dict[str, float]]:
    """Return margins of the linear loops of x and yaw."""
    found = {}
    for name, axis in (("x", 0), ("yaw", 2)):
        pilot, plant = loop(model, tuning, axis)
        opened = -pilot * plant
        omega = np.geomspace(0.05, np.pi / tuning.period_s, 2000)
        disk, decibels, degrees = control.disk_margins(opened, omega)
        response = opened(np.exp(1j * omega * tuning.period_s))
        last = np.flatnonzero(np.abs(response) > 1)[-1]
        phase = np.angle(-response[last]) % (2 * np.pi)
        found[name] = {
            "stable": bool(np.abs(control.poles(control.feedback(opened, 1))).max() < 1),
            "disk_margin": float(disk),
            "gain_dB": float(decibels),
            "phase_deg": float(degrees),
            "delay_s": float(phase / omega[last]),
        }
    return found


def main() -> None:
    """Tune, and write a line for each law and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("tuned.json"))
    parser.add_argument("--laws", nargs="+", default=["lqr", "mpc"])
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    rows = []
    for law in given.laws:
        for seed in range(given.seeds):
            start = tuning_for(MODEL).with_law(law)
            found = airpuck.tune(MODEL, start, seed=100 * seed)
            row: dict[str, Any] = {"law": law, "seed": seed, **found.to_json()}
            if law == "lqr":
                row["linear"] = [margins(MODEL, each) for each in (start, found.tuning)]
            rows.append(row)
            print(json.dumps(row), flush=True)
            given.output.write_text(json.dumps(rows, indent=1), "utf-8")


if __name__ == "__main__":
    from one_line import run

    run(main)
