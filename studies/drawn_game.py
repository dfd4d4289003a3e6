"""A game with a puck drawn within what is known of it, which no player knows exactly."""

from __future__ import annotations

import numpy as np

from airpuck.hockey.contestant import Contestant
from airpuck.hockey.game import Game
from airpuck.hockey.prediction import drawn_puck
from airpuck.hockey.rules import Rules
from airpuck.twin.settings import default_twin_settings


def drawn_game(
    left: Contestant,
    right: Contestant,
    duration: float,
    seed: int,
    random: np.random.Generator | None = None,
) -> Game:
    """Return a game of a given duration [s]; the seed also draws the puck, unless `random` does."""
    believed = default_twin_settings()
    puck = drawn_puck(believed.puck, random or np.random.default_rng(seed))
    return Game(
        left,
        right,
        settings=believed.model_copy(update={"puck": puck}),
        believed=believed,
        rules=Rules(goals=None, limit_s=duration),
        seed=seed,
        logs=False,
    )
