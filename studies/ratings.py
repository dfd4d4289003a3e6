"""Ratings of a league's players on the Elo scale (Bradley and Terry, Biometrika 39, 1952).

    airpuck league keeper striker airpuck:hard --games 20 --json league.json
    python studies/ratings.py league.json -o league.png
    python studies/ratings.py league.json --bags anna/ ben/    # games by airpuck play --record

A lead of 400 points means odds of ten to one. A draw counts as half a win, and the mean is 0. Each
rating has a 95 % interval; a player who won or lost all games gets a finite rating with a wide one.
With recorded games of people, each goal is a contest, because people play few games, and the limits
of each person's hand are measured. The figure shows the goals of each pair, and the ratings.
"""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from measured_hands import MeasuredHand, measured_hand, side_of
from one_line import run

from airpuck.boundary.errors import InputError
from airpuck.campaigns.items import Row
from airpuck.craft.table import AirHockey
from airpuck.recording.bag import METADATA
from airpuck.recording.read import read_recording
from airpuck.recording.stream import COLUMNS, Recording
from airpuck.report import style
from airpuck.twin.settings import default_twin_settings

#: Lead on the Elo scale at which the odds of a win are ten to one.
ELO = 400.0
#: Prior standard deviation of ratings [Elo]: even a player who won or lost all games gets a finite
#: rating. The odds of most pairs are then between 1 : 30 and 30 : 1. A guess.
_SPREAD = 420.0
#: Newton's method stops at changes below this [log odds].
_EXACT = 1e-9


def ratings(
    points: Float[np.ndarray, "p p"],
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]]:
    """Rate players by their points against each other.

    The probability that i beats j is 1 / (1 + 10^((R_j - R_i) / 400)); a draw is half a win. The
    ratings are the mode of the posterior for independent normal ratings, with the covariance of its
    normal approximation.

    Parameters
    ----------
    points : array, shape (p, p)
        Entry i, j: games that player i won against j, plus half of those drawn.

    Returns
    -------
    rating : array, shape (p,)
        Elo ratings with mean 0.
    covariance : array, shape (p, p)
        Covariance of the ratings [Elo²].
    """
    scale = ELO / math.log(10)
    games, count = points + points.T, len(points)
    prior, value, step = (scale / _SPREAD) ** 2, np.zeros(count), np.full(count, np.inf)
    hessian = prior * np.eye(count)
    while np.abs(step).max() > _EXACT:
        chance = 1 / (1 + np.exp(value[None, :] - value[:, None]))
        gradient = (points - games * chance).sum(axis=1) - prior * value
        weight = games * chance * (1 - chance)
        hessian = np.diag(weight.sum(axis=1) + prior) - weight
        # Far from the mode a full Newton step may overshoot.
        step = np.clip(np.linalg.solve(hessian, gradient), -1.0, 1.0)
        value = value + step
    # Relative to the mean, which games do not determine.
    centred = np.eye(count) - 1 / count
    covariance = centred @ np.linalg.inv(hessian) @ centred
    return scale * centred @ value, scale**2 * covariance


#: Half the width of a 95 % interval, in standard errors.
_QUANTILE = 1.96
#: Goals per minute at which the colours of the figure are strongest.
_MOST = 4.0


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


def total(league: dict[str, Any], name: str) -> Float[np.ndarray, "p p"]:
    """Return a figure of each pair: entry i, j is that of player i against player j."""
    rows = [[(cell or {}).get(name, 0) for cell in row] for row in league["matrix"]]
    return np.array(rows, dtype=float)


