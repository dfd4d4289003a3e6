"""Share of shots that score against an opponent who waits in its place, by speed and banks.

    python studies/set_opponents.py --shots 250

The puck rests in the other half for 0.6 s, so that the opponent stands where it waits, and is then
shot so that it would score on an empty half. Drag and bounces come from the table file, which the
opponent knows. No craft takes part: these are properties of the opponents.
"""

from __future__ import annotations

import argparse
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
from one_line import run

from airpuck.physics.puck import PuckState
from airpuck.twin.play import HandMallet, World
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck_hockey.game.contestant import contestant
from airpuck_hockey.player.shot import flown
from airpuck_hockey.player.tactic import Frame

_FAMILIES = Path(__file__).with_name("opponents.py")
OPPONENTS = ("human", "keeper", "wall", f"{_FAMILIES}:Banker", f"{_FAMILIES}:Wild")
SPEEDS = (1.5, 2.5, 3.5, 4.5, 5.5)
#: Time before the shot, longest time after it, and time between targets of the hand [s].
BEFORE, AFTER, PERIOD = 0.6, 2.5, 0.01


class Hand:
    """Moves the mallet on the right; a world's observer."""

    def __init__(self, name: str, settings: TwinSettings, puck: PuckState, seed: int) -> None:
        made = contestant(name).hand
        assert made is not None
        self.hand, self.frame, self.due = made(settings, seed), Frame(1), 0.0
        self.world = World(settings, puck)
        self.mallet = HandMallet(settings.mallet, settings.table, 0.85, 0.0)
        self.world.bodies.append(self.mallet)
        self.world.observers.append(self)

    def observe(self, time: float) -> None:
        """Let the hand see, and choose its target."""
        assert self.world.puck is not None
        puck = None if self.world.puck.goal else self.world.puck.state
        own = self.frame.point(self.mallet.x, self.mallet.y)
        other = self.frame.point(-0.6, 0.0)
        self.mallet.target = self.frame.point(
            *self.hand.target(time, own, self.frame.puck(puck), other)
        )
        self.due = time + PERIOD


def scores(name: str, settings: TwinSettings, shot: PuckState, seed: int) -> bool:
    """Return whether a shot scores."""
    side = Hand(name, settings, shot._replace(vx=0.0, vy=0.0), seed)
    puck = side.world.puck
    assert puck is not None
    side.world.run(BEFORE)
    puck.place(shot)
    while side.world.time < BEFORE + AFTER and not puck.goal and puck.state.vx > 0:
        side.world.run(side.world.time + PERIOD)
    return puck.goal > 0


def drawn_shot(settings: TwinSettings, random: np.random.Generator) -> tuple[PuckState, int]:
    """Draw a shot that scores on an empty half; return it and its number of banks."""
    while True:
        x, y = random.uniform([-0.7, -0.4], [-0.25, 0.4])
        speed, angle = random.uniform([SPEEDS[0], -1.2], [SPEEDS[-1], 1.2])
        shot = PuckState(x, y, 0.0, speed * math.cos(angle), speed * math.sin(angle), 0.0)
        flights = flown(settings, np.array([shot[:2]]), np.array([shot[3:]]))
        if flights.scores[0]:
            return shot, int(flights.bounces[0])


def main() -> None:
    """Shoot at all opponents, and print goals of shots."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--shots", type=int, default=250, help="at each opponent")
    options = parser.parse_args()
    settings = default_twin_settings()
    for name in (f"{kind}:{level}" for kind in OPPONENTS for level in ("medium", "hard")):
        random = np.random.default_rng(0)
        shots = [drawn_shot(settings, random) for _ in range(options.shots)]
        speeds = np.array([math.hypot(*shot[3:5]) for shot, _ in shots])
        banks = np.array([count for _, count in shots])
        goals = np.array([scores(name, settings, shot, k) for k, (shot, _) in enumerate(shots)])
        print(name)
        for count in range(3):
            cells = []
            for low, high in pairwise(SPEEDS):
                some = (banks == count) & (speeds >= low) & (speeds < high)
                cells.append(f"{goals[some].sum()} of {some.sum()} at {low} to {high} m/s")
            print(f"  {count} banks: " + ", ".join(cells), flush=True)


if __name__ == "__main__":
    run(main)
