"""Random games, in which no puck may tunnel, escape, get stuck, or gain energy without a cause.

    python studies/random_games.py --games 100000

Games are two seconds long. The players are a craft (a free disc that is pushed at random, and
bounces off the rails) and two mallets that chase the puck, with random speed and force. Puck,
table, goal and laws of contact are random as well. Shots have up to 20 m/s.
"""

from __future__ import annotations

import argparse
import math
import random
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor

from airpuck.craft.table import AirHockey, Contact, Mallet, Puck, Table
from airpuck.physics.puck import Disc, PuckState, Walls, strike
from airpuck.physics.puck_on_table import Moving, PuckOnTable
from airpuck.twin.play import HandMallet

LENGTH, STEP = 2.0, 1 / 240
#: Overlap of discs allowed for rounding [m].
TOUCHING = 1e-9


def drawn(chance: random.Random) -> AirHockey:
    """Return a table with a puck; some of them are unusual."""

    def contact() -> Contact:
        restitution = chance.choice([0.0, 0.3, 0.8, 1.0])
        return Contact(restitution=restitution, grip=chance.random(), friction=chance.random())

    table = Table(
        length_m=chance.uniform(1.2, 2.4),
        width_m=chance.uniform(0.6, 1.2),
        goal_width_m=chance.choice([0.07, 0.25, 0.4, 0.6]),
        restitution=chance.random(),
    )
    puck = Puck(
        drag_1_s=chance.choice([0.0, 0.2, 1.0]), rail=contact(), mallet=contact(), craft=contact()
    )
    mallet = Mallet(speed_m_s=chance.uniform(1, 8), acceleration_m_s2=chance.uniform(10, 200))
    return AirHockey(table=table, puck=puck, mallet=mallet)


class FreeCraft:
    """A disc that random thrusts push, between rails."""

    def __init__(self, table: Table, chance: random.Random) -> None:
        self.disc = Disc(chance.uniform(-0.3, 0.3), 0.0, radius=0.07, mass=0.138, inertia=0.26e-3)
        self._walls = Walls(table.model_copy(update={"goal_width_m": 1e-9}), 0.07)
        self._law = Contact(restitution=table.restitution, grip=1.0, friction=table.friction)
        self._chance = chance

    def push(self, duration: float) -> None:
        """Accelerate, and turn back at rails."""
        disc = self.disc
        disc.vx += self._chance.uniform(-40, 40) * duration
        disc.vy += self._chance.uniform(-40, 40) * duration
        x, y = self._walls.nearest(disc.x, disc.y)
        for nx, ny, beyond in ((-1, 0, disc.x - x), (0, -1, disc.y - y)):
            if beyond:
                side = math.copysign(1.0, beyond)
                if (disc.vx * nx + disc.vy * ny) * side < 0:
                    strike(disc, Disc(0.0, 0.0), nx * side, ny * side, self._law)
        disc.x, disc.y = x, y

    def moving(self, duration: float) -> Moving:
        """Return its way."""
        disc = self.disc
        return Moving(
            disc.x,
            disc.y,
            disc.vx,
            disc.vy,
            disc.spin,
            disc.radius,
            disc.mass,
            disc.inertia,
            to_x=disc.x + disc.vx * duration,
            to_y=disc.y + disc.vy * duration,
            kind="craft",
        )


def game(seed: int, length: float = LENGTH) -> dict[str, float]:
    """Play one game; return its counts, or raise an AssertionError that names the seed."""
    chance = random.Random(seed)
    play = drawn(chance)
    craft = FreeCraft(play.table, chance)
    mallets = [
        HandMallet(play.mallet, play.table, side * play.table.length_m / 3, 0.0) for side in (-1, 1)
    ]
    puck = PuckOnTable(play, served(play, chance))
    walls = Walls(play.table, puck.radius)
    counts: Counter[str] = Counter()
    begun, end = time.perf_counter(), 0.0
    while end < length:
        end += STEP
        craft.push(STEP)
        for mallet in mallets:
            mallet.target = puck.state.x, puck.state.y
        while puck.time < end:
            before, speed = len(puck.touches), energy(play.puck, puck.state)
            left = end - puck.time
            ways = [mallet.moving(left) for mallet in mallets]
            way = craft.moving(left)
            start = puck.time
            puck.run(end, [way, *ways])
            craft.disc.x, craft.disc.y = way.x, way.y
            craft.disc.vx, craft.disc.vy, craft.disc.spin = way.vx, way.vy, way.spin
            if puck.time > start:
                for mallet, hand in zip(mallets, ways, strict=True):
                    mallet.arrive(hand, puck.time - start)
            # In the middle of a step, discs may be about to make way for a wedged puck.
            check(seed, play, puck, walls, [way, *ways] if puck.time == end else [])
            touched = {touch.met for touch in puck.touches[before:]}
            # Only craft and mallets give energy.
            if touched <= {"rail", "post", "goal"}:
                assert energy(play.puck, puck.state) <= speed * (1 + 1e-12), (seed, "energy")
        if puck.goal:
            counts["goals"] += 1
            puck.place(served(play, chance))
    counts.update(touch.met for touch in puck.touches)
    return {**counts, "wall_s": time.perf_counter() - begun, "seconds": length}


def served(play: AirHockey, chance: random.Random) -> PuckState:
    """Return a puck that is shot somewhere."""
    x, y = play.table.reach(play.puck.radius_m)
    angle, speed = chance.uniform(-math.pi, math.pi), chance.choice([0.0, 1.0, 10.0, 20.0])
    place = chance.uniform(-x, x), chance.uniform(-y, y)
    along = speed * math.cos(angle), speed * math.sin(angle)
    return PuckState(*place, 0.0, *along, chance.uniform(-50, 50))


def energy(puck: Puck, state: PuckState) -> float:
    """Return a puck's energy [J]."""
    moving = puck.mass_kg * (state.vx**2 + state.vy**2)
    return (moving + puck.inertia * state.spin**2) / 2


def check(seed: int, play: AirHockey, puck: PuckOnTable, walls: Walls, discs: list[Moving]) -> None:
    """Check that a puck is at a possible place."""
    state = puck.state
    assert all(map(math.isfinite, state)), (seed, "not finite")
    if puck.goal:
        behind = abs(state.x) - play.table.length_m / 2
        assert abs(behind - puck.radius) < TOUCHING, (seed, "goal")
        assert abs(state.y) <= play.table.goal_width_m / 2 - puck.radius + TOUCHING, (seed, "goal")
        return
    x, y = walls.nearest(state.x, state.y)
    assert math.hypot(x - state.x, y - state.y) < TOUCHING, (seed, "escaped")
    for disc in discs:
        apart = math.hypot(state.x - disc.x, state.y - disc.y) - puck.radius - disc.radius
        assert apart > -TOUCHING, (seed, "overlaps", disc.kind, apart)


def main() -> None:
    """Play, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--games", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=None)
    given = parser.parse_args()
    total: Counter[str] = Counter()
    slowest = 0.0
    with ProcessPoolExecutor(given.workers) as pool:
        for found in pool.map(game, range(given.seed, given.seed + given.games), chunksize=50):
            total.update(found)
            slowest = max(slowest, found["wall_s"])
    print(f"{given.games} games of {LENGTH:g} s, none with a puck that tunnelled, escaped or stuck")
    print(", ".join(f"{total[k]:.0f} {k}" for k in ("rail", "post", "mallet", "craft", "goals")))
    print(
        f"{total['seconds'] / total['wall_s']:.0f} times real time, checks included; "
        f"the slowest game took {slowest:.2f} s"
    )


if __name__ == "__main__":
    from one_line import run

    run(main)
