"""Limits of a hand: made-up recordings whose reactions, strokes and shots are known exactly."""

import math

import numpy as np
import pytest

import airpuck_hockey
from airpuck.recording.stream import COLUMNS, Recording, Stream
from airpuck.twin.settings import default_twin_settings
from airpuck_hockey.game.contestant import Contestant, contestant
from airpuck_hockey.game.game import KINDS
from airpuck_hockey.game.hand import KEEPERS
from airpuck_hockey.game.rules import Rules
from tests.apparatus.studies import study

HANDS = study("measured_hands")
Measure, measured_hand = HANDS.Measure, HANDS.measured_hand
#: Times of an episode: the opponent's hit, and its length [s].
HIT, LENGTH = 0.5, 3.0
#: Poses per second, and the noise of a position [m].
RATE, NOISE = 240, 5e-5


def stroke(time: np.ndarray, acceleration: float, speed: float) -> np.ndarray:
    """Return the distance moved from rest, at a constant acceleration and then speed."""
    gains = speed / acceleration
    moved = np.clip(time, 0.0, gains)
    return acceleration * moved**2 / 2 + speed * np.clip(time - gains, 0.0, None)


def episode(
    begin: float, reaction: float, acceleration: float, speed: float, error: float
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, str, int]]]:
    """Return mallet, puck and events of one hit by the opponent and one shot by the hand.

    The hand plays on the right. It drifts, moves aside after its reaction time, and later strikes a
    resting puck; the puck then leaves with an error of direction about the centre of the goal.
    """
    time = np.arange(0.0, LENGTH, 1 / RATE)
    mallet, puck = np.tile([0.9, 0.0], (len(time), 1)), np.tile([0.5, 0.1], (len(time), 1))
    aside = 0.05 * np.clip((time - HIT - reaction) / 0.05, 0.0, None) ** 2
    mallet[:, 1] += np.where(time < 1.2, np.clip(aside, 0.0, 0.05), 0.0)
    mallet[:, 1] += 0.1 * np.clip(time - 0.2, 0.0, 1.0)
    puck[:, 0] = np.where(time < HIT, -0.3, np.clip(-0.3 + 2.0 * (time - HIT), None, 0.5))
    begins, lasts = 2.0, 0.2
    mallet[:, 0] -= stroke(np.clip(time - begins, 0.0, lasts), acceleration, speed)
    angle = math.pi + math.atan2(0.1, 0.5 + 1.1) + error
    leaves = 3.0 * np.clip(time - begins - lasts, 0.0, None)[:, None]
    puck = puck + leaves * [math.cos(angle), math.sin(angle)]
    events = [(begin + HIT, "hit", -1), (begin + begins + lasts, "hit", 1)]
    return mallet, puck, events


def recorded(random: np.random.Generator, count: int, side: int) -> tuple:
    """Return a recording of episodes, and the true values of each."""
    truth = {
        "reaction": random.normal(0.21, 0.02, count),
        "acceleration": random.uniform(25.0, 35.0, count),
        "speed": random.uniform(1.5, 2.5, count),
        "error": random.normal(0.0, 0.1, count),
    }
    mallets, pucks, events = [], [], []
    for number in range(count):
        values = {name: float(each[number]) for name, each in truth.items()}
        mallet, puck, met = episode(number * LENGTH, **values)
        mallets.append(mallet), pucks.append(puck), events.extend(met)
    time = np.arange(len(np.concatenate(mallets))) / RATE

    def poses(places: list[np.ndarray]) -> Stream:
        place = side * np.concatenate(places) + random.normal(0.0, NOISE, (len(time), 2))
        kept = random.random(len(time)) > 0.02
        stamp = (1e9 * time[kept]).astype(np.int64)
        values = np.column_stack([place[kept], np.zeros(kept.sum())])
        return Stream(stamp, stamp, values, COLUMNS["puck"])

    stamp = np.array([1e9 * when for when, *_ in events]).astype(np.int64)
    rows = [[0.0, 0.0, KINDS.index(kind), side * who, 0.1] for _, kind, who in events]
    game = Stream(stamp, stamp, np.array(rows), COLUMNS["game"])
    return Recording({"mallet": poses(mallets), "puck": poses(pucks), "game": game}, "x"), truth


@pytest.mark.parametrize("side", [1, -1])
def test_intervals_of_a_measured_hand_cover_the_truth(side):
    random = np.random.default_rng(side + 1)
    recording, _ = recorded(random, 80, side)
    found = measured_hand([recording], default_twin_settings())
    # Of the uniform distributions, the quantiles 95 % and 75 %.
    truth = {"reaction_s": 0.21, "speed_m_s": 2.45, "acceleration_m_s2": 32.5, "aim_rad": 0.1}
    for name, value in truth.items():
        quantile = getattr(found, name)
        assert quantile.low < value < quantile.high, name
        assert quantile.count >= 40, name
        assert quantile.high - quantile.low < 0.6 * value, name


def test_intervals_have_their_stated_coverage():
    random, covered = np.random.default_rng(0), 0
    for _ in range(100):
        found = Measure.of(random.exponential(1.0, 25), 0.5)
        covered += found.low <= math.log(2) <= found.high
    assert covered >= 0.95 * 100 - 3 * math.sqrt(100 * 0.05 * 0.95)


def test_a_few_hits_determine_nothing():
    recording, _ = recorded(np.random.default_rng(0), 3, 1)
    found = measured_hand([recording], default_twin_settings())
    assert found.to_json()["reaction_s"] == {"value": None, "low": None, "high": None, "count": 3}


@pytest.mark.slow
def test_a_scripted_hand_reveals_its_limits():
    hand, rules = contestant("human:medium"), Rules(goals=None, limit_s=60.0)
    hard, kind = KEEPERS["hard"], study("opponents").Wild
    wild = Contestant("wild", hand=lambda equipment, seed: kind(equipment, hard, seed))
    game = airpuck_hockey.Game(wild, hand, rules=rules, seed=1)
    game.play()
    found = measured_hand([game.recording()], default_twin_settings())
    # 0.22 s late, and decides every 30 ms; 2.5 m/s less the braking within a period of 10 ms.
    assert found.reaction_s.low < 0.25 and found.reaction_s.high > 0.22
    assert found.speed_m_s.value == pytest.approx(math.sqrt(2.5**2 + 0.2**2) - 0.2, rel=0.02)
    assert found.acceleration_m_s2.value == pytest.approx(40.0, rel=0.02)
