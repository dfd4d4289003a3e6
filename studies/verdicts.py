"""Is a verdict right? Craft and recordings with flaws: identified, judged, and flown.

    OPENBLAS_NUM_THREADS=1 python studies/verdicts.py -o verdicts.jsonl --flights 400 --seed 1

Every second flight is one of the situations below; the others draw a healthy craft (3 to 8
propellers, 0.1 to 15 kg), cameras (0.05 to 0.8 mm, 0.5 to 15 mrad, 50 to 240 Hz) and, for every
second one, stamps that are rounded to a millisecond. The twin records an excitation flight,
`airpuck.study` judges it, and the controller that airpuck designs from the model by default flies
the true craft: from rest to a set point half a metre and 1.5 rad away. A model settles if the craft
touches no rail and stays within 2 cm and 0.1 rad (and four standard deviations of the cameras'
noise) of the set point for the last second.

Each flight appends a line of JSON to the file; an interrupted study resumes. The summary counts
false trust (trusted, but the model does not settle), false distrust (nothing is wrong, the model
settles, but is not trusted), and parameters beyond three stated bars where `parameters.right` is
true. `--summary` only reads the file.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from false_alarms import craft
from kept import Kept

import airpuck
from airpuck import InputError, preprocess
from airpuck.control.authority import weakest_effort
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import tuning_for
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.presentation import largest_acceleration, main_quantities
from airpuck.flight.loop import fly
from airpuck.judgement.rehearsal import GOAL, NEAR, time_there
from airpuck.model.model_file import Model, nominal_model
from airpuck.model.tolerances import bar
from airpuck.recording.stream import Recording
from airpuck.twin.experiments import excite, track
from airpuck.twin.radio import as_received
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import Twin

#: Length of a recording [s]; camera rate [Hz], half of the usual to halve the cost.
RECORDED, RATE = 24.0, 120.0
#: Time within the tolerance at the end [s].
STAYS = 1.0
#: Clearance below which a craft counts as touching a rail [m].
AT_RAIL = 1e-3
#: Effort of a drawn craft in its weakest motion, relative to its largest linear acceleration.
_ABLE = 0.2
#: Longer than any flight [s].
ALWAYS = 1e4
FOOT_M = 0.3048


@dataclass(frozen=True)
class Situation:
    """Flaws of a craft, of its recording, or of its user's beliefs; none by default."""

    name: str
    propellers: int = 6
    #: Updates of the twin's settings by section: of the recording, and of the flight.
    twin: dict[str, Any] = field(default_factory=dict)
    #: From the vehicle file to the true craft.
    built: Callable[[Vehicle], Vehicle] = lambda vehicle: vehicle
    #: From the true craft to its user's vehicle file.
    believed: Callable[[Vehicle], Vehicle] = lambda vehicle: vehicle
    #: From the true recording to the recording used.
    edit: Callable[[Recording], Recording] = lambda recording: recording
    rung: str = "M3"
    kind: Literal["excitation", "hover"] = "excitation"
    amplitude: float = 0.7
    duration: float = RECORDED
    #: A metre in the recording's unit: no recording reveals it, and accelerations are stated in it.
    metre: float = 1.0

    @property
    def exact(self) -> bool:
        """Whether recording and vehicle file state the truth: parameters can be compared."""
        usual = Situation.built, Situation.believed, Situation.edit, Situation.metre
        own = self.built, self.believed, self.edit, self.metre
        return own == usual and "motors" not in self.twin

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong, so that a model that settles should be trusted."""
        usual = self.kind == "excitation" and self.amplitude == 0.7 and self.duration == RECORDED
        return self.exact and usual and self.rung in ("M3", "M4")

    def truth(self) -> Model:
        """Return the true craft."""
        model = craft(self.propellers)
        return replace(model, vehicle=self.built(model.vehicle))

    def settings(self) -> TwinSettings:
        """Return the twin's settings, in recordings and in flights."""
        return _settings(json.dumps(self.twin, sort_keys=True))


@cache
def _settings(updates: str) -> TwinSettings:
    packaged = default_twin_settings().model_dump()
    packaged["motion_capture"]["rate_hz"] = RATE
    packaged["on_board"]["rate_hz"] = 0.0
    for section, values in json.loads(updates).items():
        packaged[section].update(values)
    return TwinSettings.model_validate(packaged)


