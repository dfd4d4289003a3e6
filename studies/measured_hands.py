"""Limits of scripted hands, as their recorded games show them, against the numbers of the scripts.

    python studies/measured_hands.py --seconds 900

Each hand plays against the scripted striker. A hand decides every 30 ms, so its reaction is up to
30 ms longer than its delay. Its error of aim does not include that of its sight, which also turns
shots; the direction of a shot from the offset of the contact alone is printed, too.
"""

import argparse
import json
import math

from one_line import run

import airpuck
from airpuck.hockey.contestant import contestant
from airpuck.hockey.hand import HUMANS
from airpuck.hockey.measured_hand import measured_hand
from airpuck.hockey.rules import Rules
from airpuck.twin.settings import default_twin_settings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=900.0)
    arguments = parser.parse_args()
    settings = default_twin_settings()
    radii = settings.mallet.radius_m + settings.puck.radius_m
    found = {}
    for level, known in HUMANS.items():
        rules = Rules(goals=None, limit_s=arguments.seconds)
        players = contestant("striker:hard"), contestant(f"human:{level}")
        game = airpuck.Game(*players, rules=rules, seed=1)
        game.play()
        found[level] = {
            "measured": measured_hand([game.recording()], settings).to_json(),
            "delay_s": known.reaction_s,
            "speed_m_s": known.speed_m_s,
            "acceleration_m_s2": settings.mallet.acceleration_m_s2,
            "aim_rad": known.aim_rad,
            "aim_and_offset_rad": math.hypot(known.aim_rad, known.noise_m / radii),
        }
    print(json.dumps(found, indent=2))


if __name__ == "__main__":
    run(main)
