"""From the box to a trusted flight: craft drawn at random, commissioned on the twin.

    OPENBLAS_NUM_THREADS=1 python studies/commission.py -o commission.jsonl --flights 200 --seed 1

A draw is a craft of studies/verdicts.py (3 to 8 propellers; with three they push both ways), a lag
of 10 to 150 ms, a delay of 0 to 80 ms, cameras of 0.05 to 0.5 mm and 60 to 240 Hz, a radio with
jitter and losses, failed starts at the measured rates, and a slope of up to 20 mrad. One motor in
three draws gives 60 to 90 % of its thrust; in one draw of twenty a motor is dead, in one of twenty
it pushes the other way, in one of ten two motors are plugged into each other's sockets. The vehicle
file states thrusts that are wrong by up to a factor of two, mass and inertia by up to 30 %, and the
packaged lag and delay.

Each draw appends a line of JSON; an interrupted study resumes. `--fixed` also flies the fixed
sequence on the same craft: 60 s of excitation with the vehicle file's values, then `identify`.
Errors are of the largest accelerations, of the centre of mass, of the lag and of the delay.
`--summary` only reads the file.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from kept import Kept
from verdicts import drawn as healthy
from verdicts import settles

import airpuck
from airpuck import InputError
from airpuck.commissioning.commission import commission
from airpuck.compute.process import keep_compiled_programs
from airpuck.control.excitation import Excitation
from airpuck.craft.vehicle import Vehicle
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.flight.loop import fly
from airpuck.model.model_file import Model, nominal_model
from airpuck.twin.settings import TwinSettings, read_twin_settings
from airpuck.twin.twin import Twin

#: Longer than any run, and length of the fixed sequence [s].
ALWAYS, FIXED = 1e4, 60.0
#: Contacts with a rail above this speed are listed with their flight [m/s].
REPORTED = 0.1
#: A dead motor, reversed motor, swapped motors, a weak motor: shares of the draws.
DEAD, REVERSED, SWAPPED, WEAK = 0.05, 0.05, 0.1, 0.33


def draw(seed: int) -> tuple[Model, Vehicle, TwinSettings, dict[str, Any]]:
    """Draw a true craft, its user's vehicle file, a twin, and what is wrong."""
    rng = np.random.default_rng([47, seed])
    truth, settings = healthy(rng)
    names = [one.name for one in truth.vehicle.propellers]
    lag, delay = float(np.exp(rng.uniform(*np.log([0.01, 0.15])))), float(rng.uniform(0, 0.08))
    own = replace(truth.parameters, motor_time_constant=lag, transport_delay=delay)
    truth = replace(truth, parameters=own, frame="body", indexing="start")
    said: dict[str, Any] = {"propellers": len(names), "lag": lag, "delay": delay}
    content = settings.model_dump()
    tilt, way = rng.uniform(0, 0.02), rng.uniform(0, 2 * np.pi)
    content["effects"]["tilt_rad"] = (tilt * np.cos(way), tilt * np.sin(way))
    content["radio"] |= {"delay_s": None, "jitter_s": rng.uniform(0.001, 0.01)}
    content["radio"]["loss"] = rng.uniform(0, 0.05)
    content["motion_capture"] |= {
        "rate_hz": float(np.exp(rng.uniform(*np.log([60.0, 240.0])))),
        "position_noise_m": float(np.exp(rng.uniform(*np.log([5e-5, 5e-4])))),
        "yaw_noise_rad": float(np.exp(rng.uniform(*np.log([5e-4, 5e-3])))),
    }
    content["starts"] = read_twin_settings("paper:starts").starts.model_dump()
    weak = []
    if rng.random() < WEAK:
        share = float(rng.uniform(0.6, 0.9))
        weak.append({"motor": str(rng.choice(names)), "share": share})
    what, stated = rng.random(), _rough(truth.vehicle, rng)
    if what < DEAD:
        said["wrong"], motor = "dead", str(rng.choice(names))
        weak.append({"motor": motor, "share": 0.0})
    elif what < DEAD + REVERSED:
        said["wrong"], stated = "reversed", _turned(stated, int(rng.integers(len(names))))
    elif what < DEAD + REVERSED + SWAPPED:
        said["wrong"] = "swapped"
        stated = _swapped(stated, *rng.choice(len(names), 2, replace=False).tolist())
    spans = {"start_s": 0.0, "stop_s": ALWAYS}
    content["motors"]["weak"] = [one | spans for one in weak]
    said |= {"tilt_mrad": 1e3 * tilt, "weak": [one["share"] for one in weak]}
    said |= {key: content["motion_capture"][key] for key in ("rate_hz", "position_noise_m")}
    return truth, stated, TwinSettings.model_validate(content), said


def _rough(vehicle: Vehicle, rng: np.random.Generator) -> Vehicle:
    """Return a vehicle file with rough numbers."""
    content = vehicle.model_dump(mode="json")
    content["mass_kg"] *= rng.uniform(0.7, 1.3)
    nominal, factor = content["nominal"], float(np.exp(rng.uniform(*np.log([0.5, 2.0]))))
    nominal["thrust_N"] = (factor * np.asarray(nominal["thrust_N"])).tolist()
    nominal["inertia_kg_m2"] *= rng.uniform(0.7, 1.3)
    nominal |= {"motor_time_constant_s": 0.03, "transport_delay_s": 0.02}
    return Vehicle.model_validate(content)


def _turned(vehicle: Vehicle, motor: int) -> Vehicle:
    """State the opposite direction of a motor."""
    propellers = list(vehicle.propellers)
    direction = (propellers[motor].direction_deg + 180) % 360
    propellers[motor] = propellers[motor].model_copy(update={"direction_deg": direction})
    return vehicle.model_copy(update={"propellers": tuple(propellers)})


