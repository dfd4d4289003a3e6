"""Games of people as bags: their results, and what they reveal about each person."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.campaigns.items import Row
from airpuck.craft.table import AirHockey
from airpuck.hockey.measured_hand import MeasuredHand, measured_hand, side_of
from airpuck.recording.bag import METADATA
from airpuck.recording.read import read_recording
from airpuck.recording.stream import COLUMNS, Recording

#: Limits of plausible scores, and of the length of names.
_MOST_GOALS, _LONGEST = 1000, 200


@dataclass(frozen=True)
class RecordedGames:
    """Games of people: each person's hand, and the results, with names of left and right."""

    people: Mapping[str, MeasuredHand]
    games: tuple[tuple[str, str, Row], ...]


def recorded_games(
    folders: Sequence[str | os.PathLike[str]], equipment: AirHockey
) -> RecordedGames:
    """Read the games of people, one folder of bags each; the folder has the person's name."""
    people, games = {}, []
    for folder in map(Path, folders):
        name = folder.resolve().name
        if name in people:
            raise InputError("is the name of two people; rename a folder", field=name)
        if not folder.is_dir():
            raise InputError("there is no such folder", file=folder)
        bags = sorted(path.parent for path in folder.rglob(METADATA))
        if not bags:
            raise InputError(
                "contains no bags; record some with `airpuck play --record`", file=folder
            )
        recordings = [read_recording(bag, needs=("mallet", "puck", "game")) for bag in bags]
        games += [_result(recording, name) for recording in recordings]
        people[name] = measured_hand(recordings, equipment)
    return RecordedGames(people, tuple(games))


def _result(recording: Recording, person: str) -> tuple[str, str, Row]:
    """Return names of left and right, and goals and duration of a game."""
    source, names = recording.source, [recording.about.get(side, "") for side in ("left", "right")]
    if not all(name.isprintable() and 0 < len(name) <= _LONGEST for name in names):
        raise InputError("does not name its players; record it with play --record", file=source)
    if recording.warnings:  # a truncated game has another score
        raise InputError(recording.warnings[0], file=source)
    game, time = recording["game"].values, recording["mallet"].stamp_ns
    score = game[-1, :2] if len(game) else np.zeros(2)
    known = recording["game"].columns == COLUMNS["game"]
    if not known or not ((score >= 0) & (score <= _MOST_GOALS)).all():
        raise InputError("contains no score of a game", file=source, field="game")
    names[side_of(recording) > 0] = person
    if names[0] == names[1]:
        raise InputError("is also the name of the opponent; rename the folder", field=person)
    left, right = score.tolist()
    row = {"left_goals": left, "right_goals": right, "duration_s": float(time[-1] - time[0]) / 1e9}
    return names[0], names[1], row
