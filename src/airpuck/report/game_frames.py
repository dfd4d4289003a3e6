"""What an animation shows of a game beside the craft: puck, the other's disc, the score."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck.craft.table import AirHockey
from airpuck.recording.stream import Recording, Stream

#: Poses farther apart in time are not joined: the puck was in a goal [s].
PAUSE = 0.1


@dataclass(frozen=True, eq=False)
class Way:
    """Where something was, over time."""

    #: Strictly increasing [s].
    time: Float[np.ndarray, " N"]
    #: x, y [m], yaw (continuous) [rad].
    pose: Float[np.ndarray, "N 3"]


@dataclass(frozen=True, eq=False)
class GameScene:
    """A part of a game."""

    #: Sizes.
    play: AirHockey
    puck: Way
    #: The disc on the other side, where it was recorded.
    other: Way | None
    #: Whether that is a craft, not a mallet.
    other_flies: bool
    #: Sign of the x of the craft's half.
    side: int
    #: When the score changed [s], and goals of left and right from then on.
    score_time: Float[np.ndarray, " G"]
    score: Float[np.ndarray, "G 2"]

    def score_at(self, time: float) -> tuple[int, int] | None:
        """Return the goals of left and right at a moment [s]; None where nobody counts."""
        k = int(np.searchsorted(self.score_time, time, side="right")) - 1
        if k < 0:
            return (0, 0) if len(self.score_time) else None
        left, right = self.score[k].astype(int).tolist()
        return left, right


def read_game(
    recording: Recording,
    play: AirHockey,
    usable: Callable[[Stream, str], tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N k"]]],
    side: int,
    span: tuple[float, float],
) -> GameScene | None:
    """Take from a recording what belongs to a game; None without a puck.

    `usable` gives times on the axis of the scene, and values, of what can be used of a stream.
    """

    def way(name: str) -> Way | None:
        if not len(recording.streams.get(name, ())):
            return None
        time, pose = usable(recording[name], name)
        inside = (time >= span[0]) & (time <= span[1])
        if not inside.any():
            return None
        yaw = np.unwrap(pose[inside, 2])
        return Way(time[inside], np.column_stack([pose[inside, :2], yaw]))

    puck = way("puck")
    if puck is None:
        return None
    time, score = np.zeros(0), np.zeros((0, 2))
    if len(recording.streams.get("game", ())):
        time, events = usable(recording["game"], "game")
        score = events[:, :2]
    flies = "opponent_command" in recording.streams
    return GameScene(play, puck, way("mallet"), flies, side, time, score)
