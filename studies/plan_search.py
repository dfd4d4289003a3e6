"""Does the search find plans within hard limits, and the fastest with a free yaw? Random cases.

    python studies/plan_search.py limits --cases 40 -o limits.json
    python studies/plan_search.py free-yaw --goals 16 --starts 8 -o free_yaw.json

`limits` draws craft of 3, 4, 6 and 8 propellers, spin limits of 0.5 to 40 rad/s, turns of 0.3 to
3 rad and distances of 0.02 to 1 m, and counts plans, refusals with a proof, and failures.
`free-yaw` compares the search with random starts of its own; each that ends faster is refined, too.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from bounds import craft

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.planning.request import Goal, Request, checked_request
from airpuck.planning.search import TIDY, guess, refined, search
from airpuck.planning.settings import Limits
from airpuck.planning.transcription import program_for

PROPELLERS = (3, 4, 6, 8)
#: Intervals of the plans that are compared.
INTERVALS = 20
#: Words of errors that no search could avoid.
PROVED = ("whatever it does",)


def limits(first: int, cases: int) -> list[dict]:
    """Plan flights within random limits of spin."""
    rows = []
    for number in range(first, cases):
        random = np.random.default_rng([1, number])
        kind = PROPELLERS[number % len(PROPELLERS)]
        model = craft(random, kind)
        spin = float(np.exp(random.uniform(np.log(0.5), np.log(40))))
        turn = random.uniform(0.3, 3) * random.choice([-1.0, 1.0])
        distance, angle = np.exp(random.uniform(np.log(0.02), 0)), random.uniform(0, 2 * np.pi)
        x, y = distance * np.cos(angle), distance * np.sin(angle)
        goal = Goal(float(x), float(y), float(turn), turn="exact")
        request = checked_request(model, [0.0, 0.0, 0.0], goal, (), None, (), Limits(spin=spin))
        row = {"case": number, "propellers": kind, "spin": spin, "turn": turn, "distance": distance}
        begun = time.process_time()
        try:
            row |= {"outcome": "planned", "time_s": search(request, INTERVALS)[0].time}
        except InputError as error:
            proved = any(words in str(error) for words in PROVED)
            row |= {"outcome": "refused" if proved else "failed", "error": str(error)}
        rows.append(row | {"processor_s": time.process_time() - begun})
        print(
            number,
            *(f"{value:.3g}" if isinstance(value, float) else value for value in rows[-1].values()),
            flush=True,
        )
    return rows


def free_yaw(goals: int, starts: int, seed: int) -> list[dict]:
    """Compare plans to goals with a free yaw with the best of random starts."""
    model, rows = airpuck.read_model("paper:M3"), []
    for number in range(goals):
        random = np.random.default_rng([seed, number])
        request = free_request(random, model)
        found = search(request, INTERVALS)[0]
        best, turn = found.time, found.path.states[-1, 2] - request.start[2]
        for _ in range(starts):
            one = from_random_start(random, request, best)
            if one is not None and one.time < best:
                best, turn = one.time, one.path.states[-1, 2] - request.start[2]
        rows.append({"goal": number, "time_s": found.time, "best_s": best, "turn": float(turn)})
        print(
            number,
            f"{found.time:.4f} s, beaten by {found.time / best - 1:.2%}, turn {turn:.2f}",
            flush=True,
        )
    return rows


def free_request(random: np.random.Generator, model: airpuck.Model) -> Request:
    """Draw a start in motion and a goal, at rest there or with any velocity."""
    distance, angle = random.uniform(0.05, 1.2), random.uniform(0, 2 * np.pi)
    speed, heading = random.uniform(0, 1.5), random.uniform(0, 2 * np.pi)
    spin, yaw = random.uniform(-4, 4), random.uniform(-np.pi, np.pi)
    start = [0.0, 0.0, yaw, speed * np.cos(heading), speed * np.sin(heading), spin]
    velocity = (0.0, 0.0, 0.0) if random.random() < 0.7 else None
    goal = Goal(float(distance * np.cos(angle)), float(distance * np.sin(angle)), None, velocity)
    return checked_request(model, start, goal, (), None, (), Limits())


def from_random_start(random: np.random.Generator, request: Request, best: float):
    """Solve from a random turn; refine what comes near the best time."""
    yaw = request.start[2] + random.uniform(-2 * np.pi, 2 * np.pi)
    path = guess(request, INTERVALS, yaw, random.uniform(-1.5, 1.5), request.via)
    one = program_for(request.model, INTERVALS, 1, 0).solve(request, path, yaw, TIDY)
    if not one.converged or one.time > 1.005 * best:
        return None
    return refined(request, one.path, yaw, INTERVALS)[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=("limits", "free-yaw"))
    parser.add_argument("--first", type=int, default=0, help="the first case")
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--goals", type=int, default=16)
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--seed", type=int, default=2, help="of the goals with a free yaw")
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args()
    if given.part == "limits":
        rows = limits(given.first, given.cases)
        outcomes = [row["outcome"] for row in rows]
        print({name: outcomes.count(name) for name in ("planned", "refused", "failed")})
    else:
        rows = free_yaw(given.goals, given.starts, given.seed)
        lost = [row["time_s"] / row["best_s"] - 1 for row in rows]
        beaten = sum(share > 0.01 for share in lost)
        print(f"{beaten} of {len(rows)} beaten by more than 1 %; worst {max(lost):.2%}")
    given.output.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    from one_line import run

    run(main)
