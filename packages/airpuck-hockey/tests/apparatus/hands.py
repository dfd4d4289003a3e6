"""A hand that plays a puck alone."""

import math

import numpy as np

from airpuck.craft.table import AirHockey
from airpuck.twin.play import HandMallet, World

PLAY = AirHockey()
#: Time between two looks of the hand [s].
RATE = 0.01


class Frames:
    """An observer that takes measurements on request."""

    due = math.inf

    def observe(self, time: float) -> None:
        self.due = math.inf


def played_alone(player, puck, duration, start, opponent):
    """Return the path of a hand's mallet, and the world; `opponent` gives a place at a time."""
    world, frames = World(PLAY, puck), Frames()
    mallet = HandMallet(PLAY.mallet, PLAY.table, *start)
    world.bodies.append(mallet)
    world.observers.append(frames)
    assert world.puck is not None
    ways = []
    for k in range(round(duration / RATE)):
        seen = None if world.puck.goal else world.puck.state
        mallet.target = player.target(k * RATE, (mallet.x, mallet.y), seen, opponent(k * RATE))
        frames.due = (k + 1) * RATE
        world.run((k + 1) * RATE)
        ways.append((mallet.x, mallet.y, mallet.vx, mallet.vy))
    return np.array(ways), world
