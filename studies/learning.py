"""Compare three controllers: learning motors and delay, not learning, and knowing the truth.

    OPENBLAS_NUM_THREADS=1 python studies/learning.py -o learning.jsonl --flights 100

Each flight follows a circle for 12 s, then set points that are drawn at random, 2 s each. The craft
is the paper's M3, or it changes: the changes are in `changes`. The same flights are flown by the
Kalman filter, by the learning estimator, and with the changed model (`knows`, where the change is
there from the beginning). Each line of the file is one flight: the root mean square distance from
the circle from 2 s after the change on, the largest overshoot over set points, the largest distance
in the last half second of one, the fastest contact with a rail, and for `learning` how many of the
final intervals (95 %) contain the truth, and the errors of drag, offset of the centre of mass and
slope. An interrupted study resumes; `--summary` only reads the file.

With `--disturbed` the accelerations that the filter expects act on the craft, too, and only
`learning` flies, in a file of its own: are the intervals as wide as they should be?
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from kept import Kept

from airpuck import SetPoints, TrackingController, Twin, fly
from airpuck.control.reference import Target
from airpuck.control.tuning import default_tuning, tuning_for
from airpuck.estimate.estimator import BEYOND
from airpuck.model.model_file import Model, published_model
from airpuck.twin.radio import as_received
from airpuck.twin.settings import Effects, Motors, TwinSettings, Weakness, default_twin_settings

MODEL = replace(published_model("M3"), frame="body", indexing="start")
#: Duration of the circle, and of each set point; when a motor fails, and when errors count [s].
CIRCLE, DWELL, FAILS, COUNTS = 12.0, 2.0, 4.0, 6.0
#: Number of set points.
POINTS = 6
ESTIMATORS = ("kalman", "learning", "knows")
#: With `--disturbed`: time between pushes, and for which a wandering acceleration lasts [s]. Its
#: spectrum is then flat, as the filter finds it in real flights below 0.5 Hz: 0.1 m/s²/√Hz.
PUSHED, WANDERS = 0.01, 0.5


class Disturbed(Twin):
    """A twin with the accelerations that the filter expects: white ones, and ones that wander."""

    def __init__(self, *given: Any, seed: int) -> None:
        super().__init__(*given, seed=seed)
        noise = default_tuning().estimation.noise
        self._white, self._driving = np.array(noise.acceleration), np.array(noise.disturbance)
        self._random, self._wandering = np.random.default_rng([91, seed]), np.zeros(3)

    def wait_until(self, time: float) -> list[Any]:
        """Simulate until a time, with a push every 10 ms."""
        seen = []
        while self.now < time:
            h = min(PUSHED, time - self.now)
            seen += super().wait_until(self.now + h)
            shocks = math.sqrt(h) * self._random.standard_normal((2, 3))
            # A random walk would leave the table; this one forgets.
            self._wandering += self._driving * shocks[0] - h / WANDERS * self._wandering
            state = self.craft.state.copy()
            state[3:6] += h * self._wandering + self._white * shocks[1]
            self.craft.state = state
        return seen


class Circle:
    """A circle of 0.3 m around the middle, once in 4 s, with a fixed yaw."""

    def at(self, now: float, ahead: float) -> Target:
        """Return the target; see `airpuck.Reference`."""
        rate = 2 * math.pi / 4
        cos, sin = math.cos(rate * (now + ahead)), math.sin(rate * (now + ahead))
        place, motion = 0.3 * np.array([cos, sin, 0.0]), 0.3 * rate * np.array([-sin, cos, 0.0])
        return Target(np.append(place, motion), -(rate**2) * place)


class Change(NamedTuple):
    """What the craft has become: its model, the twin's settings, and its motors at the end."""

    truth: Model
    settings: TwinSettings
    gains: np.ndarray
    later_s: float = 0.0
    known: bool = True
    #: Drag [1/s], offset of the centre of mass [m] and slope [rad], as in `BEYOND`.
    body: tuple[float, ...] = (0.0,) * 5


