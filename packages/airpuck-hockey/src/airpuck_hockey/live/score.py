"""The score of a game on the graph, from the measurements of the flying process."""

from __future__ import annotations

from typing import Any

from airpuck import AirHockey, Measurement, Pilot
from airpuck.extend import Action, Process
from airpuck_hockey.game.rules import Ruling
from airpuck_hockey.game.scorekeeper import Scorekeeper

#: Players on the left and on the right.
NAMES = ("airpuck", "human")
#: Message of a ruling; filled in with the score, the player concerned, and the other.
_SAID = {
    "goal": "goal for {1}, {0}",
    "foul": "foul by {1}, the puck stayed too long on its side; {2} serves, {0}",
    "stuck": "the puck is stuck at the centre line; serve it again, {0}",
    "over": "{1} wins {0}; the next serve begins another game",
}


class Score:
    """Keeps the score of a flight that plays, and reports changes; a `Spectator`."""

    def __init__(self, equipment: AirHockey) -> None:
        self.keeper = Scorekeeper(equipment)
        #: Rulings of the latest period.
        self.rulings: list[Ruling] = []
        self._sight: str | None = None
        self._new: list[Measurement] = []

    def begin(self, process: Process, pilot: Pilot) -> None:
        """Receive the participants; see `Spectator`."""
        self._events, self._pilot = process.events, pilot

    def measured(self, measurement: Measurement) -> None:
        """Store a pose until the command has left; see `Spectator`."""
        self._new.append(measurement)

    def after(self, action: Action) -> None:
        """Log rulings, and whether the puck is visible; see `Spectator`."""
        self.rulings = []
        # Poses of several bodies come body by body.
        for one in sorted(self._new, key=lambda one: one.stamp):
            if one.kind == "puck":
                self.keeper.puck(one.stamp, one.values)
            else:
                self.keeper.frame(one.stamp)
            # Process frame by frame, even if several have arrived at once.
            self.rulings += self.keeper.judge()
        self._new.clear()
        left, right = self.keeper.score
        for kind, side in self.rulings:
            names = NAMES[:: -1 if side > 0 else 1]
            said = _SAID[kind].format(f"{left} : {right}", *names)
            self._events.log("info", said, kind=said)
        sight = getattr(self._pilot, "sight", self._sight)
        if sight != self._sight:
            self._sight = sight
            level = "warning" if sight in ("frozen", "lost") else "info"
            self._events.log(level, f"the puck is {sight}", kind="puck")

    def to_json(self) -> dict[str, Any]:
        """Return score, games, and goals and fouls in all games; see `Spectator`."""
        calls = self.keeper.calls
        return {
            "score": list(self.keeper.score),
            "games": self.keeper.games,
            **{f"{kind}s": [calls[kind, -1], calls[kind, 1]] for kind in ("goal", "foul")},
        }
