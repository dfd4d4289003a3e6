"""Does the preflight check find faults? Pulses on the twin, with known faults.

    python studies/preflight_found.py --flights 40

Every flight is the six seconds of `airpuck preflight`, from another pose and with other noise, on
the packaged twin (radio jitter 7 ms, noise of the cameras). It is judged with the published M3,
which is its truth; order and signs also with nominal values, as before a craft's first flight.

No pulse reacts to a pose, so faults of order, signs, frame, units or clocks are put into the
recorded numbers; a stopped or weak motor is flown. A fault counts as found if the right words name
the right things and nothing else is called wrong. Prints how many were found, and the accuracy of
thrust and delay.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from one_line import run

from airpuck.flight.loop import fly
from airpuck.flight.preflight import Preflight, judge_pulses
from airpuck.flight.pulses import PulseTest
from airpuck.model.model_file import Model, nominal_model, published_model
from airpuck.twin.plant import Plant, build_plant
from airpuck.twin.settings import Motors, Weakness, default_twin_settings
from airpuck.twin.twin import Twin

MODEL = published_model("M3")
#: Model known before the first identification.
NOMINAL = nominal_model(MODEL.vehicle)
NAMES = MODEL.vehicle.propeller_names
#: Faults of poses, by the words expected in the report.
FRAMES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "yaw has the wrong sign": lambda pose: pose * [1, 1, -1],
    "axis of the position has the wrong sign": lambda pose: pose * [1, -1, 1],
    "seen from below": lambda pose: pose * [1, -1, -1],
    "x and y are exchanged": lambda pose: pose[:, [1, 0, 2]],
    "turned by -90 degrees": lambda pose: np.add(pose, [0, 0, np.pi / 2]),
}
UNITS = {"degrees": [1, 1, 180 / np.pi], "centimetres": [100, 100, 1], "millimetres": [1e3, 1e3, 1]}
WEAK, LATE, FAR_TOO_LATE = 0.6, 0.015, 0.06


@dataclass(frozen=True)
class Case:
    """A fault, and whether it was found.

    Attributes
    ----------
    kind : str
        Kind of fault.
    found : bool
        Whether it was named, and nothing else called wrong.
    """

    kind: str
    found: bool


@dataclass(frozen=True)
class Pulses:
    """A test that was flown: times and values of poses and commands."""

    time: np.ndarray
    pose: np.ndarray
    command_time: np.ndarray
    command: np.ndarray

    def judged(self, model: Model = MODEL) -> Preflight:
        """Judge it."""
        return judge_pulses(model, self.time, self.pose, self.command_time, self.command)


def flown(seed: int, plant: Plant, weak: Weakness | None = None) -> Pulses:
    """Fly the pulses, from a pose near the middle."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(-0.1, 0.1, 2)
    settings = default_twin_settings()
    if weak is not None:
        settings = settings.model_copy(update={"motors": Motors(weak=(weak,))})
    pose = (float(x), float(y), float(random.uniform(-np.pi, np.pi)))
    twin, pilot = Twin(MODEL, settings, seed=seed, pose=pose, plant=plant), PulseTest(MODEL.vehicle)
    fly(pilot, twin, pilot.duration)
    time, poses = map(np.array, zip(*pilot.poses, strict=True))
    command_time, commands = map(np.array, zip(*pilot.sent_commands, strict=True))
    return Pulses(time, poses, command_time, commands)


def told(found: Preflight, verdict: str) -> dict[str, str]:
    """Return the checks with a given verdict, and their words."""
    return {check.name: check.words for check in found.checks if check.verdict == verdict}


def cases(seed: int, healthy: Pulses, plant: Plant) -> Iterator[Case]:
    """Put each fault into a healthy test; motors are drawn at random."""
    random = np.random.default_rng(seed)
    i, j = (int(k) for k in random.choice(len(NAMES), 2, replace=False))

    order = np.arange(len(NAMES))
    order[[i, j]] = order[[j, i]]
    for model, by in ((MODEL, ""), (NOMINAL, ", nominal values")):
        wrong = told(replace(healthy, command=healthy.command[:, order]).judged(model), "wrong")
        partners = {NAMES[i]: NAMES[j], NAMES[j]: NAMES[i]}
        right = wrong.keys() == partners.keys()
        right = right and all(f"acts like {partners[name]}" in wrong[name] for name in partners)
        yield Case(f"two motors swapped{by}", right)

        thrust = np.array(model.parameters.thrust)
        thrust[i] *= -1
        other = replace(model, parameters=replace(model.parameters, thrust=thrust))
        wrong = told(healthy.judged(other), "wrong")
        right = list(wrong) == [NAMES[i]] and "pushes the other way" in wrong[NAMES[i]]
        yield Case(f"a propeller spins the wrong way{by}", right)

    for words, change in FRAMES.items():
        wrong = told(replace(healthy, pose=change(healthy.pose)).judged(), "wrong")
        right = list(wrong) == ["pose frame"] and words in wrong["pose frame"]
        yield Case(f"pose frame: {words}", right)
    for unit, factors in UNITS.items():
        wrong = told(replace(healthy, pose=healthy.pose * factors).judged(), "wrong")
        yield Case(f"pose in {unit}", list(wrong) == ["units"] and f"in {unit}" in wrong["units"])

    late = replace(healthy, time=healthy.time + LATE).judged()
    right = late.ready and "transport delay" in told(late, "look")
    yield Case(f"delay {1e3 * LATE:.0f} ms longer: told", right)
    wrong = told(replace(healthy, time=healthy.time + FAR_TOO_LATE).judged(), "wrong")
    yield Case(
        f"delay {1e3 * FAR_TOO_LATE:.0f} ms longer: refused", list(wrong) == ["transport delay"]
    )

    for kind, share in (("a motor stands", 0.0), (f"a motor gives {100 * WEAK:.0f} %", WEAK)):
        weak = Weakness(motor=NAMES[i], start_s=0.0, stop_s=99.0, share=share)
        found = flown(seed, plant, weak).judged()
        if share:
            right = found.ready and list(told(found, "look")) == [NAMES[i]]
        else:
            wrong = told(found, "wrong")
            right = list(wrong) == [NAMES[i]] and "does nothing" in wrong[NAMES[i]]
        yield Case(kind, right)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=40)
    options = parser.parse_args()
    plant = build_plant(MODEL)
    counts: dict[str, list[bool]] = {}
    strength, delay = [], []
    for seed in range(options.flights):
        healthy = flown(seed, plant)
        found = healthy.judged()
        strength.append(found.strength)
        delay.append(found.delay)
        counts.setdefault("healthy: ready", []).append(found.ready)
        counts.setdefault("healthy: nothing to look at", []).append(not told(found, "look"))
        ready = healthy.judged(NOMINAL).ready
        counts.setdefault("healthy: ready, nominal values", []).append(ready)
        for case in cases(seed, healthy, plant):
            counts.setdefault(case.kind, []).append(case.found)
    for kind, each in counts.items():
        print(f"{kind:52s} {sum(each):3d} of {len(each)}")
    share, late = np.array(strength), 1e3 * (np.array(delay) - MODEL.transport_delay)
    print(
        f"strength of a motor: {100 * share.mean():.0f} % of the model's, standard deviation "
        f"{100 * share.std():.0f} %, from {100 * share.min():.0f} to {100 * share.max():.0f} %"
    )
    print(
        f"delay less the model's: {late.mean():+.1f} ms, standard deviation {late.std():.1f} ms, "
        f"from {late.min():+.1f} to {late.max():+.1f} ms"
    )


if __name__ == "__main__":
    run(main)
