"""Where does the prediction error come from? The true model on the twin, one cause at a time.

    AIRPUCK_DATA=... python studies/budget.py

First on the twin: every row is the error after 0.2 s of the twin's own model, so the model adds no
error. `known start` begins at the true state and motor speeds. Its error is due to events after the
present, the floor for any predictor that uses past data only. Then the real validation experiment,
split by the known faults in its data.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from recovery import truth

from airpuck import evaluate, identify, load_trajectory, preprocess
from airpuck.control.excitation import Excitation
from airpuck.data.trajectory import Trajectory
from airpuck.data.windows import make_windows
from airpuck.evaluation.evaluate import PROTOCOLS
from airpuck.flight.loop import fly
from airpuck.model.model_file import Model, nominal_model
from airpuck.physics.rigid_body import rollout
from airpuck.recording.dataset import dataset_folder
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import TwinSettings, default_twin_settings, read_twin_settings
from airpuck.twin.twin import Twin

DURATION, SEEDS, STEP = 98.0, (2, 3, 4), 48
HOW = (
    ("paper", "paper"),
    ("actuation", "paper"),
    ("actuation", "paper-long"),
    ("actuation", "causal"),
)
#: Known faults of the paper's validation experiment [s].
FAULTS = {
    "motors not armed": ((0.0, 2.2),),
    "radio out": ((28.2, 28.9), (58.0, 58.8), (87.9, 88.7)),
    "motors that do not start": ((30.05, 30.3), (60.1, 60.7)),
}


def flown(settings: TwinSettings, seed: int) -> tuple[Trajectory, np.ndarray]:
    """Fly the excitation; return the trajectory and the true states at its samples."""
    model = truth()
    twin = Twin(model, settings, seed=seed, plant=build_plant(model, settings))
    pilot = Excitation(nominal_model(model.vehicle), seed=seed, table=settings.table)
    fly(pilot, twin, DURATION, pilot.controller.tuning.period_s)
    trajectory = preprocess(twin.recording(), delay=twin.settings.radio.delay_s)
    states = twin.truth[1]
    # Both are frames of the same camera: align them where the poses agree best.
    poses, count = states[:, :2], len(trajectory)
    apart = [
        np.abs(poses[k : k + count : 97] - trajectory.state[::97, :2][: len(poses[k::97])]).max()
        for k in range(len(poses) - count + 1)
    ]
    first = int(np.argmin(apart))
    return trajectory, states[first : first + count]


def from_known_start(model: Model, trajectory: Trajectory, states: np.ndarray) -> np.ndarray:
    """Predict from the true state and motor speeds, with the known commands held."""
    windows = make_windows(trajectory, 20, 50, 70)
    commands, durations, _ = windows.future()
    predicted = rollout(np, model.dynamics, states[windows.present].T, commands, durations)
    true = states[windows.present + STEP, :3].T
    return predicted[STEP - 1, :3] - true


def summary(errors: list[np.ndarray]) -> str:
    """Format the root mean square over all flights."""
    x, y, yaw = np.sqrt(np.mean(np.concatenate(errors, axis=1) ** 2, axis=1))
    return f"{1e3 * x:6.2f} {1e3 * y:6.2f} mm {yaw:.3f} rad"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.parse_args()
    model, default = truth(), default_twin_settings()
    faulty = read_twin_settings(Path(__file__).parent / "faults.toml")
    steady = default.model_copy(update={"radio": default.radio.model_copy(update={"jitter_s": 0})})
    quiet = default.motion_capture.model_copy(
        update={"position_noise_m": 0.0, "yaw_noise_rad": 0.0}
    )
    worlds = {
        "no noise, no jitter": steady.model_copy(update={"motion_capture": quiet}),
        "no jitter": steady,
        "default radio and noise": default,
        "with the faults of the real flight": faulty,
    }
    for name, settings in worlds.items():
        flights = [flown(settings, seed) for seed in SEEDS]
        print(name)
        print("   known start      ", summary([from_known_start(model, *f) for f in flights]))
        for encoder, protocol in HOW:
            errors = [
                evaluate(model, t, encoder=encoder, protocol=PROTOCOLS[protocol]).at_horizon
                for t, _ in flights
            ]
            print(f"   {encoder:9s} {protocol:10s}", summary(errors), flush=True)
    by_fault()


def by_fault() -> None:
    """Print which windows contain the squared error of the real validation experiment."""
    folder = dataset_folder() / "experiments"
    training, validation = (
        load_trajectory(folder / name / "data.pt")
        for name in ("2023_10_18-11_28_12_sysid_h1_old", "2023_11_22-11_57_44_sysid_h1_old")
    )
    model = identify(training, "M3").model
    for encoder, protocol in HOW:
        result = evaluate(model, validation, encoder=encoder, protocol=PROTOCOLS[protocol])
        begin = result.start - validation.time[0]
        print(f"real flight, {encoder} {protocol}: {summary([result.at_horizon])}")
        left = np.ones(len(begin), dtype=bool)
        for name, spans in FAULTS.items():
            # The encoder's twenty samples or the prediction touch the fault.
            touched = np.any([(begin + 0.2 > a) & (begin - 0.08 < b) for a, b in spans], axis=0)
            left &= ~touched
            _print_share(name, result.at_horizon, touched)
        _print_share("all others", result.at_horizon, left)


def _print_share(name: str, errors: np.ndarray, chosen: np.ndarray) -> None:
    share = 100 * (errors[:, chosen] ** 2).sum(axis=1) / (errors**2).sum(axis=1)
    print(
        f"   {name:25s} {chosen.sum():3d} windows {summary([errors[:, chosen]])}   "
        f"{share[0]:3.0f} {share[1]:3.0f} {share[2]:3.0f} % of the squared error"
    )


if __name__ == "__main__":
    from one_line import run

    run(main)
