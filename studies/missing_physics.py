"""Whether intervals hold, or findings name the cause, if a model lacks something.

    OPENBLAS_NUM_THREADS=1 python studies/missing_physics.py -o missing.jsonl --flights 200 --seed 1

In each flight something is missing in the paper's craft's usual model: drag (0 to 0.6 1/s), a dead
zone, clipped, square-root or S-shaped thrust curves, a common error of all directions (1.5°), or a
battery that loses 10 % of its thrust. The twin records an excitation flight and `airpuck.study`
judges it. Each flight appends a line of JSON; an interrupted study resumes. The summary prints the
coverage of the 95 % intervals, pooled over the parameters, and how often a finding or the chosen
structure names the cause.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import replace
from typing import Any

import numpy as np
from false_alarms import craft
from verdicts import beyond, resumed

import airpuck
from airpuck import InputError
from airpuck.control.tuning import tuning_for
from airpuck.judgement.study import Study
from airpuck.model.model_file import Model
from airpuck.twin.radio import as_received
from airpuck.twin.settings import TwinSettings, default_twin_settings

#: Length of a recording [s], camera rate [Hz].
RECORDED, RATE = 24.0, 120.0
#: Degree of the true curves, and commands at which they follow their shape.
DEGREE, SPEEDS = 9, np.linspace(0.0, 1.0, 201)
#: Full thrust of shaped curves [N]; dead zone and saturation as commands; error of all directions.
FULL, DEAD, CLIPPED, DIRECTION_DEG = 0.6, 0.12, 0.75, 1.5
#: Share of thrust that a battery loses; largest drag [1/s].
SAG, DRAG = 0.1, 0.6
#: Share of a flight's intervals that hold, below which its cause must be named.
HELD = 0.9
SHAPES = {
    "dead zone": lambda v: np.maximum(v - DEAD, 0.0) / (1 - DEAD),
    "clipped": lambda v: np.minimum(v / CLIPPED, 1.0),
    "square root": lambda v: np.sqrt(v + 0.01) - 0.1,
    "S curve": lambda v: v**2 * (3 - 2 * v),
}
MISSING = ("nothing", "drag", *SHAPES, "direction", "battery")


def flown(missing: str, rng: np.random.Generator) -> tuple[Model, TwinSettings]:
    """Return a true craft and its twin, from which the packaged vehicle file differs."""
    model, content = craft(6), default_twin_settings().model_dump()
    content["motion_capture"]["rate_hz"], content["on_board"]["rate_hz"] = RATE, 0.0
    if missing == "drag":
        content["effects"]["drag_linear_1_s"] = float(rng.uniform(0.0, DRAG))
    elif missing == "battery":
        content["effects"]["battery_sag_1_s"] = SAG / RECORDED
    elif missing == "direction":
        turned = [
            one.model_copy(update={"direction_deg": one.direction_deg + DIRECTION_DEG})
            for one in model.vehicle.propellers
        ]
        vehicle = model.vehicle.model_copy(update={"propellers": tuple(turned)})
        model = replace(model, vehicle=vehicle)
    elif missing in SHAPES:
        powers = SPEEDS[:, None] ** np.arange(1, DEGREE + 1)
        shape = np.linalg.lstsq(powers, SHAPES[missing](SPEEDS), rcond=None)[0]
        curves = FULL * np.exp(0.02 * rng.normal(size=(6, 1))) * shape
        model = replace(model, parameters=replace(model.parameters, thrust=curves))
    free = model.parameters.mask(model.parameters.effects | {"thrust"})
    return replace(model, free=free, uncertainty=None), TwinSettings.model_validate(content)


def names(missing: str, study: Study) -> bool:
    """Return whether the structure or a finding names the cause."""
    terms = [one.term for one in (*study.selection.added, *study.selection.missing)]
    if missing in SHAPES:
        return "degree" in terms or any("wrong shape" in one.cause for one in study.findings)
    usual = "change of all" if missing == "battery" else missing
    return usual in terms


def judged(flight: int, seed: int) -> dict[str, Any]:
    """Record and study once."""
    began, rng = time.process_time(), np.random.default_rng([seed, flight])
    missing = MISSING[flight % len(MISSING)]
    truth, settings = flown(missing, rng)
    line: dict[str, Any] = {"flight": flight, "seed": seed, "missing": missing}
    line["drag_1_s"] = settings.effects.model_dump()["drag_linear_1_s"]
    recording = airpuck.excite(truth, RECORDED, int(rng.integers(2**31)), settings=settings)
    try:
        study = airpuck.study(airpuck.preprocess(recording, craft(6).vehicle))
    except InputError as error:
        return line | {"outcome": "refused", "why": [str(error)], "bars": {}, "named": False}
    heard = as_received(truth, settings, tuning_for(truth).period_s)
    if missing == "direction":  # α is the direction of the pushes, so it contains this error
        angle = truth.parameters.angle_offset + math.radians(DIRECTION_DEG)
        heard = replace(heard, parameters=replace(heard.parameters, angle_offset=angle))
    line |= {"model": study.model.name, "outcome": study.verdict.outcome}
    line |= {"right": study.verdict.parameters.right, "named": names(missing, study)}
    line |= {"quantile": study.model.known.quantile if study.model.known else 2.0}
    line |= {"missing_terms": [one.term for one in study.selection.missing]}
    line |= {
        "why": [one.sentence for one in study.findings],
        "bars": beyond(study.model, heard, exact=missing != "direction"),
    }
    return line | {"cpu_s": round(time.process_time() - began, 1)}


def summary(lines: list[dict[str, Any]]) -> None:
    """Print coverage and naming by what is missing."""
    total = []
    for missing in MISSING:
        part = [line for line in lines if line["missing"] == missing and line["bars"]]
        held = [np.abs([*one["bars"].values()]) <= one["quantile"] for one in part]
        if not part:
            continue
        total += held
        poor = [one for one, h in zip(part, held, strict=True) if h.mean() < HELD]
        named = sum(one["named"] for one in part)
        far = max(max(map(abs, one["bars"].values())) for one in part)
        print(
            f"{missing:12s} {len(part)} flights: {100 * np.concatenate(held).mean():.1f} % held, "
            f"largest error {far:.1f} bars; named in {named}; {len(poor)} below "
            f"{100 * HELD:.0f} %, {sum(one['named'] for one in poor)} of them named"
        )
    if total:
        print(f"pooled: {100 * np.concatenate(total).mean():.1f} % of the 95 % intervals hold")
    for line in lines:
        if line["missing"] != "nothing" and not line["named"]:
            told = json.dumps({k: line[k] for k in ("flight", "missing", "model", "why")})
            print(f"not named: {told}")


def main() -> None:
    resumed(judged, summary)


if __name__ == "__main__":
    from one_line import run

    run(main)
