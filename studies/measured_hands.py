"""Limits of scripted hands, as their recorded games show them, against the numbers of the scripts.

    python studies/measured_hands.py --games 3 --seconds 300

Each hand plays against the scripted striker. A hand decides every 30 ms, so its reaction is up to
30 ms longer than its delay. Its error of sight offsets the contact, which also turns a shot; the
error of aim with this offset is printed, too. The mallet's speed is reduced by its braking within a
period.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from one_line import run

import airpuck_hockey
from airpuck.boundary.errors import InputError
from airpuck.boundary.results import Result
from airpuck.craft.table import AirHockey
from airpuck.recording.stream import Recording
from airpuck.twin.settings import default_twin_settings
from airpuck_hockey.game.contestant import contestant
from airpuck_hockey.game.game import KINDS, PERIOD
from airpuck_hockey.game.hand import HUMANS
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.player.tactic import Frame

# Numbers without a source are guesses.
#: A hand has reacted when it is this far from where it would have been; the onset is extrapolated
#: from the time at which it is four times as far, as for a constant acceleration [m].
_MOVED = 0.002
#: A reaction to a hit starts between these times; 100 ms is the usual lower limit in athletics and
#: in studies of reaction times. Slower movements are drift [s].
_TOO_EARLY, _TOO_LATE, _DRIFTS = 0.1, 0.6, 0.1
#: Time before the hit from which the hand's undisturbed motion is extrapolated [s].
_BEFORE = 0.05
#: Hits closer together belong to one contact [s].
_APART = 0.3
#: A stroke is the movement in this time before a hit [s].
_STROKE = 0.3
#: Half the time over which speeds, and the time over which accelerations are averaged [s].
_HALF = 0.0125
#: The puck's motion after a hit is seen in this interval [s].
_SEEN = (0.01, 0.04)
#: The opponent's hit sends the puck towards the hand at least this fast [m/s].
_COMES = 0.5
#: Movements with a longer gap between poses are left out [s].
_GAP = 0.03
#: Step at which movements are examined [s].
_STEP = 0.0025
#: Quantiles of the strokes' largest speeds and accelerations. The rails stop some strokes at once.
_FAST, _HARD = 0.95, 0.75
#: Initial standard deviation of the aim [rad], and numbers of estimation steps and of resamplings
#: for its interval.
_AIM, _STEPS, _RESAMPLED = 0.2, 60, 200
#: Relative error of speeds and accelerations due to the noise of poses and the averaging: up to
#: 0.5 % for scripted hands whose numbers are known (`python studies/measured_hands.py`).
_ERROR = 0.01
#: Number of samples below which a quantile is not estimated: no interval has 95 % then.
_FEWEST = 6
#: Hits and contacts with rails that end the puck's free motion.
_CONTACTS = [KINDS.index(kind) for kind in ("hit", "rail", "post")]
_HIT = KINDS.index("hit")


@dataclass(frozen=True)
class Measure(Result):
    """A number with its 95 % interval; NaN: too few samples."""

    JSON: ClassVar[str] = "value low high count"

    value: float
    low: float
    high: float
    count: int

    @classmethod
    def of(cls, samples: Iterable[float], share: float, error: float = 0.0) -> Measure:
        """Estimate a quantile of any distribution; `error` widens the interval, relatively."""
        from scipy.stats import quantile_test

        found = np.array(list(samples), dtype=float)
        if len(found) < _FEWEST:
            return cls(math.nan, math.nan, math.nan, len(found))
        interval = quantile_test(found, p=share).confidence_interval()
        low, high = (1 - error) * interval.low, (1 + error) * interval.high
        return cls(float(np.quantile(found, share)), float(low), float(high), len(found))

    @classmethod
    def of_aim(cls, errors: Float[np.ndarray, "n t"]) -> Measure:
        """Estimate the standard deviation of shots from the angles to their possible targets."""
        count = len(errors)
        if count < _FEWEST:
            return cls(math.nan, math.nan, math.nan, count)
        draws = np.random.default_rng(0).integers(0, count, (_RESAMPLED, count))
        low, high = np.quantile([_spread(errors[draw]) for draw in draws], [0.025, 0.975])
        return cls(_spread(errors), float(low), float(high), count)


@dataclass(frozen=True)
class MeasuredHand(Result):
    """Limits of a hand, as far as its games show them."""

    JSON: ClassVar[str] = "reaction_s speed_m_s acceleration_m_s2 aim_rad"

    #: Median time from the opponent's hit to a change of the mallet's motion [s].
    reaction_s: Measure
    #: 95 % quantile of the largest speed in a stroke [m/s]; upper quartile of the acceleration
    #: [m/s²].
    speed_m_s: Measure
    acceleration_m_s2: Measure
    #: Standard deviation of shots about the centre of the goal, direct or off one rail [rad].
    aim_rad: Measure


def measured_hand(recordings: Sequence[Recording], equipment: AirHockey) -> MeasuredHand:
    """Measure the hand that moved the stream ``mallet`` in recorded games."""
    games = [_Game(recording) for recording in recordings]
    strokes = [stroke for game in games for stroke in game.strokes()]
    speed = Measure.of((stroke.speed for stroke in strokes), _FAST, _ERROR)
    # Slower touches stop or carry the puck.
    aimed = [one.errors(equipment) for one in strokes if one.hits_at > speed.value / 2]
    return MeasuredHand(
        Measure.of((time for game in games for time in game.reactions()), 0.5),
        speed,
        Measure.of((stroke.acceleration for stroke in strokes), _HARD, _ERROR),
        Measure.of_aim(np.array([one for one in aimed if one is not None]).reshape(-1, 3)),
    )


def side_of(recording: Recording) -> int:
    """Return the side of the hand that moved ``mallet``: -1 or 1."""
    x = recording["mallet"].values[:, 0]
    if not np.isfinite(x).any():
        raise InputError("has no positions", file=recording.source, field="mallet")
    return 1 if np.nanmedian(x) > 0 else -1


@dataclass(frozen=True, eq=False)
class _Stroke:
    """A movement that ends with a hit."""

    #: Largest speed [m/s] and acceleration [m/s²], and speed at the hit [m/s].
    speed: float
    acceleration: float
    hits_at: float
    #: Position of the puck at the hit, and its motion afterwards, in the hand's frame; None if
    #: something else met the puck too early.
    puck: Float[np.ndarray, " 2"]
    leaves: Float[np.ndarray, " 2"] | None

    def errors(self, equipment: AirHockey) -> Float[np.ndarray, " 3"] | None:
        """Return the angles to all targets [rad]; None if the puck did not go forwards."""
        if self.leaves is None or self.leaves[0] <= 0:
            return None
        # The centre of the goal, and its mirror images in the rails where the puck's centre turns.
        mirrored = equipment.table.width_m - 2 * equipment.puck.radius_m
        targets = np.array([0.0, mirrored, -mirrored])
        aims = np.arctan2(targets - self.puck[1], equipment.table.length_m / 2 - self.puck[0])
        return math.atan2(self.leaves[1], self.leaves[0]) - aims


class _Track:
    """Positions of a disc over time."""

    def __init__(self, recording: Recording, name: str, frame: Frame) -> None:
        stream = recording[name]
        finite = np.isfinite(stream.values[:, :2]).all(axis=1)
        time, first = np.unique(stream.stamp_ns[finite], return_index=True)
        if len(time) < 2:
            raise InputError("has fewer than two positions", file=recording.source, field=name)
        self._time = time / 1e9
        self._place = frame.points(stream.values[finite][first, :2])

    def at(self, times: ArrayLike) -> Float[np.ndarray, "n 2"] | None:
        """Return positions at increasing times; None if poses are missing there."""
        when = np.asarray(times, dtype=float)
        first, last = np.searchsorted(self._time, (when[0], when[-1]))
        around = self._time[max(first - 1, 0) : last + 1]
        if first == 0 or last == len(self._time) or np.diff(around).max(initial=0.0) > _GAP:
            return None
        return np.column_stack([np.interp(when, self._time, axis) for axis in self._place.T])


class _Game:
    """A recorded game, in the frame of the hand."""

    def __init__(self, recording: Recording) -> None:
        side = side_of(recording)
        frame, game = Frame(side), recording["game"]
        self._mallet, self._puck = (_Track(recording, name, frame) for name in ("mallet", "puck"))
        met = np.isin(game.values[:, 2], _CONTACTS)
        self._time, self._own = game.stamp_ns[met] / 1e9, game.values[met, 3] == side
        self._hit = game.values[met, 2] == _HIT

    def _hits(self, *, own: bool) -> Iterator[tuple[float, float]]:
        """Yield each hit of a side, and the next contact, leaving out repeated hits."""
        last = -math.inf
        for number in np.flatnonzero(self._hit):
            time, later = self._time[number], self._time[number + 1 :]
            if self._own[number] == own and time > last + _APART:
                yield float(time), float(later[0]) if len(later) else math.inf
            last = time

    def reactions(self) -> Iterator[float]:
        """Yield times from a hit by the opponent to a change of the hand's motion [s]."""
        for hit, _ in self._hits(own=False):
            puck = self._puck.at([hit + after for after in _SEEN])
            moves = self._mallet.at(hit + np.arange(-_BEFORE, _TOO_LATE, _STEP))
            if puck is None or moves is None:
                continue
            before = round(_BEFORE / _STEP)
            drift = (moves[before] - moves[0]) / before
            later = np.arange(len(moves) - before)[:, None]
            away = np.hypot(*(moves[before:] - moves[before] - drift * later).T)
            if puck[0, 0] - puck[1, 0] > _COMES * (_SEEN[1] - _SEEN[0]):
                near, far = (_first_above(away, n * _MOVED) * _STEP for n in (1, 4))
                onset = 2 * near - far
                if onset > _TOO_EARLY and far - near < _DRIFTS:
                    yield onset

    def strokes(self) -> Iterator[_Stroke]:
        """Yield the strokes of the hand."""
        for hit, next_contact in self._hits(own=True):
            # The mean of a movement over _HALF on both sides must end before the contact.
            moves = self._mallet.at(hit - _HALF - np.arange(_STROKE, 0.0, -_STEP))
            puck = self._puck.at([hit, *(hit + after for after in _SEEN)])
            if moves is None or puck is None:
                continue
            width = round(2 * _HALF / _STEP)
            speeds = np.hypot(*(moves[width:] - moves[:-width]).T) / (2 * _HALF)
            bends = moves[2 * width :] - 2 * moves[width:-width] + moves[: -2 * width]
            yield _Stroke(
                float(speeds.max()),
                float(np.hypot(*bends.T).max()) / (2 * _HALF) ** 2,
                float(speeds[-1]),
                puck[0],
                puck[2] - puck[1] if next_contact > hit + _SEEN[1] else None,
            )


