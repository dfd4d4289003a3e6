"""Compare drag and bounces of a real puck with the laws that airpuck assumes.

    python studies/real_puck.py RECORDING… --mapping FILE --table FILE [--json FILE]

Fits constant (Coulomb), linear and quadratic drag to the decelerations of all flights between two
contacts, and the restitution of single bounces against their normal speed. Bounces are divided in
two halves in order of time: how many of the second half lie in the 95 % interval that the first
half predicts? Used on the public recordings of AIAirHockey/puck_model: camera positions at 120 Hz.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import airpuck
import airpuck_hockey
from airpuck_hockey.puck.flights import find_flights, noise_of
from airpuck_hockey.puck.identification import seen_poses

#: Shorter flights contain no information about deceleration [s].
SHORTEST = 0.15
#: Nor do slower ones [m/s].
SLOWEST = 0.1
LAWS = {
    "constant": (0,),
    "linear": (1,),
    "quadratic": (2,),
    "constant and linear": (0, 1),
    "constant and quadratic": (0, 2),
    "linear and quadratic": (1, 2),
}


def decelerations(recordings) -> np.ndarray:
    """Return mean speed, deceleration and its standard deviation of each flight."""
    rows = []
    for recording in recordings:
        time, pose = seen_poses(recording, "puck")
        pose[:, 2] = 0.0
        noise = np.maximum(noise_of(time, pose), 1e-9)
        for flight in find_flights(time, pose, noise, 0.1):
            t = flight.time - flight.time.mean()
            if np.ptp(t) < SHORTEST:
                continue
            way = flight.pose[-1, :2] - flight.pose[0, :2]
            along = flight.pose[:, :2] @ way / max(float(np.hypot(*way)), 1e-9)
            basis = np.column_stack([t**2 / 2, t, np.ones_like(t)])
            path = np.linalg.lstsq(basis, along, rcond=None)[0]
            change, speed = path[:2].tolist()
            left = along - basis @ path
            scale = max(float(left @ left) / max(len(t) - 3, 1), float(noise[0]) ** 2)
            if speed > SLOWEST:
                error = np.sqrt(scale * np.linalg.inv(basis.T @ basis)[0, 0])
                rows.append((speed, -change, error))
    return np.array(rows)


def drag_laws(rows: np.ndarray) -> dict[str, dict[str, Any]]:
    """Fit each law robustly; a smaller information criterion is better."""
    from scipy.optimize import least_squares

    speed, slowed, error = rows.T
    found = {}
    for name, powers in LAWS.items():
        columns = np.column_stack([speed**power for power in powers]) / error[:, None]
        fit = least_squares(
            lambda c, columns=columns: columns @ c - slowed / error,
            np.zeros(len(powers)),
            loss="cauchy",
        )
        covariance = np.linalg.inv(fit.jac.T @ fit.jac)
        found[name] = {
            "coefficients": fit.x.tolist(),
            "errors": np.sqrt(np.diag(covariance)).tolist(),
            "criterion": 2 * fit.cost + len(powers) * np.log(len(rows)),
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--mapping", type=Path, required=True)
    parser.add_argument("--table", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    mapping = airpuck.read_mapping(given.mapping)
    recordings = [
        airpuck.read_recording(path, mapping=mapping, needs=("puck",)) for path in given.recordings
    ]
    rows = decelerations(recordings)
    laws = drag_laws(rows)
    print(
        f"{len(rows)} flights of at least {SHORTEST} s, {rows[:, 0].min():.2f} to "
        f"{rows[:, 0].max():.2f} m/s"
    )
    for name, law in sorted(laws.items(), key=lambda item: item[1]["criterion"]):
        terms = ", ".join(
            f"{value:.4f} ± {error:.4f}"
            for value, error in zip(law["coefficients"], law["errors"], strict=True)
        )
        print(f"{name:24s} {law['criterion']:8.1f}   {terms}")
    fit = airpuck_hockey.identify_puck(recordings, airpuck.read_table(given.table))
    speed, ratio = fit.rail_speed_m_s, fit.rail_ratio
    good = np.abs(ratio - np.median(ratio)) < 4 * fit.rail_scatter
    slope, level = np.polyfit(speed[good], ratio[good], 1)
    left = ratio[good] - slope * speed[good] - level
    spread = np.sqrt(
        left @ left / (good.sum() - 2) / np.sum((speed[good] - speed[good].mean()) ** 2)
    )
    print(
        f"{good.sum()} of {len(good)} bounces: restitution {ratio[good].mean():.3f}, scatter "
        f"{ratio[good].std(ddof=1):.3f}, change with speed {slope:+.4f} ± {spread:.4f} per m/s"
    )
    half = len(ratio) // 2
    mean, scatter = (
        np.median(ratio[:half]),
        1.4826 * np.median(np.abs(ratio[:half] - np.median(ratio[:half]))),
    )
    held = float(np.mean(np.abs(ratio[half:] - mean) < 1.96 * scatter))
    print(f"held out: {100 * held:.0f} % of {len(ratio) - half} within 95 % intervals")
    if given.json:
        figures = {
            "laws": laws,
            "restitution": float(ratio[good].mean()),
            "slope": float(slope),
            "slope_error": float(spread),
            "held_out": held,
        }
        given.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    from one_line import run

    run(main)
