"""How often do residual tests reject the true model? Made-up flights with white pose noise.

    python studies/residual_alarms.py --flights 60

Prints, channel by channel, how many tests reject at the 1 % level: whiteness, and
cross-correlation (smallest adjusted p-value of the motors).
"""

from __future__ import annotations

import argparse
import multiprocessing
from dataclasses import replace
from functools import partial

import numpy as np

from airpuck.compute.process import usable_cores
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.residuals import BODY_CHANNELS, resid
from airpuck.evaluation.statistical_tests import LEVEL
from airpuck.model.model_file import Model, published_model
from airpuck.physics.rollout import rollout

#: Rate of the motion capture [Hz]; samples over which a command is held.
RATE, HOLD = 240.0, 24
#: Standard deviations of the poses: x, y [m], yaw [rad].
POSE_NOISE = np.array([4.5e-5, 4.5e-5, 6.5e-4])


def truth() -> Model:
    """Return the craft: the published M3, its centre of mass fixed to the body."""
    return replace(published_model("M3"), frame="body", indexing="start")


def flight(model: Model, seed: int, duration: float) -> Trajectory:
    """Fly random commands, one motor of each pair at a time, on a table without end."""
    rng, vehicle = np.random.default_rng(seed), model.vehicle
    held = round(duration * RATE) // HOLD
    commands = np.full((held, vehicle.n_propellers), vehicle.command_min)
    for pair in vehicle.pair_indices:
        signal = rng.uniform(-1, 1, held)
        for motor, sign in zip(pair, (1, -1), strict=True):
            commands[:, motor] = np.maximum(sign * signal, vehicle.command_min)
    command = np.repeat(commands, HOLD, axis=0)
    time = np.arange(len(command)) / RATE
    start = np.concatenate([np.zeros(6), command[0]])
    period = np.full(len(command) - 1, 1 / RATE)
    moved = rollout(np, model.dynamics, start, command[:-1], period)
    state = np.concatenate([start[None], moved])[:, :6]
    state[:, :3] += rng.normal(size=(len(state), 3)) * POSE_NOISE
    return Trajectory(
        time=time,
        state=state,
        acceleration=np.gradient(state[:, 3:], time, axis=0),
        command_time=time,
        command=command,
        propellers=vehicle.propeller_names,
        source=f"made-up flight {seed}",
    )


def alarms(seed: int, duration: float) -> np.ndarray:
    """Fly and test; return whether whiteness and cross-correlation reject, by channel."""
    model = truth()
    tests = resid(model, flight(model, seed, duration))
    least = [
        min(test.p_value for test in tests.correlations if test.channel == channel)
        for channel in BODY_CHANNELS
    ]
    return np.array([[test.p_value for test in tests.whiteness], least]) < LEVEL


def report(results: np.ndarray) -> None:
    """Print rates with their standard errors."""
    for row, title in enumerate(("whiteness", "cross-correlation")):
        for name, rejected in (
            *zip(BODY_CHANNELS, results[:, row].T, strict=True),
            ("all", results[:, row].ravel()),
        ):
            expected = np.sqrt(LEVEL * (1 - LEVEL) / len(rejected))
            print(
                f"{title:18s} {name:8s} {rejected.sum():3d} of {len(rejected)} rejected, "
                f"{100 * rejected.mean():.1f} % (1 % ± {100 * expected:.1f} % expected)"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=60)
    parser.add_argument("--duration", type=float, default=10.0)
    parser.add_argument("--processes", type=int, default=usable_cores())
    options = parser.parse_args()
    task = partial(alarms, duration=options.duration)
    # JAX has threads, which do not live through a fork.
    with multiprocessing.get_context("spawn").Pool(options.processes) as pool:
        report(np.array(pool.map(task, range(options.flights))))


if __name__ == "__main__":
    from one_line import run

    run(main)