def _first_above(values: Float[np.ndarray, " n"], limit: float) -> float:
    """Return the index, interpolated, at which values that begin at 0 exceed a limit."""
    number = int(np.argmax(values > limit))
    if values[number] <= limit:
        return math.inf
    return number - float((values[number] - limit) / (values[number] - values[number - 1]))


def _spread(errors: Float[np.ndarray, "n t"]) -> float:
    """Return the standard deviation of shots, each at an unknown one of several targets.

    Expectation maximisation for a mixture: normal about each target, with one standard deviation,
    plus touches without a target, uniform over all forward directions.
    """
    spread, weights = _AIM, np.full(errors.shape[1] + 1, 1 / (errors.shape[1] + 1))
    anywhere = np.full((len(errors), 1), 1 / math.pi)
    for _ in range(_STEPS):
        normal = np.exp(-((errors / spread) ** 2) / 2) / (spread * math.sqrt(2 * math.pi))
        shares = weights * np.hstack([normal, anywhere])
        shares /= shares.sum(axis=1, keepdims=True)
        weights, aimed = shares.mean(axis=0), shares[:, :-1]
        # A puck's direction is not known to a milliradian.
        spread = max(math.sqrt((aimed * errors**2).sum() / max(aimed.sum(), 1e-9)), 1e-3)
    return spread


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
            game = airpuck_hockey.Game(*players, rules=rules, seed=seed)
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