def clock(offset: float, recorder: bool = False) -> Callable[[Recording], Recording]:
    """Stamp poses late by a time [s]; `recorder`: its arrival times stay right."""

    def edit(recording: Recording) -> Recording:
        pose, by = recording["pose"], round(offset * 1e9)
        received = pose.received_ns if recorder else pose.received_ns + by
        moved = replace(pose, stamp_ns=pose.stamp_ns + by, received_ns=received)
        return replace(recording, streams={**recording.streams, "pose": moved})

    return edit


def columns_swapped(first: int, second: int) -> Callable[[Recording], Recording]:
    """Log two motors under each other's name."""

    def edit(recording: Recording) -> Recording:
        command = recording["command"]
        order = np.arange(command.values.shape[1])
        order[[first, second]] = second, first
        swapped = replace(command, values=command.values[:, order])
        return replace(recording, streams={**recording.streams, "command": swapped})

    return edit


def commands_times(factor: float) -> Callable[[Recording], Recording]:
    """Log commands in another unit."""

    def edit(recording: Recording) -> Recording:
        command = recording["command"]
        scaled = replace(command, values=command.values * factor)
        return replace(recording, streams={**recording.streams, "command": scaled})

    return edit


def wired(first: int, second: int) -> Callable[[Vehicle], Vehicle]:
    """Plug two motors into each other's sockets."""

    def build(vehicle: Vehicle) -> Vehicle:
        propellers = list(vehicle.propellers)
        places = [propellers[k].model_dump(exclude={"name"}) for k in (second, first)]
        for k, place in zip((first, second), places, strict=True):
            propellers[k] = propellers[k].model_copy(update=place)
        # A pair of which one is moved no longer opposes itself, and cannot be excited as a pair.
        both = {propellers[first].name, propellers[second].name}
        pairs = tuple(pair for pair in vehicle.pairs if len(both & set(pair)) != 1)
        return vehicle.model_copy(update={"propellers": tuple(propellers), "pairs": pairs})

    return build


def heavier(mass: float = 1.0, inertia: float = 1.0) -> Callable[[Vehicle], Vehicle]:
    """Write a wrong mass or inertia into the vehicle file."""

    def believe(vehicle: Vehicle) -> Vehicle:
        nominal = vehicle.nominal
        turned = nominal.model_copy(update={"inertia_kg_m2": nominal.inertia_kg_m2 * inertia})
        return vehicle.model_copy(update={"mass_kg": vehicle.mass_kg * mass, "nominal": turned})

    return believe


def failing(share: float) -> dict[str, Any]:
    """Return settings in which a motor always gives a share of its thrust."""
    weak = {"motor": "motor_b_1", "start_s": 0.0, "stop_s": ALWAYS, "share": share}
    return {"motors": {"weak": [weak]}}


