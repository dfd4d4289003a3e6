"""Are verdicts on flights of seven seconds right? In two of three flights something is missing.

    OPENBLAS_NUM_THREADS=1 python studies/short_flights.py -o short.jsonl --flights 48 --seed 99

Craft and cameras are drawn as in studies/verdicts.py. In every third flight the table slopes by a
tenth of the craft's weakest acceleration, in every third the floor brakes by 0.5 1/s.
`airpuck.study` judges the flight. The summary counts the structures, and errors of main quantities
beyond three stated bars; those of flights whose parameters are called right are the wrong ones. An
interrupted study resumes; `--summary` only reads the file.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from verdicts import beyond, drawn, resumed

import airpuck
from airpuck import InputError
from airpuck.control.tuning import tuning_for
from airpuck.craft.vehicle import GRAVITY
from airpuck.evaluation.presentation import largest_acceleration
from airpuck.twin.radio import as_received

#: Length of a flight [s]; slope over the weakest acceleration; drag of velocity and spin [1/s].
RECORDED, SLOPE, DRAG = 7.0, 0.1, 0.5
MISSING = ("nothing", "tilt", "drag")


def judged(flight: int, seed: int) -> dict[str, Any]:
    """Record and study once."""
    rng, missing = np.random.default_rng([seed, flight // 3]), MISSING[flight % 3]
    truth, settings = drawn(rng)
    weakest = float(largest_acceleration(truth)[:4].min())
    effects = {
        "nothing": {},
        "tilt": {"tilt_rad": (SLOPE * weakest / GRAVITY, 0.0)},
        "drag": {"drag_linear_1_s": DRAG, "spin_drag_linear_1_s": DRAG},
    }[missing]
    settings = settings.model_copy(update={"effects": settings.effects.model_copy(update=effects)})
    line: dict[str, Any] = {"flight": flight, "seed": seed, "missing": missing}
    try:
        recording = airpuck.excite(truth, RECORDED, flight, settings=settings)
        study = airpuck.study(airpuck.preprocess(recording, truth.vehicle))
    except InputError as error:
        return line | {"outcome": "refused", "why": [str(error)], "bars": {}, "right": False}
    heard = as_received(truth, settings, tuning_for(truth).period_s)
    bars = beyond(study.model, heard, exact=True)
    said = study.verdict
    line |= {"model": study.model.name, "outcome": said.outcome, "right": said.parameters.right}
    lacking = [one.term for one in study.selection.missing]
    return line | {
        "why": [one.sentence for one in study.findings],
        "lacking": lacking,
        "bars": bars,
    }


def summary(lines: list[dict[str, Any]]) -> None:
    """Print structures, and errors beyond three bars, by what is missing."""
    for missing in MISSING:
        part = [one for one in lines if one["missing"] == missing]
        if not part:
            continue
        models = dict(Counter(one.get("model", "refused") for one in part).most_common())
        lacking = dict(Counter(term for one in part for term in one.get("lacking", ())))
        print(f"{missing}: {len(part)} flights, structures {models}, named as missing {lacking}")
        for title, chosen in (("all", part), ("called right", [o for o in part if o["right"]])):
            off = np.abs([bar for one in chosen for bar in one["bars"].values()])
            if len(off):
                far = sum(max(map(abs, one["bars"].values()), default=0.0) > 3 for one in chosen)
                print(
                    f"  {title}: {(off > 3).sum()} of {len(off)} parameters beyond three bars, in "
                    f"{far} of {len(chosen)} flights; the largest {off.max():.1f}"
                )


def main() -> None:
    resumed(judged, summary)


if __name__ == "__main__":
    from one_line import run

    run(main)