def _swapped(vehicle: Vehicle, one: int, other: int) -> Vehicle:
    """State two motors in each other's places."""
    places = [p.model_dump(exclude={"name"}) for p in vehicle.propellers]
    places[one], places[other] = places[other], places[one]
    new = [p.model_copy(update=x) for p, x in zip(vehicle.propellers, places, strict=True)]
    return vehicle.model_copy(update={"propellers": tuple(new)})


def true_model(truth: Model, settings: TwinSettings) -> Model:
    """Return the truth with the thrusts of its weak motors."""
    curves = np.array(truth.parameters.thrust)
    names = [name.removesuffix("_reverse") for name in truth.vehicle.propeller_names]
    for one in settings.motors.weak:
        curves[[name == one.motor for name in names]] *= one.share
    return replace(truth, parameters=replace(truth.parameters, thrust=curves))


def errors(model: Model | None, truth: Model) -> dict[str, Any] | None:
    """Return the errors of a model, or None without one."""
    if model is None:
        return None
    true = largest_acceleration(truth)
    off = np.abs(largest_acceleration(model) - true) / np.maximum(true, 1e-9)
    able = true > 0.05 * np.repeat([true[:4].max(), true[4:].max()], [4, 2])
    place = np.subtract(model.parameters.center_of_mass, truth.parameters.center_of_mass)
    lag = np.max(model.parameters.motor_time_constant) - np.max(
        truth.parameters.motor_time_constant
    )
    return {
        "acceleration": float(off[able].max()),
        "com_mm": 1e3 * float(np.hypot(*place)),
        "lag_ms": 1e3 * float(lag),
        "delay_ms": 1e3 * (model.transport_delay - truth.transport_delay),
    }


def commissioned(seed: int) -> dict[str, Any]:
    """Commission a drawn craft."""
    truth, stated, settings, said = draw(seed)
    twin = Twin(truth, settings, seed=seed)
    found = commission(twin, stated, table=settings.table, seed=seed)
    right = true_model(truth, settings)
    line = {"seed": seed, **said, "outcome": found.outcome, "flight_s": found.flight_s}
    line |= {"wall_s": found.wall_s, "steps": [[s.step, s.words] for s in found.steps]}
    line["findings"] = [finding.sentence for finding in found.findings]
    line["rail_m_s"] = max((speed for _, speed in twin.craft.contacts), default=0.0)
    line["contacts"] = [
        [one.name, time - one.span[0], speed]
        for time, speed in twin.craft.contacts
        for one in found.flights
        if speed > REPORTED and one.span[0] <= time <= one.span[1]
    ]
    line["errors"] = errors(found.model, right)
    if found.trusted and found.model is not None:
        line["settles"] = bool(settles(found.model, truth, settings, seed))
    return line


def fixed(seed: int) -> dict[str, Any]:
    """Fly the fixed sequence on a drawn craft."""
    truth, stated, settings, _ = draw(seed)
    twin = Twin(truth, settings, seed=seed)
    try:
        pilot = Excitation(nominal_model(stated), seed=seed, table=settings.table)
        fly(pilot, twin, FIXED)
        model = airpuck.identify(twin.recording(), "M3", vehicle=stated).model
    except InputError as error:
        return {"failed": str(error)}
    met = max((speed for _, speed in twin.craft.contacts), default=0.0)
    return {"rail_m_s": met, "errors": errors(model, true_model(truth, settings))}


def summary(lines: list[dict[str, Any]]) -> None:
    """Print the numbers of all draws."""
    trusted = [one for one in lines if one["outcome"] == "trusted"]
    print(f"{len(lines)} draws, {len(trusted)} trusted")
    for one in lines:
        if one["outcome"] != "trusted":
            print(f"  {one['seed']}: {one.get('wrong', '')} {one['findings'][:1]}")
    if not trusted:
        return
    flown = sorted(one["flight_s"] for one in trusted)
    print(f"flight: median {np.median(flown):.1f} s, 90 % {np.quantile(flown, 0.9):.1f} s")
    print(f"in all: median {np.median([one['wall_s'] for one in trusted]):.0f} s")
    print(f"false trust: {[one['seed'] for one in trusted if not one['settles']]}")
    print(f"rails met above 0.3 m/s: {[o['seed'] for o in lines if o['rail_m_s'] > 0.3]}")
    both = [one for one in trusted if one.get("fixed", {}).get("errors")]
    for key in ("acceleration", "com_mm", "lag_ms", "delay_ms"):
        own = [abs(one["errors"][key]) for one in trusted]
        other = [abs(one["fixed"]["errors"][key]) for one in both]
        tail = f"; fixed sequence {np.median(other):.3g} ({len(both)})" if other else ""
        print(f"{key}: median {np.median(own):.3g}, 90 % {np.quantile(own, 0.9):.3g}{tail}")


def main() -> None:
    """Run the draws that the file does not hold yet, then print the summary."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1, help="the first seed")
    parser.add_argument("--fixed", action="store_true", help="also fly the fixed sequence")
    parser.add_argument("--summary", action="store_true")
    given = parser.parse_args()
    kept = Kept(given.output)
    for seed in range(given.seed, given.seed + given.flights):
        if given.summary or kept.have(seed=seed):
            continue
        began = time.monotonic()
        line = commissioned(seed)
        if given.fixed:
            line["fixed"] = fixed(seed)
        kept.add(line)
        took = time.monotonic() - began
        print(f"{seed}: {line['outcome']} {line['findings'][:1]} {took:.0f} s", flush=True)
    summary(kept.lines)


if __name__ == "__main__":
    from one_line import run

    keep_compiled_programs()
    run(main)