SITUATIONS = (
    Situation("healthy, M3"),
    Situation("poses 20 ms late", edit=clock(0.02)),
    Situation("poses 50 ms late", edit=clock(0.05)),
    Situation("poses 100 ms late", edit=clock(0.1)),
    Situation("poses 300 ms late", edit=clock(0.3)),
    Situation("poses 60 ms late, recorder right", edit=clock(0.06, recorder=True)),
    Situation("poses 20 ms early", edit=clock(-0.02)),
    Situation("poses 50 ms early", edit=clock(-0.05)),
    Situation("poses 300 ms early", edit=clock(-0.3)),
    Situation("two motors wired wrongly", built=wired(0, 2)),
    Situation("a pair wired wrongly", built=wired(0, 1)),
    Situation("two columns swapped", edit=columns_swapped(1, 4)),
    Situation("mass 1.5 times too high", believed=heavier(mass=1.5)),
    Situation("inertia 2 times too high, M2", believed=heavier(inertia=2.0), rung="M2"),
    Situation("too simple: M2", rung="M2"),
    Situation("too simple: M1", rung="M1"),
    Situation("too simple: quadratic", rung="quadratic"),
    Situation("hovering only", kind="hover"),
    Situation("weak excitation", amplitude=0.08),
    Situation("five seconds", duration=5.0),
    Situation("one dead motor", twin=failing(0.0)),
    Situation("a worn propeller", twin=failing(0.6)),
    Situation("tilted table", twin={"effects": {"tilt_rad": (0.015, 0.01)}}),
    Situation("drag", twin={"effects": {"drag_linear_1_s": 0.8, "spin_drag_linear_1_s": 1.5}}),
    Situation(
        "dropped frames",
        twin={"motion_capture": {"dropped": 0.3, "gaps_s": [(5, 5.4), (12, 12.3), (13, 13.6)]}},
    ),
    Situation("poses in feet", metre=1 / FOOT_M),
    Situation("positions 1.5 times too large", metre=1.5),
    Situation("commands logged by half", edit=commands_times(0.5)),
    Situation("poses at 60 Hz", twin={"motion_capture": {"rate_hz": 60.0}}),
    Situation("poses at 30 Hz", twin={"motion_capture": {"rate_hz": 30.0}}),
    Situation("radio with jitter and loss", twin={"radio": {"jitter_s": 0.015, "loss": 0.1}}),
    Situation(
        "noisy cameras",
        twin={"motion_capture": {"position_noise_m": 1e-3, "yaw_noise_rad": 0.01}},
    ),
    Situation("battery sags", twin={"effects": {"battery_sag_1_s": 0.006}}),
    Situation("healthy, M4", rung="M4"),
    Situation("healthy, 4 propellers", propellers=4),
    Situation("healthy, 8 propellers", propellers=8),
)


def drawn(rng: np.random.Generator) -> tuple[Model, TwinSettings]:
    """Draw a healthy craft that can hold itself, and its cameras."""
    count, mass = int(rng.integers(3, 9)), float(np.exp(rng.uniform(*np.log([0.1, 15.0]))))
    while True:
        model = _craft(rng, count, mass)
        if weakest_effort(model) > _ABLE * largest_acceleration(model)[:4].max():
            break
    noise = np.exp(rng.uniform(np.log([5e-5, 5e-4]), np.log([8e-4, 1.5e-2])))
    capture = {
        "rate_hz": float(np.exp(rng.uniform(*np.log([50.0, 240.0])))),
        "position_noise_m": float(noise[0]),
        "yaw_noise_rad": float(noise[1]),
        "stamp_step_s": 1e-3 * int(rng.integers(2)),
    }
    room = 2 * model.vehicle.radius_m
    table = {"length_m": 2.2 + room, "width_m": 1.1 + room}
    return model, _settings(json.dumps({"motion_capture": capture, "table": table}))


def _craft(rng: np.random.Generator, count: int, mass: float) -> Model:
    """Draw a craft: propellers on a circle that push along it, roughly, alternately."""
    radius = 0.08 * (mass / 0.21) ** (1 / 3)
    angles = np.radians(np.arange(count) * 360 / count + rng.uniform(-10, 10, count))
    turned = np.where(np.arange(count) % 2, 90.0, 270.0) + rng.uniform(-40, 40, count)
    push = mass * float(np.exp(rng.uniform(*np.log([0.5, 3.5]))))
    propellers = [
        {
            "name": f"m{k + 1}",
            "position_m": (0.75 * radius * np.cos(angle), 0.75 * radius * np.sin(angle)),
            "direction_deg": float((np.degrees(angle) + turned[k]) % 360),
            # Three that push one way only cannot hold a craft.
            **({"reverse": 0.8} if count < 4 else {}),
        }
        for k, angle in enumerate(angles)
    ]
    nominal = {
        "thrust_N": (0.0, push),
        "inertia_kg_m2": 0.5 * mass * radius**2,
        "motor_time_constant_s": float(rng.uniform(0.015, 0.06)),
        "transport_delay_s": float(rng.uniform(0.01, 0.035)),
    }
    file = {"name": f"{count} propellers", "mass_kg": mass, "radius_m": radius, "pairs": []}
    file |= {"command_min": 0.05, "propellers": propellers, "nominal": nominal}
    model = nominal_model(Vehicle.model_validate(file))
    own = model.parameters
    curve = np.asarray(own.thrust) * np.exp(0.02 * rng.normal(size=(len(own.thrust), 1)))
    true = replace(
        own,
        thrust=curve @ [[1.0, 0.0], [0.15, 0.85]],
        inertia=own.inertia * float(rng.uniform(0.8, 1.25)),
        motor_time_constant=own.motor_time_constant * float(rng.uniform(0.8, 1.25)),
        angle_offset=float(0.02 * rng.normal()),
        center_of_mass=0.01 * radius * rng.normal(size=2),
    )
    return replace(model, parameters=true)