def with_people(league: dict[str, Any], folders: list[Path]) -> dict[str, Any]:
    """Add recorded games of people to the results of a league."""
    recorded = recorded_games(folders, default_twin_settings())
    players = list(dict.fromkeys([*league["players"], *(n for g in recorded.games for n in g[:2])]))
    empty = dict.fromkeys(("games", "wins", "losses", "goals_for", "goals_against", "seconds"), 0)
    cells = {(a, b): dict(empty) for a in players for b in players}
    for one, row in zip(league["players"], league["matrix"], strict=True):
        for other, cell in zip(league["players"], row, strict=True):
            cells[one, other] |= cell or {}
    for left, right, game in recorded.games:
        goals = game["left_goals"], game["right_goals"]
        for one, other, (own, against) in ((left, right, goals), (right, left, goals[::-1])):
            cell = cells[one, other]
            cell["games"] += 1
            cell["wins"] += own > against
            cell["losses"] += own < against
            cell["goals_for"] += own
            cell["goals_against"] += against
            cell["seconds"] += game["duration_s"]
    matrix = [[cells[a, b] if a != b else None for b in players] for a in players]
    people = {name: hand.to_json() for name, hand in recorded.people.items()}
    return {"players": players, "matrix": matrix, "people": people}


def rated(league: dict[str, Any]) -> Float[np.ndarray, "p 3"]:
    """Return the rating of each player, and the ends of its 95 % interval."""
    points = total(league, "wins")
    points += (total(league, "games") - points - points.T) / 2
    if league.get("people"):
        points = total(league, "goals_for")
    value, covariance = ratings(points)
    half = _QUANTILE * np.sqrt(np.diag(covariance))
    return np.column_stack([value, value - half, value + half])


@style.styled
def league_figure(league: dict[str, Any], found: Float[np.ndarray, "p 3"]) -> Figure:
    """Draw the matrix of scores, and the ratings with their intervals, strongest first."""
    order = np.argsort(-found[:, 0])
    height = 1.2 + 0.36 * len(order)
    figure = style.new_figure(style.PAGE_WIDTH, height)
    matrix, rating = figure.subplots(1, 2, sharey=True, width_ratios=(1.9, 1))
    _draw_scores(matrix, league, order)
    value, low, high = found[order].T
    rows = np.arange(len(order))
    rating.errorbar(value, rows, xerr=(value - low, high - value), fmt="o", color=style.BLUE)
    rating.set(xlabel="rating [Elo]", title="rating, 95 % interval")
    return figure


def _draw_scores(axes: Axes, league: dict[str, Any], order: np.ndarray) -> None:
    """Draw the goals of each player against each other, coloured by the difference per minute."""
    goals, seconds = (
        total(league, name)[np.ix_(order, order)] for name in ("goals_for", "seconds")
    )
    lead = (goals - goals.T) / np.where(seconds > 0, seconds / 60, np.nan)
    axes.imshow(lead, cmap="RdBu", vmin=-_MOST, vmax=_MOST, aspect="auto")
    for row, column in np.argwhere(seconds > 0):
        text = f"{goals[row, column]:.0f}:{goals[column, row]:.0f}"
        color = "white" if abs(lead[row, column]) > _MOST / 2 else style.BLACK
        axes.text(column, row, text, ha="center", va="center", fontsize="small", color=color)
    names = [league["players"][number] for number in order]
    axes.set_xticks(range(len(names)), names, rotation=40, ha="right")
    axes.set_yticks(range(len(names)), names)
    axes.set_title("goals for : against")
    axes.grid(visible=False)


def main() -> None:
    """Rate the players, strongest first."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("league", type=Path, nargs="?", help="results of airpuck league --json")
    parser.add_argument("--bags", type=Path, nargs="+", default=[], help="folder of each person")
    parser.add_argument("-o", "--output", type=Path, help="PNG file for the figure")
    options = parser.parse_args()
    if options.league is None and not options.bags:
        parser.error("give the results of a league, or --bags")
    league: dict[str, Any] = {"players": [], "matrix": []}
    if options.league is not None:
        league = json.loads(options.league.read_text("utf-8"))
    if options.bags:
        league = with_people(league, options.bags)
    found = rated(league)
    for number in np.argsort(-found[:, 0]):
        value, low, high = found[number]
        print(f"{value:+5.0f} ({low:+.0f} to {high:+.0f})  {league['players'][number]}")
    for name, hand in league.get("people", {}).items():
        print(f"{name}: {json.dumps(hand)}")
    if options.output:
        style.write_figure(league_figure(league, found), options.output)


if __name__ == "__main__":
    run(main)
