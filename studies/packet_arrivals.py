"""Effect of the radio's jitter on a fit, and the gain from known arrival times of packets.

    python studies/packet_arrivals.py --flights 8

Each excitation flight is identified four times: with the mean delay for every packet; as `identify`
does, with times estimated from the poses; with the true times; and with the true times and true
velocities, which leaves only the discretisation error. Prints mean and spread of the errors, and
the mean of the standard errors if there is one.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from unittest import mock

import numpy as np
from recovery import true_delay, truth

from airpuck import Preparation, identify, preprocess
from airpuck.campaigns.items import thrust_error
from airpuck.data.trajectory import Trajectory
from airpuck.model.model_file import Model
from airpuck.twin import experiments
from airpuck.twin import twin as twin_module
from airpuck.twin.plant import Plant, build_plant
from airpuck.twin.radio import RadioLink
from airpuck.twin.twin import Twin

QUANTITIES = ("inertia %", "tau ms", "delay ms", "F(1) %")


def watched_flight(
    model: Model, plant: Plant, duration: float, seed: int
) -> tuple[Trajectory, np.ndarray, np.ndarray]:
    """Fly; return the trajectory, how long each packet took, and the true velocities."""
    took: list[float] = []
    twins: list[Twin] = []

    class WatchedRadio(RadioLink):
        def send(self, time, command):
            super().send(time, command)
            took.append(self._last_arrival - time)

    class WatchedTwin(Twin):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            twins.append(self)

    with (
        mock.patch.object(twin_module, "RadioLink", WatchedRadio),
        mock.patch.object(experiments, "Twin", WatchedTwin),
    ):
        trajectory = preprocess(experiments.excite(model, duration, seed, plant=plant))
    time, state = twins[0].truth
    # The first command is sent at the twin's time zero.
    frame = np.searchsorted(time, trajectory.time - trajectory.command_time[0] - 1e-4)
    return trajectory, np.array(took), state[frame, 3:6]


def quantities(model: Model) -> np.ndarray:
    """Return the errors of `QUANTITIES`, the relative ones in percent of the truth."""
    true, found = truth().parameters, model.parameters
    full = found.thrust.sum(axis=1) / true.thrust.sum(axis=1)
    return np.array(
        [
            100 * (found.inertia / true.inertia - 1),
            1e3 * (found.motor_time_constant - true.motor_time_constant),
            1e3 * (model.transport_delay - true_delay(truth())),
            100 * (np.mean(full) - 1),
        ]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=8)
    parser.add_argument("--duration", type=float, default=60.0)
    options = parser.parse_args()
    model = truth()
    plant = build_plant(model)
    results: dict[str, list[np.ndarray]] = {}
    for seed in range(options.flights):
        trajectory, took, rates = watched_flight(model, plant, options.duration, seed)
        arrived = replace(
            trajectory, command_time=trajectory.command_time + took - true_delay(model)
        )
        state = np.concatenate([arrived.state[:, :3], rates], axis=1)
        ways = {
            "every packet after the mean delay": (trajectory, 0),
            "times estimated from the poses (identify)": (trajectory, Preparation().retimings),
            "true times of arrival": (arrived, 0),
            "true times and velocities": (replace(arrived, state=state), 0),
        }
        for name, (data, passes) in ways.items():
            fit = identify(data, "M3", preparation=Preparation(retimings=passes))
            error = np.append(quantities(fit.model), 100 * thrust_error(fit.model, model).max())
            spread = np.append(fit.model.standard_error(quantities), np.nan)
            results.setdefault(name, []).append(np.stack([error, spread]))
        print(f"{seed + 1} of {options.flights} flights", flush=True)
    for name, rows in results.items():
        errors, spreads = np.moveaxis(np.array(rows), 1, 0)
        print(name)
        for k, quantity in enumerate((*QUANTITIES, "worst thrust curve %")):
            own = errors[:, k]
            print(
                f"  {quantity:22s} mean {own.mean():7.3f}   spread {own.std(ddof=1):6.3f}   "
                f"mean SE {spreads[:, k].mean():6.3f}"
            )


if __name__ == "__main__":
    from one_line import run

    run(main)
