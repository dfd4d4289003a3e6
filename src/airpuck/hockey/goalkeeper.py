"""Keeping the goal: where the puck will come, and between puck and goal while it does not."""

from __future__ import annotations

import math

import numpy as np

from airpuck.control.reference import Rendezvous, SetPoint
from airpuck.hockey.interception import Outlook, around, slack, standing
from airpuck.hockey.possession import Catch
from airpuck.hockey.tactic import Intention, View

#: Precision of a block [m, m, rad, m/s, m/s, rad/s]: yaw is free, velocities are loose.
_BLOCK = (0.003, 0.003, math.inf, 0.3, 0.3, math.inf)
#: Time for which the craft covers the last predicted line of an unseen puck [s].
_BLIND = 1.0


class Defend(Catch):
    """Stops a puck that is on its way into the own goal: slows it down, or stands in its way.

    Parameters
    ----------
    reserve : float, default 0.05
        By how much the craft must be able to be early to slow it down [s].
    """

    every = 1

    def __init__(self, reserve: float = 0.05) -> None:
        super().__init__(reserve)

    def applies(self, view: View, outlook: Outlook) -> bool:
        """Return whether the puck threatens the own goal; see `Searcher.applies`."""
        return outlook.threat is not None and super().applies(view, outlook)

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return how to stop the puck; None: there is no danger."""
        caught = super().propose(view, outlook)
        if caught is None and outlook.threat is not None:
            return block(view, outlook)
        return caught


def block(view: View, outlook: Outlook) -> Intention:
    """Stand in the way of the puck where there is most time for it."""
    pitch = view.pitch
    assert outlook.threat is not None
    # Before it is in the goal.
    count = max(int(np.searchsorted(outlook.times, outlook.threat)), 2)
    times, motions = outlook.times[1:count], outlook.motions[1:count, :2]
    speed = np.maximum(np.hypot(motions[:, 0], motions[:, 1]), 1e-6)
    places = outlook.places[1:count] + pitch.contact_distance * motions / speed[:, None]
    places = pitch.clipped(places)
    # Room to be thrown back: not nearer to the rail than home.
    places[:, 0] = np.maximum(places[:, 0], pitch.home[0])
    apart = np.linalg.norm(places - outlook.places[1:count], axis=1)
    late = slack(view, times, places, np.zeros_like(places))
    # What is beyond the fence covers less; of places with time enough the one nearest to here.
    near = np.linalg.norm(places - view.craft[:2], axis=1)
    late = np.minimum(late, 0.1) - 0.2 * near - 2.0 * np.maximum(apart - pitch.contact_distance, 0)
    # A puck that is behind the fence already is not met there any more: the craft would push it on,
    # or stand where it has been.
    passed = ((places - outlook.places[1:count]) * motions).sum(axis=1) < 0
    late -= 5.0 * (passed | (apart < pitch.contact_distance - 0.004))
    best = int(np.argmax(late))
    place, time = places[best], float(times[best])
    # Forwards by half of the recoil, so that it goes back as fast as it came.
    forwards = -pitch.recoil / 2 * motions[best]
    state = (*place, view.craft[2], *forwards, 0.0)
    reference = Rendezvous(time, state, precision=_BLOCK, then=standing(place))
    return Intention("defend", reference, (time, *outlook.places[1 + best].tolist()))


class Wait:
    """Waits at home, between puck and goal; goes round a puck that lies in the way."""

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return where to wait."""
        pitch, puck = view.pitch, outlook.places[0]
        x, y = pitch.home
        before = x + pitch.goal_line
        if puck[0] > x + pitch.contact_distance:
            y = puck[1] * before / (puck[0] + pitch.goal_line)
        goal = pitch.clipped(np.array([x, y]))
        near = np.linalg.norm(puck - goal) < pitch.contact_distance + 0.02
        kind = "wait" if puck[0] < 0 else "home"
        radius = pitch.contact_distance + 0.01
        if near and outlook.speed < 0.3:
            # Someone else's strategy will move the puck; it must not be pushed backwards.
            goal = puck + (goal - puck) / max(np.linalg.norm(goal - puck), 1e-6) * (radius + 0.02)
        if outlook.speed > 0.5 or puck[0] > 0.1:
            return Intention(kind, standing(goal))
        return Intention(kind, around(view, outlook, goal), avoid=(*puck.tolist(), radius))


class Blind:
    """Defends where the puck was last believed to come, and then goes home."""

    def __init__(self) -> None:
        self._since = -math.inf
        self._line = 0.0

    def seen(self, view: View, outlook: Outlook) -> None:
        """Take note of where the puck goes while it is seen."""
        self._since = view.time
        x = view.pitch.home[0]
        before = outlook.places[:, 0] < x
        half = view.pitch.play.table.goal_width_m / 2
        y = outlook.places[int(np.argmax(before)), 1] if before.any() else 0.0
        self._line = float(np.clip(y, -half, half))

    def propose(self, view: View) -> Intention:
        """Return where to stand without a puck."""
        x, y = view.pitch.home
        if view.time - self._since < _BLIND:
            return Intention("defend", SetPoint(x, self._line, 0.0))
        return Intention("home", SetPoint(x, y, 0.0))
