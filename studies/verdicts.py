"""Is a verdict right? Craft and recordings with flaws: identified, judged, and flown.

    OPENBLAS_NUM_THREADS=1 python studies/verdicts.py fly -o verdicts --seeds 10
    OPENBLAS_NUM_THREADS=1 python studies/verdicts.py judge -o verdicts --seeds 10

fly: in each situation the twin records excitation flights, a model is identified from one and the
controller designed from that model flies the true craft: with both laws and both estimators, from
rest to a set point half a metre and 1.5 rad away. A flight settles if the craft touches no rail
and stays within 2 cm and 0.1 rad of the set point for the last of 3 s; a model settles if all
four flights do. A model is learned from the first 60 % of a recording and evaluated on the rest.
Recordings too short for that are learned from and judged as a whole, as `identify` does.
Recordings, models and flights are kept in the folder, so an interrupted study resumes, and several
processes can share the work (`--first`).

judge: the verdict on each model, the table of verdicts against flights, the cases in which they
disagree, and how often the printed uncertainty of accelerations and response time holds. With
`--own`, each model is judged by what it was learned from.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import pickle
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from false_alarms import craft

from airpuck import InputError, evaluate, identify, preprocess, read_model
from airpuck.control.excitation import Excitation
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import default_tuning
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.flight.loop import fly
from airpuck.judgement.verdict import verdict
from airpuck.model.model_file import Model, nominal_model
from airpuck.recording.stream import Recording
from airpuck.twin.experiments import track
from airpuck.twin.plant import Plant, build_plant
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import Twin

#: Length of a recording and of a flight [s]; camera rate [Hz], half of the usual to halve the cost.
RECORDED, FLOWN, RATE = 24.0, 3.0, 120.0
#: Goal of the flights, from the origin; tolerance [m, rad]; time within it at the end [s].
GOAL, NEAR, STAYS = (0.45, 0.2, 1.5), (0.02, 0.02, 0.1), 1.0
#: Clearance below which a craft counts as touching a rail [m].
AT_RAIL = 1e-3
#: Controllers, in order of decreasing sensitivity to wrong models.
CONTROLLERS = [(law, estimator) for law in ("mpc", "lqr") for estimator in ("kalman", "actuation")]
#: Share of a recording that a model is learned from; it is evaluated on the rest. Shorter
#: recordings [s] are not divided: a verdict takes 4 s.
LEARNED, DIVIDED = 0.6, 10.0
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
        return vehicle.model_copy(update={"propellers": tuple(propellers)})

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


_PLANTS: dict[str, Plant] = {}


def plant(situation: Situation) -> Plant:
    """Return the simulated craft, compiled once for all situations that share it."""
    truth, settings = situation.truth(), situation.settings()
    key = truth.vehicle.model_dump_json() + settings.effects.model_dump_json()
    if key not in _PLANTS:
        _PLANTS[key] = build_plant(truth, settings)
    return _PLANTS[key]


def recorded(situation: Situation, seed: int, folder: Path) -> Recording:
    """Fly on the twin, or read what was flown; situations that only edit share recordings."""
    truth, settings = situation.truth(), situation.settings()
    what = [truth.vehicle.model_dump_json(), settings.model_dump_json(), situation.kind]
    key = hashlib.sha256(repr((what, situation.amplitude, situation.duration, seed)).encode())
    file = folder / f"recording-{key.hexdigest()[:16]}.pkl"
    if file.is_file():
        return pickle.loads(file.read_bytes())
    twin = Twin(truth, settings, seed=seed, plant=plant(situation))
    nominal = nominal_model(craft(situation.propellers).vehicle)
    if situation.kind == "hover":
        pilot: Any = TrackingController(nominal, SetPoint(0.0, 0.0, 0.0), table=settings.table)
    else:
        table = settings.table
        pilot = Excitation(nominal, amplitude=situation.amplitude, seed=seed, table=table)
    fly(pilot, twin, situation.duration, default_tuning().period_s)
    file.write_bytes(pickle.dumps(twin.recording()))
    return twin.recording()


def prepared(situation: Situation, seed: int, folder: Path) -> tuple[Trajectory, Trajectory]:
    """Preprocess a recording as its user would; return what to learn from, and what to judge on."""
    vehicle = situation.believed(craft(situation.propellers).vehicle)
    edited = situation.edit(recorded(situation, seed, folder))
    pose = edited["pose"]
    pose = replace(pose, values=pose.values * (situation.metre, situation.metre, 1.0))
    whole = preprocess(replace(edited, streams={**edited.streams, "pose": pose}), vehicle)
    if situation.duration < DIVIDED:
        return whole, whole
    return whole.slice(0.0, LEARNED), whole.slice(LEARNED, 1.0)


def identified(situation: Situation, seed: int, folder: Path) -> Model | str:
    """Identify, or read the stored model; if identification failed, return the message."""
    file = folder / f"model-{_name(situation)}-{seed}.toml"
    refused = file.with_suffix(".txt")
    if refused.is_file():
        return refused.read_text()
    if not file.is_file():
        try:
            fit = identify(prepared(situation, seed, folder)[0], situation.rung)
        except InputError as error:
            refused.write_text(str(error))
            return str(error)
        fit.model.save(file)
    try:
        return read_model(file)
    except InputError as error:  # A diverged fit has numbers that a model file rejects.
        return str(error)


def _name(situation: Situation) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in situation.name)


def settles(situation: Situation, model: Model, law: str, estimator: str, seed: int) -> bool:
    """Fly the true craft with the controller of a model."""
    truth, settings = situation.truth(), situation.settings()
    tuning = default_tuning().with_regulator(law).with_estimator(estimator)
    try:
        recording, _ = track(
            model,
            SetPoint(*GOAL),
            FLOWN,
            truth=truth,
            seed=1000 + seed,
            settings=settings,
            tuning=tuning,
            plant=plant(situation),
        )
    except InputError as error:  # A model from which no controller can be designed.
        print("    ", error, flush=True)
        return False
    pose = recording["pose"].values
    reach = np.array(settings.table.reach(truth.vehicle.radius_m))
    if (np.abs(pose[:, :2]) > reach - AT_RAIL).any():
        return False
    end = pose[-round(STAYS * settings.motion_capture.rate_hz) :] - GOAL
    end[:, 2] = (end[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return bool((np.abs(end) < NEAR).all())


def flown(situation: Situation, seed: int, folder: Path) -> dict[str, bool]:
    """Fly with each controller until one does not settle; or read how that ended."""
    file = folder / f"flight-{_name(situation)}-{seed}.json"
    if file.is_file():
        return json.loads(file.read_text())
    found = dict[str, bool]()
    model = identified(situation, seed, folder)
    if isinstance(model, Model):
        for law, estimator in CONTROLLERS:
            found[f"{law} {estimator}"] = settles(situation, model, law, estimator, seed)
            if not found[f"{law} {estimator}"]:
                break
    file.write_text(json.dumps(found))
    return found


def fly_all(folder: Path, seeds: range) -> None:
    """Record, identify and fly what is missing."""
    for seed in seeds:
        for situation in SITUATIONS:
            began = time.process_time()
            found = flown(situation, seed, folder)
            model = identified(situation, seed, folder)
            ended = model if isinstance(model, str) else "settles" if all(found.values()) else found
            spent = time.process_time() - began
            print(f"{seed} {situation.name:34s} {spent:5.1f} s  {ended}", flush=True)


@dataclass(frozen=True)
class Case:
    """A model that was judged and flown."""

    situation: str
    seed: int
    outcome: str
    settles: bool
    sentences: tuple[str, ...]
    #: Errors of the largest accelerations and the response time, in stated standard errors.
    errors: tuple[float, ...] = ()


def judged(situation: Situation, seed: int, folder: Path, own: bool) -> Case:
    """Judge a model on what it was not learned from, or on its own data."""
    model = identified(situation, seed, folder)
    if isinstance(model, str):
        return Case(situation.name, seed, "refused", False, (model,))
    settled = all(flown(situation, seed, folder).values())
    learned, rest = prepared(situation, seed, folder)
    own = own or rest is learned
    found = verdict(model, learned) if own else verdict(model, rest, evaluate(model, rest))
    errors: tuple[float, ...] = ()
    if found.acceleration_errors is not None and found.response_error is not None:
        truth = situation.truth()
        share = np.ones(truth.vehicle.n_propellers)
        for weak in situation.twin.get("motors", {}).get("weak", ()):
            share[truth.vehicle.propeller_names.index(weak["motor"])] = weak["share"]
        scaled = np.asarray(truth.parameters.thrust) * share[:, None]
        weaker = replace(truth, parameters=replace(truth.parameters, thrust=scaled))
        pushes = largest_acceleration(model)
        unit = np.repeat([situation.metre, 1.0], [4, 2])
        off = 1 - unit * largest_acceleration(weaker) / pushes
        errors = tuple((off / found.acceleration_errors).tolist())
    return Case(situation.name, seed, found.outcome, settled, found.sentences, errors)


def report(folder: Path, seeds: range, own: bool) -> None:
    """Print verdicts against flights, the cases in which they disagree, and coverage."""
    cases = []
    for situation in SITUATIONS:
        done = [k for k in seeds if (folder / f"flight-{_name(situation)}-{k}.json").is_file()]
        found = [judged(situation, seed, folder, own) for seed in done]
        counts = Counter((case.outcome, case.settles) for case in found)
        words = ", ".join(
            f"{count} {outcome} and {'settles' if settles else 'does not'}"
            for (outcome, settles), count in counts.items()
        )
        print(f"{situation.name:34s} {words}")
        cases += found
    print()
    outcomes = sorted({case.outcome for case in cases})
    print(f"{'':24s} settles  does not")
    for outcome in outcomes:
        row = [sum(c.outcome == outcome and c.settles == s for c in cases) for s in (True, False)]
        print(f"{outcome:24s} {row[0]:7d} {row[1]:9d}")
    print()
    for case in cases:
        if (case.outcome == "trusted") != case.settles:
            print(f"{case.situation}, seed {case.seed}: {case.outcome}, settles: {case.settles}")
            print("    " + "\n    ".join(case.sentences[:3]))
    errors = np.array([e for case in cases if case.outcome == "trusted" for e in case.errors])
    if len(errors):
        inside = 100 * np.mean(np.abs(errors) < 1.96)
        print(
            f"{inside:.1f} % of {len(errors)} largest accelerations of trusted models lie within "
            "1.96 stated standard errors"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=["fly", "judge"])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=10, help="number of seeds")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--own", action="store_true", help="judge by the data learned from")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    seeds = range(options.first, options.first + options.seeds)
    if options.part == "fly":
        fly_all(options.output, seeds)
    else:
        report(options.output, seeds, options.own)


if __name__ == "__main__":
    from one_line import run

    run(main)
