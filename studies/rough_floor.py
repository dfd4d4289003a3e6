"""A craft on a rough floor, identified with and without dry friction.

    OPENBLAS_NUM_THREADS=1 python studies/rough_floor.py --flights 3

Four propellers in two opposing pairs, which cannot push sideways; poses at 50 Hz with swapped
markers, pulse widths at 20 Hz. Friction is 0.04 m/s² on average, but zero to twice that from place
to place; one propeller gives 0.7 to 0.9 m/s².
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

from airpuck.craft.vehicle import Vehicle
from airpuck.faults.strengths import find_strengths, usual_rung
from airpuck.identification.fit import identify
from airpuck.model.model_file import Model, nominal_model
from airpuck.model.simulation import simulate
from airpuck.physics.effects import CREEP, Effect
from airpuck.preprocessing.pipeline import preprocess
from airpuck.recording.mapping import CommandMapping, RecordingMapping
from airpuck.recording.stream import Recording

STEP, DURATION, DELAY = 0.01, 60.0, 0.03
FRICTION, SPIN_DRAG = 0.04, 0.3
CRAFT = {
    "name": "pairs",
    "mass_kg": 0.35,
    "radius_m": 0.09,
    "command_min": 0.05,
    "propellers": [
        {"name": f"esc{k}", "position_m": [0.0, y], "direction_deg": angle}
        for k, (y, angle) in enumerate([(0.06, 0), (0.06, 180), (-0.06, 0), (-0.06, 180)], 1)
    ],
    "nominal": {
        "thrust_N": [0.0, 0.25],
        "inertia_kg_m2": 8e-4,
        "motor_time_constant_s": 0.04,
        "transport_delay_s": 0.02,
    },
}


@dataclass(frozen=True, eq=False)
class Floor(Effect):
    """Dry friction that changes from place to place, and drag of the spin."""

    of_place = True

    def acceleration(self, xp, motion):
        """Brake the craft."""
        rough = FRICTION * (1 + xp.sin(6 * motion.x) * xp.cos(5 * motion.y))
        rate = -rough / xp.sqrt(motion.forward**2 + motion.left**2 + CREEP**2)
        return rate * motion.forward, rate * motion.left, -SPIN_DRAG * motion.spin


def flown(vehicle: Vehicle, seed: int) -> tuple[Model, Recording]:
    """Return the true model without its floor, and a recording."""
    random = np.random.default_rng(seed)
    nominal = nominal_model(vehicle)
    truth = replace(
        nominal.parameters,
        thrust=nominal.parameters.thrust * random.uniform(1.0, 1.35, (4, 1)),
        inertia=6e-4,
        motor_time_constant=0.05,
    )
    model = replace(nominal, parameters=truth)
    count, packet, held = round(DURATION / STEP), 5, 30
    levels = np.where(random.random((count // held, 4)) < 0.5, random.uniform(0.2, 1, (4,)), 0.05)
    levels *= random.uniform(0.7, 1.0, levels.shape)
    command = np.repeat(levels.clip(0.05, 1.0), held, axis=0)
    dynamics = replace(model.dynamics, effects=(Floor(),))
    moved = simulate(dynamics, vehicle, np.zeros(6), command, STEP)
    time = STEP * np.arange(1, count + 1)
    seen = slice(None, None, 2)
    pose = moved[seen, :3] + random.normal(0, [3e-4, 3e-4, 3e-3], (count // 2, 3))
    for begin in random.choice(len(pose) - 5, 6):
        pose[begin : begin + 3, 2] += 2 * np.pi / 3
    pulses = np.round(1000 + 1000 * command[::packet])
    mapping = RecordingMapping(command=CommandMapping(neutral=1000, span=1000))
    sent = STEP * packet * np.arange(len(pulses)) - DELAY
    recording = Recording.from_arrays(
        time[seen], pose, sent, pulses, propellers=vehicle.columns, mapping=mapping
    )
    return model, recording


def main() -> None:
    """Print errors of forces, intervals that hold, and what is named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", type=int, default=1)
    given = parser.parse_args()
    vehicle = Vehicle.model_validate(CRAFT)
    for seed in range(given.flights):
        truth, recording = flown(vehicle, seed)
        trajectory = preprocess(recording, vehicle)
        for rung in ("M3", usual_rung(trajectory, vehicle)):
            fit = identify(trajectory, rung)
            found, known = fit.model.parameters, fit.model.uncertainty
            assert known is not None
            full = truth.parameters.thrust.sum(axis=1)
            off = found.thrust.sum(axis=1) - full
            error = known.propagate(lambda v, p=found: p.with_vector(v).thrust.sum(axis=1))
            named = find_strengths(fit.model, trajectory).remarkable
            faults = fit.exclusion.trajectories[0].excluded if fit.exclusion else ()
            false = sorted({s.cause for s in faults if "stalled" in s.cause or "radio" in s.cause})
            print(
                f"{seed} {rung}: forces {', '.join(f'{x:+.1f}' for x in 100 * off / full)} %; "
                f"{np.sum(np.abs(off) <= known.quantile * error)} of 4 intervals hold; named: "
                f"{', '.join([one.name for one in named] + false) or 'none'}",
                flush=True,
            )


if __name__ == "__main__":
    from one_line import run

    run(main)
