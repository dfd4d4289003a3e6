"""What a player gains by learning drag and restitution during play.

    python studies/learned_puck.py --games 30
    python studies/learned_puck.py --games 7 --against human:medium studies/opponents.py:Wild

The first measures errors of predicted bounces. Two scripted hands play with pucks drawn within what
is known of them. Filters that start from the table file see noisy poses. Each prediction reaches
over at least one bounce and no touch. The second counts goals: the craft plays each hand twice with
each puck, once without learning puck and opponent.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from one_line import run

from airpuck.control.law import Pilot
from airpuck.craft.table import AirHockey
from airpuck.model.model_file import Model
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck.twin.settings import default_twin_settings
from airpuck_hockey.game.contestant import Contestant, contestant
from airpuck_hockey.game.game import Game
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.player.player import Player
from airpuck_hockey.puck.prediction import drawn_puck, predict_puck
from airpuck_hockey.puck.puck_filter import PuckFilter, PuckNoise

#: Time ahead, and time between predictions [s]; also the ages of the game that are compared [s].
AHEAD, EVERY, AGES = 0.5, 0.1, (0.0, 5.0, 15.0, 40.0)
#: Squared distance in the plane, relative to its covariance, that 95 % stay below.
NINETY_FIVE = 5.99


def drawn_game(
    left: Contestant,
    right: Contestant,
    duration: float,
    seed: int,
    random: np.random.Generator | None = None,
) -> Game:
    """Return a game of a given duration [s] with a puck that neither side knows exactly.

    The puck is drawn by `random`, by default from the seed.
    """
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


def predictions(seed: int, duration: float) -> list[tuple[float, ...]]:
    """Play a game; return age, and for each filter the error [m] and whether it is in the band."""
    random = np.random.default_rng(seed)
    counter = Path(__file__).with_name("opponents.py")
    hands = contestant("striker:medium"), contestant(f"{counter}:Counter")
    game = drawn_game(*hands, duration, seed, random)
    filters = [PuckFilter(default_twin_settings(), learns=learns) for learns in (False, True)]
    noise = np.array([PuckNoise().position_m] * 2 + [PuckNoise().yaw_rad])
    found, due = [], 0.0
    while game.phase != "over":
        game.step()
        # The world stops at its last event before the end of the period.
        now = game.world.time
        if game.puck is None:
            continue
        for each in filters:
            each.pose(now, np.array(game.puck[:3]) + random.normal(0.0, noise))
        if now < due:
            continue
        due = now + EVERY
        alone = PuckOnTable(game.settings, game.puck)
        alone.run(AHEAD)
        beliefs = [each.belief for each in filters if each.belief is not None]
        known = all(np.trace(belief.covariance[3:5, 3:5]) < 0.05**2 for belief in beliefs)
        if alone.goal or not alone.touches or not known:
            continue
        row, place = [now], np.array(alone.state[:2])
        for each, belief in zip(filters, beliefs, strict=True):
            ahead = predict_puck(each.model, belief, [now + AHEAD])
            away, covariance = place - ahead.mean[0, :2], ahead.covariance[0, :2, :2]
            square = float(away @ np.linalg.solve(covariance, away))
            row += [float(np.hypot(*away)), float(square < NINETY_FIVE)]
        found.append(tuple(row))
    return found


def goals(against: str, learns: bool, seed: int, duration: float) -> tuple[int, int]:
    """Play a game with a craft, for all its time; return goals scored and conceded."""

    def player(model: Model, equipment: AirHockey, side: int, seed: int, opponent: float) -> Pilot:
        return Player(
            model, equipment, side=side, seed=seed, opponent_radius=opponent, learns=learns
        )

    craft = Contestant("airpuck", player=player)
    game = drawn_game(craft, contestant(against), duration, seed)
    game.play()
    return game.score[0], game.score[1]


def count_goals(against: list[str], games: int, duration: float) -> None:
    """Print the goals of a craft that learns, and of one that does not."""
    for name in against:
        total = np.zeros((2, 2), dtype=int)
        for seed in range(games):
            for learns in (False, True):
                total[int(learns)] += goals(name, learns, seed, duration)
            print(f"{name}, {seed + 1} games of {duration:.0f} s: fixed ", end="")
            print(f"{total[0, 0]} : {total[0, 1]}, learned {total[1, 0]} : {total[1, 1]}")


def main() -> None:
    """Play, and print the errors by age of the game, or the goals."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--games", type=int, default=30)
    parser.add_argument("--duration", type=float, default=40.0, help="of a game [s]")
    parser.add_argument("--against", nargs="+", metavar="HAND", help="count goals against hands")
    options = parser.parse_args()
    if options.against:
        count_goals(options.against, options.games, options.duration)
        return
    rows = np.array([row for k in range(options.games) for row in predictions(k, options.duration)])
    for begin, end in pairwise(AGES):
        some = rows[(rows[:, 0] >= begin) & (rows[:, 0] < end)]
        if not len(some):
            continue
        rms = 1e3 * np.sqrt((some[:, [1, 3]] ** 2).mean(axis=0))
        inside = 100 * some[:, [2, 4]].mean(axis=0)
        print(
            f"{begin:.0f} to {end:.0f} s, {len(some)} predictions: error {rms[0]:.0f} mm fixed, "
            f"{rms[1]:.0f} mm learned; in the 95 % region {inside[0]:.0f} %, {inside[1]:.0f} %"
        )


if __name__ == "__main__":
    run(main)
