"""Limits of scripted hands, as their recorded games show them, against the numbers of the scripts.

    python studies/measured_hands.py --games 3 --seconds 300

Each hand plays against the scripted striker. A hand decides every 30 ms, so its reaction is up to
30 ms longer than its delay. Its error of sight offsets the contact, which also turns a shot; the
error of aim with this offset is printed, too. The mallet's speed is reduced by its braking within a
period.
"""

import argparse
import json
import math

from one_line import run

import airpuck
from airpuck.hockey.contestant import contestant
from airpuck.hockey.game import PERIOD
from airpuck.hockey.hand import HUMANS
from airpuck.hockey.measured_hand import measured_hand
from airpuck.hockey.rules import Rules
from airpuck.twin.settings import default_twin_settings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--games", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=300.0)
    arguments = parser.parse_args()
    if arguments.games < 1:
        parser.error("--games must be at least 1")
    settings = default_twin_settings()
    radii = settings.mallet.radius_m + settings.puck.radius_m
    found = {}
    for level, known in HUMANS.items():
        rules = Rules(goals=None, limit_s=arguments.seconds)
        players = contestant("striker:hard"), contestant(f"human:{level}")
        recordings = []
        for seed in range(1, arguments.games + 1):
            game = airpuck.Game(*players, rules=rules, seed=seed)
            game.play()
            recordings.append(game.recording())
        hardest = settings.mallet.acceleration_m_s2
        reserve = hardest * PERIOD / 2
        found[level] = {
            "measured": measured_hand(recordings, settings).to_json(),
            "delay_s": known.reaction_s,
            "speed_m_s": math.hypot(known.speed_m_s, reserve) - reserve,
            "acceleration_m_s2": hardest,
            "aim_rad": known.aim_rad,
            "aim_and_offset_rad": math.hypot(known.aim_rad, known.noise_m / radii),
        }
    print(json.dumps(found, indent=2))


if __name__ == "__main__":
    run(main)
