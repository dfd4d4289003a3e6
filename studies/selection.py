"""Does the selection choose the rung of the craft that flew? Excitation flights on the twin.

    python studies/selection.py --seeds 10 --duration 60

Craft are the published M3, unchanged and with as much inflow, pair interaction and drag as real
flights show. Prints the chosen rung for each flight, and how far each rung is above the best.
"""

from __future__ import annotations

import argparse
from collections import Counter

from recovery import truth

from airpuck import excite, preprocess, select_model
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import Effects, default_twin_settings

CRAFTS = {
    "M3": Effects(),
    "M5+drag": Effects.model_validate(
        {
            "drag_linear_1_s": 0.1,
            "drag_quadratic_1_m": 0.1,
            "spin_drag_linear_1_s": 0.2,
            "inflow_s_m": 0.2,
            "pair_interaction_1_N": 20.0,
        }
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=60.0)
    options = parser.parse_args()
    model = truth()
    for name, effects in CRAFTS.items():
        settings = default_twin_settings().model_copy(update={"effects": effects})
        plant = build_plant(model, settings)
        taken: Counter[str] = Counter()
        for seed in range(options.seeds):
            flight = excite(model, options.duration, seed, settings=settings, plant=plant)
            selection = select_model(preprocess(flight))
            taken[selection.fit.model.name] += 1
            above = ", ".join(
                f"{c.name} {50 * c.excess:.2f} ± {50 * c.standard_error:.2f} %"
                for c in selection.candidates
            )
            print(f"{name}, seed {seed}: {selection.fit.model.name} ({above})", flush=True)
        print(f"{name}: taken {dict(taken)}", flush=True)


if __name__ == "__main__":
    from one_line import run

    run(main)