def changes(seed: int) -> dict[str, Change]:
    """Return all changes; the seed determines which motor fails, and the body's numbers."""
    motor, delay = seed % 6, MODEL.transport_delay
    usual = default_twin_settings().with_usual_delay(delay)
    ones = np.ones(6)
    # Packets do not overtake each other, so jitter makes the mean delay longer.
    waits = as_received(MODEL, usual, default_tuning().period_s).transport_delay - delay

    def fails(share: float) -> Change:
        name = MODEL.vehicle.columns[motor]
        weak = Weakness(motor=name, start_s=FAILS, stop_s=1e3, share=share)
        settings = usual.model_copy(update={"motors": Motors(weak=(weak,))})
        gains = ones.copy()
        gains[motor] = share
        return Change(MODEL, settings, gains, waits, known=False)

    def thrust(factor: float, later: float = 0.0) -> Change:
        parameters = replace(MODEL.parameters, thrust=factor * MODEL.parameters.thrust)
        truth = replace(MODEL, parameters=parameters).with_delay(delay + later + waits)
        settings = default_twin_settings().with_usual_delay(delay + later)
        return Change(truth, settings, factor * ones, later + waits)

    def body() -> Change:
        random = np.random.default_rng([53, seed])
        drag, *offset = random.uniform([0.0, -2e-3, -2e-3], [0.3, 2e-3, 2e-3]).tolist()
        slope = random.uniform(-5e-3, 5e-3, 2).tolist()
        center = MODEL.parameters.center_of_mass + np.array(offset)
        truth = replace(MODEL, parameters=replace(MODEL.parameters, center_of_mass=center))
        effects = Effects.model_validate({"drag_linear_1_s": drag, "tilt_rad": slope})
        settings = usual.model_copy(update={"effects": effects})
        return Change(truth, settings, ones, waits, known=False, body=(drag, *offset, *slope))

    sag = 0.27 / 45
    battery = usual.model_copy(update={"effects": Effects(battery_sag_1_s=sag)})
    return {
        "none": thrust(1.0),
        "battery": Change(
            MODEL, battery, (1 - sag * (CIRCLE + POINTS * DWELL)) * ones, known=False
        ),
        "motor at 60 %": fails(0.6),
        "mass + 20 %": thrust(1 / 1.2),
        "delay + 15 ms": thrust(1.0, 0.015),
        "thrust x 0.7": thrust(0.7),
        "thrust x 1.2, + 20 ms": thrust(1.2, 0.02),
        "motor dead": fails(0.0),
        "drag, offset, slope": body(),
    }


def flown(
    change: Change, law: str, estimator: str, seed: int, disturbed: bool = False
) -> dict[str, Any]:
    """Fly a circle and set points."""
    random = np.random.default_rng([47, seed])
    model = change.truth if estimator == "knows" else MODEL
    kind = "kalman" if estimator == "knows" else estimator
    tuning = tuning_for(MODEL).with_law(law).with_estimator(kind)
    circle = Circle()
    controller = TrackingController(model, circle, tuning)
    twin = (Disturbed if disturbed else Twin)(change.truth, change.settings, seed=seed)
    seen = list[tuple[float, ...]]()
    receive = controller.measured

    def measured(measurement: Any) -> None:
        seen.append((measurement.stamp, *measurement.values[:3]))
        receive(measurement)

    controller.measured = measured
    fly(controller, twin, CIRCLE)
    along = np.array([one for one in seen if one[0] > COUNTS])
    asked = np.array([circle.at(time, 0.0).state[:2] for time in along[:, 0]])
    row: dict[str, Any] = {
        "circle_mm": 1e3 * math.sqrt(np.mean(np.sum((along[:, 1:3] - asked) ** 2, axis=1)))
    }
    seen.clear()
    spread = (0.7, 0.25, 1.5)
    points = [tuple(random.uniform(-1, 1, 3) * spread) for _ in range(POINTS)]
    begins = twin.now + DWELL * np.arange(POINTS)
    controller.reference = SetPoints(begins.tolist(), points)
    fly(controller, twin, POINTS * DWELL)
    row |= arrivals(np.array(seen), begins, points)
    row["rail_m_s"] = max((speed for _, speed in twin.craft.contacts), default=0.0)
    found = controller.predict(twin.now).actuation
    if estimator == "learning" and found is not None:
        off = (found.effectiveness - change.gains) / found.deviation
        late = (found.delay - change.later_s) / found.delay_deviation
        row["off"] = np.append(off, late).round(3).tolist()
        value, deviation = np.array(list(found.beyond.values())).T
        row["body_error"] = (value - change.body).tolist()
        row["body_off"] = ((value - change.body) / deviation).round(3).tolist()
    return row


