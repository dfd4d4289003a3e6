"""Processor time of a game between a craft and a scripted hand, and what takes it.

    OPENBLAS_NUM_THREADS=1 python benchmarks/game_cost.py --seconds 20 --games 3

Other programs do not lengthen processor time, apart from what they displace from caches.
"""

from __future__ import annotations

import argparse
import signal
import time
from collections import Counter
from types import FrameType

import numpy as np

from airpuck.compute.process import low_latency
from airpuck_hockey.game.contestant import contestant
from airpuck_hockey.game.game import PERIOD, Game
from airpuck_hockey.game.rules import Rules

#: Parts by module: the first entry counts whose module is on the stack.
PARTS = {
    "hockey/puck_filter.py": "filter of the puck",
    "hockey/searching.py:give": "searches for contacts",
    "hockey/interception.py:__init__": "predicted path of the puck",
    "hockey/all_rounder.py": "other decisions",
    "control/tracking.py:step": "predictive law",
    "control/tracking.py:measured": "filter of the craft",
    "twin/sensors.py:observe": "sensors",
    "twin/craft.py": "plant",
    "twin/play.py": "puck, contacts and events",
    "hockey/hand.py": "hand",
}
#: Time between two samples of the stack, and between two readings of the clock [s].
SAMPLE, SLICE = 1e-3, 0.2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--games", type=int, default=3)
    parser.add_argument("--hand", default="striker:medium")
    options = parser.parse_args()
    low_latency()
    found: Counter[str] = Counter()

    def sample(_number: int, frame: FrameType | None) -> None:
        stack = []
        while frame is not None:
            code = frame.f_code
            stack.append(f"{code.co_filename}:{code.co_name}")
            frame = frame.f_back
        on_stack = (part for key, part in PARTS.items() if any(key in each for each in stack))
        found[next(on_stack, "everything else")] += 1

    signal.signal(signal.SIGPROF, sample)
    costs = []
    for seed in range(options.games):
        rules = Rules(goals=1000, limit_s=1e6)
        game = Game(contestant("airpuck"), contestant(options.hand), rules=rules, seed=seed)
        game.step()  # compiles
        signal.setitimer(signal.ITIMER_PROF, SAMPLE, SAMPLE)
        for _ in range(round(options.seconds / SLICE)):
            began = time.process_time()
            for _ in range(round(SLICE / PERIOD)):
                game.step()
            costs.append((time.process_time() - began) / SLICE)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    low, median = np.quantile(costs, [0.1, 0.5])
    print(f"{median:.2f} s per second of play ({low:.2f} s in the cheapest tenth)")
    for part, count in found.most_common():
        print(f"{part:28s} {count / found.total():5.0%}")


if __name__ == "__main__":
    main()