def recorded(situation: Situation, truth: Model, settings: TwinSettings, seed: int) -> Recording:
    """Fly on the twin; the pilot knows only the nominal craft."""
    nominal = nominal_model(truth.vehicle)
    if situation.kind == "excitation":
        return excite(
            truth, situation.duration, seed, amplitude=situation.amplitude, settings=settings
        )
    twin, tuning = Twin(truth, settings, seed=seed), tuning_for(nominal)
    pilot = TrackingController(nominal, SetPoint(0.0, 0.0, 0.0), tuning, table=settings.table)
    fly(pilot, twin, situation.duration, tuning.period_s)
    return twin.recording()


def prepared(situation: Situation, recording: Recording, vehicle: Vehicle) -> Trajectory:
    """Preprocess a recording as its user would."""
    edited = situation.edit(recording)
    pose = edited["pose"]
    pose = replace(pose, values=pose.values * (situation.metre, situation.metre, 1.0))
    streams = {**edited.streams, "pose": pose}
    return preprocess(replace(edited, streams=streams), situation.believed(vehicle))


def settles(model: Model, truth: Model, settings: TwinSettings, seed: int) -> bool:
    """Fly the true craft with the controller that airpuck designs from a model by default."""
    # Slow craft get the time that the verdict's own flights give them.
    arrives = time_there(model)
    try:
        recording = track(
            model,
            SetPoint(*GOAL),
            arrives + STAYS,
            truth=truth,
            seed=1000 + seed,
            settings=settings,
        ).recording
    except InputError:  # A model from which no controller can be designed.
        return False
    pose = recording["pose"].values
    reach = np.array(settings.table.reach(truth.vehicle.radius_m))
    if (np.abs(pose[:, :2]) > reach - AT_RAIL).any():
        return False
    end = pose[-round(STAYS * settings.motion_capture.rate_hz) :] - GOAL
    end[:, 2] = (end[:, 2] + np.pi) % (2 * np.pi) - np.pi
    noise = settings.motion_capture
    blur = 4 * np.array([noise.position_noise_m] * 2 + [noise.yaw_noise_rad])
    return bool((np.abs(end) < NEAR + blur).all())


def blurred(vehicle: Vehicle, rng: np.random.Generator) -> Vehicle:
    """Return a vehicle file with errors within its tolerances."""
    propellers = []
    for one in vehicle.propellers:
        place = np.array(one.position_m) + vehicle.position_error_m * rng.normal(size=2)
        angle = one.direction_deg + vehicle.direction_error_deg * float(rng.normal())
        update = {"position_m": tuple(place.tolist()), "direction_deg": angle}
        propellers.append(one.model_copy(update=update))
    mass = vehicle.mass_kg * (1 + vehicle.mass_error * float(rng.normal()))
    return vehicle.model_copy(update={"propellers": tuple(propellers), "mass_kg": mass})


def beyond(model: Model, truth: Model, *, exact: bool = False) -> dict[str, float]:
    """Return the errors of the main quantities, in stated bars; without tolerances if `exact`."""
    named = {q.label: q for q in main_quantities(truth, speeds=(0.5, 1.0))}
    found = {}
    for quantity in main_quantities(model, speeds=(0.5, 1.0)):
        other = named.get(quantity.label)
        if other is None or not (quantity.used(model) and quantity.learned(model)):
            continue
        value = quantity.value
        one = float(model.standard_error(value) if exact else bar(model, value))
        if np.isfinite(one) and one > 0:
            found[quantity.label] = float(value(model) - other.value(truth)) / one
    return found