def arrivals(poses: np.ndarray, begins: np.ndarray, points: Sequence[Any]) -> dict[str, float]:
    """Measure overshoot and final distances [mm]."""
    over, rest = 0.0, 0.0
    for begin, point in zip(begins.tolist(), points, strict=True):
        inside = poses[(poses[:, 0] >= begin) & (poses[:, 0] < begin + DWELL)]
        error = inside[:, 1:3] - point[:2]
        over = max(over, float(np.max(-np.sign(error[0]) * error)))
        last = error[inside[:, 0] > begin + DWELL - 0.5]
        rest = max(rest, float(np.hypot(*last.T).max()))
    return {"overshoot_mm": 1e3 * over, "rest_mm": 1e3 * rest}


def summary(rows: list[dict[str, Any]]) -> None:
    """Print medians (and the largest) of all flights."""
    for law in ("lqr", "mpc"):
        for name in changes(0):
            for estimator in ESTIMATORS:
                own = [
                    row
                    for row in rows
                    if (row["law"], row["change"], row["estimator"]) == (law, name, estimator)
                ]
                if not own:
                    continue
                text = f"{law} {name:22} {estimator:9} {len(own):3} flights"
                for key in ("circle_mm", "overshoot_mm", "rest_mm"):
                    values = [row[key] for row in own]
                    text += f"  {key} {np.median(values):6.1f} ({max(values):.0f})"
                text += f"  rail_m_s {max(row['rail_m_s'] for row in own):.2f}"
                off = np.abs([row["off"] for row in own if "off" in row])
                text += (
                    f"  within 95 %: {np.mean(off < 1.96):.3f} of {off.size}" if off.size else ""
                )
                print(text)
                told = [row for row in own if "body_off" in row]
                if told:
                    print(bodies(told))


def bodies(rows: list[dict[str, Any]]) -> str:
    """Return the errors of drag, offset and slope, and how many intervals hold."""
    errors, off = (np.array([row[key] for row in rows]) for key in ("body_error", "body_off"))
    text = ""
    for name, error, own in zip(BEYOND, errors.T, off.T, strict=True):
        held, rms = np.mean(np.abs(own) < 1.96), math.sqrt(np.mean(error**2))
        text += f"  {name} error {rms:.2g}, within 95 %: {held:.3f}"
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="file of JSON lines")
    parser.add_argument("--flights", type=int, default=2, help="of each change and estimator")
    parser.add_argument("--disturbed", action="store_true", help="push the craft, too; see above")
    parser.add_argument("--summary", action="store_true", help="only summarise the file")
    options = parser.parse_args()
    kept = Kept(options.output)
    if not options.summary and any(
        line.get("disturbed", False) != options.disturbed for line in kept.lines
    ):
        parser.error(f"{options.output} has flights of the other kind: disturbed or not")
    for seed in range(0 if options.summary else options.flights):
        for name, change in changes(seed).items():
            for law in ("lqr", "mpc"):
                able = ESTIMATORS if change.known else ESTIMATORS[:2]
                for estimator in ("learning",) if options.disturbed else able:
                    row = {"law": law, "change": name, "estimator": estimator, "seed": seed}
                    row |= {"disturbed": True} if options.disturbed else {}
                    if not kept.have(**row):
                        kept.add(row | flown(change, law, estimator, seed, options.disturbed))
                        print(json.dumps(kept.lines[-1]), flush=True)
    summary(kept.lines)


if __name__ == "__main__":
    from one_line import run

    run(main)
