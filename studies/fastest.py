"""How fast are plans, and how close to their bounds? Plans for random pairs of states.

    python studies/fastest.py --pairs 200 -o fastest.json

Half of the pairs are from rest to rest, half moving at the start, a quarter at the goal, too.
Pairs that no control can fly (a rail that cannot be avoided) are rejected and redrawn.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np

import airpuck
from airpuck.craft.table import Table
from airpuck.planning.request import checked_request
from airpuck.planning.search import search
from airpuck.planning.settings import Limits


def pair(model, random, moving: bool, arriving: bool):
    """Draw a start and a goal on the table."""
    reach = np.array(Table().reach(model.vehicle.radius_m))

    def state(moves: bool):
        place = random.uniform(-reach, reach)
        angle, speed = random.uniform(0, 2 * np.pi), random.uniform(0, 1.5) * moves
        rates = [speed * np.cos(angle), speed * np.sin(angle), random.uniform(-5, 5) * moves]
        return np.concatenate([place, [random.uniform(-np.pi, np.pi)], rates])

    return state(moving), state(arriving)


def warm(model, start, goal, neighbour) -> float | None:
    """Return the processor time of a search from the plan for a start 20 mm away."""
    moved = start - np.sign(start[0]) * np.array([0.02, 0, 0, 0, 0, 0])
    try:
        request = checked_request(model, moved, goal, (), Table(), (), Limits())
        begun = time.process_time()
        search(request, 40, neighbour.path())
        return time.process_time() - begun
    except airpuck.InputError:
        return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=200)
    parser.add_argument("--model", default="paper:M3")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-o", "--output", required=True)
    given = parser.parse_args()
    model = airpuck.read_model(given.model)
    random = np.random.default_rng(given.seed)
    airpuck.plan(model, (0, 0, 0), (0.5, 0, 0))  # builds the programs
    rows, refused = [], 0
    while len(rows) < given.pairs:
        k = len(rows)
        start, goal = pair(model, random, k % 2 == 1, k % 4 == 3)
        begun = time.process_time()
        try:
            request = checked_request(model, start, goal, (), Table(), (), Limits())
            search(request, 40)
            searched = time.process_time() - begun
            begun = time.process_time()
            found = airpuck.plan(model, start, goal, table=Table())
        except airpuck.InputError as error:
            refused += error.field in ("start", "goal")
            if error.field not in ("start", "goal"):
                rows.append({"failed": str(error), "start": start.tolist(), "goal": goal.tolist()})
            continue
        taken = time.process_time() - begun
        rows.append(
            found.to_json()
            | {"start": start.tolist(), "goal": goal.tolist(), "taken_s": taken, "moving": k % 2}
            | {"search_s": searched, "warm_s": warm(model, start, goal, found)}
        )
        with open(given.output, "w", encoding="utf-8") as file:  # noqa: PTH123
            json.dump({"rows": rows, "refused": refused}, file)
    gaps = np.array([row["gap"] for row in rows if "gap" in row])
    print(f"{len(gaps)} of {len(rows)} solved; {refused} redrawn")
    print(f"gap to the bound: median {np.median(gaps):.1%}, worst {gaps.max():.1%}")
    for name, key in (
        ("search, cold", "search_s"),
        ("search, from the plan of a neighbour", "warm_s"),
        ("plan and bound", "taken_s"),
    ):
        taken = np.array([row[key] for row in rows if row.get(key) is not None])
        low, high = np.median(taken), np.quantile(taken, 0.95)
        print(f"{name}: p50 {low:.2f} s, p95 {high:.2f} s of processor time ({len(taken)})")


if __name__ == "__main__":
    from one_line import run

    run(main)