def judged(flight: int, seed: int) -> dict[str, Any]:
    """Record, study and fly once."""
    began, rng = time.process_time(), np.random.default_rng([seed, flight])
    own = int(rng.integers(2**31))
    if drawn_file := flight % 2 == 1:
        situation = Situation("drawn")
        model, settings = drawn(rng)
    else:
        situation = SITUATIONS[flight // 2 % len(SITUATIONS)]
        model, settings = situation.truth(), situation.settings()
    noise = settings.motion_capture.model_dump(include={"rate_hz", "position_noise_m"})
    line: dict[str, Any] = {"flight": flight, "seed": seed, "situation": situation.name, **noise}
    vehicle = craft(situation.propellers).vehicle
    if drawn_file:
        vehicle = blurred(model.vehicle, rng) if rng.integers(2) else model.vehicle
    line |= {"propellers": len(vehicle.propellers), "mass_kg": vehicle.mass_kg}
    line["sound"] = situation.sound
    try:
        trajectory = prepared(situation, recorded(situation, model, settings, own), vehicle)
        rung = None if situation.rung == "M3" else situation.rung
        found = airpuck.study(trajectory, model=rung)
    except InputError as error:
        return line | {"outcome": "refused", "trusted": False, "why": [str(error)]}
    said = found.verdict
    line |= {"model": found.model.name, "outcome": said.outcome, "trusted": said.trusted}
    line |= {"margins": {law: one.margin for law, one in said.controller.items()}}
    line |= {"right": said.parameters.right, "why": [one.sentence for one in said.findings]}
    line["settles"] = settles(found.model, model, settings, own)
    truth = as_received(model, settings, tuning_for(model).period_s)
    line["bars"] = beyond(found.model, truth) if situation.exact else {}
    return line | {"cpu_s": round(time.process_time() - began, 1)}


def summary(lines: list[dict[str, Any]]) -> None:
    """Print counts, and the flights whose verdict is wrong."""
    done = [line for line in lines if line["outcome"] != "refused"]
    print(f"{len(lines)} flights, {len(lines) - len(done)} refused")
    print(f"{'':24s} settles  does not")
    for outcome in sorted({line["outcome"] for line in done}):
        row = [sum(o["outcome"] == outcome and o["settles"] == s for o in done) for s in (1, 0)]
        print(f"{outcome:24s} {row[0]:7d} {row[1]:9d}")
    trust = [line for line in done if line["trusted"] and not line["settles"]]
    good = [line for line in done if line["settles"] and line["sound"]]
    distrust = [line for line in good if not line["trusted"]]
    print(f"false trust {len(trust)} of {sum(line['trusted'] for line in done)} trusted models")
    print(f"false distrust {len(distrust)} of {len(good)} sound models that settle")
    right = [line for line in done if line["right"]]
    bars = [abs(z) for line in right for z in line["bars"].values()]
    print(
        f"parameters right in {len(right)}: {sum(z > 3 for z in bars)} of {len(bars)} beyond 3 bars"
    )
    for title, wrong in (("false trust", trust), ("false distrust", distrust)):
        for line in wrong:
            print(f"{title}: flight {line['flight']}, {line['situation']}: {line['why'][:2]}")
    for line in right:
        far = {label: round(z, 1) for label, z in line["bars"].items() if abs(z) > 3}
        if far:
            print(f"beyond 3 bars: flight {line['flight']}, {line['situation']}: {far}")


def resumed(
    judge: Callable[[int, int], dict[str, Any]], summarise: Callable[[list[dict[str, Any]]], None]
) -> None:
    """Run the flights that the file lacks, append a line for each, and summarise all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("-o", "--output", type=Path, required=True, help="file of JSON lines")
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first flight")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--summary", action="store_true", help="only summarise the file")
    options = parser.parse_args()
    kept = Kept(options.output)
    for flight in range(options.first, options.first + options.flights):
        if not options.summary and not kept.have(flight=flight, seed=options.seed):
            kept.add(judge(flight, options.seed))
            print(json.dumps(kept.lines[-1]), flush=True)
    summarise(kept.lines)


def main() -> None:
    resumed(judged, summary)


if __name__ == "__main__":
    from one_line import run

    run(main)
