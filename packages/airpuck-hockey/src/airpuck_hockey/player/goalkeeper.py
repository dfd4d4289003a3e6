"""Keeping the goal: blocking an approaching puck, and waiting between puck and goal."""

from __future__ import annotations

import math

import numpy as np

from airpuck import Rendezvous, SetPoint
from airpuck_hockey.player.interception import (
    AVOIDED,
    NOTICED,
    STEP,
    Outlook,
    around,
    lengths,
    slack,
    standing,
)
from airpuck_hockey.player.possession import Catch
from airpuck_hockey.player.tactic import Intention, View

#: Precision of a block [m, m, rad, m/s, m/s, rad/s]: yaw is free, velocities are loose.
_BLOCK = (0.003, 0.003, math.inf, 0.3, 0.3, math.inf)
# The following numbers are guesses that won matches. Value of a block in seconds to spare: beyond
# this, more time to spare is worth nothing [s]; cost per metre of distance; cost per metre off the
# puck's path; cost of a block behind the puck.
_SPARE, _AWAY, _OFF_PATH, _PASSED = 0.1, 0.2, 2.0, 5.0
#: Largest offset of a puck that the craft surely stops, as a share of the contact distance.
_SQUARE = 0.5
#: Overlap of craft and puck at a block that the fence allows [m].
_OVERLAP = 0.004
#: Distance to a resting puck at which the craft waits [m], beyond the disc to avoid.
_NEAR = 0.02
#: Slowest puck that is pushed [m/s]; fastest puck that is avoided [m/s], and how far it may be in
#: the other half [m].
_SLOW, _FAST, _OTHER_HALF = 0.3, 0.5, 0.1
#: Vectors shorter than this have no direction [m, m/s].
_RESTS = 1e-6
#: Time for which the craft covers the last predicted line of an unseen puck [s].
_BLIND = 1.0


class Defend(Catch):
    """Stops a puck that is moving into the own goal: slows it down, or stands in its path.

    Parameters
    ----------
    reserve : float, default 0.05
        Time to spare that the craft needs to slow the puck down [s].
    """

    every = 1

    def __init__(self, reserve: float = 0.05) -> None:
        super().__init__(reserve)

    def applies(self, view: View, outlook: Outlook) -> bool:
        """Return whether the puck threatens the own goal; see `Searcher.applies`."""
        return outlook.threat is not None and super().applies(view, outlook)

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return how to stop the puck; None if it is no threat."""
        caught = super().propose(view, outlook)
        if caught is None and outlook.threat is not None:
            return braked(view, outlook) or block(view, outlook)
        return caught


def block(view: View, outlook: Outlook) -> Intention:
    """Stand in the puck's path at the nearest place that the craft reaches in time."""
    pitch = view.pitch
    assert outlook.threat is not None
    # Before it is in the goal.
    count = max(int(np.searchsorted(outlook.times, outlook.threat)), 2)
    times, pucks = outlook.times[1:count], outlook.places[1:count]
    motions = outlook.motions[1:count, :2]
    speed = np.maximum(np.hypot(motions[:, 0], motions[:, 1]), _RESTS)
    places = pitch.clipped(pucks + pitch.contact_distance * motions / speed[:, None])
    # Leave room for the recoil, but no more than home does: deep in the goal the craft covers more.
    back = np.maximum(-pitch.recoil * motions[:, 0], 0)
    room = back * NOTICED + back**2 / (2 * pitch.acceleration)
    places[:, 0] = np.maximum(places[:, 0], np.minimum(pitch.fence[0, 0] + room, pitch.home[0]))
    apart = lengths(places - pucks)
    spare = slack(view, times, places, np.zeros_like(places))
    value = np.minimum(spare, _SPARE) - _AWAY * lengths(places - view.craft[:2])
    # A craft that the fence keeps off the puck's path covers less of the goal.
    value -= _OFF_PATH * np.maximum(apart - pitch.contact_distance, 0)
    # Behind the fence the craft would push the puck on, or come after the puck has passed.
    passed = ((places - pucks) * motions).sum(axis=1) < 0
    value -= _PASSED * (passed | (apart < pitch.contact_distance - _OVERLAP))
    best = int(np.argmax(value))
    place, time = places[best], float(times[best])
    # Move forwards at half the recoil speed, so that the craft ends up moving back as fast.
    forwards = -pitch.recoil / 2 * motions[best]
    state = (*place, view.craft[2], *forwards, 0.0)
    reference = Rendezvous(time, state, precision=_BLOCK, then=standing(place))
    return Intention("defend", reference, (time, *pucks[best].tolist()))


def braked(view: View, outlook: Outlook) -> Intention | None:
    """Brake if the puck will then meet the craft squarely; None: it will not.

    Otherwise the puck would throw a craft that moves towards its own goal against the rail.
    """
    pitch, motion = view.pitch, view.craft[3:5]
    speed = float(np.hypot(*motion))
    if motion[0] > -_SLOW or outlook.threat is None:
        return None
    before = outlook.times < outlook.threat
    left = np.maximum(outlook.times[before] - view.time - pitch.delay, 0.0)
    lasts = np.minimum(left, speed / pitch.acceleration)
    gone = pitch.delay + lasts - pitch.acceleration / (2 * speed) * lasts**2
    apart = outlook.places[before] - view.craft[:2] - gone[:, None] * motion
    closing = outlook.motions[before, :2] - motion
    # Distance at which a puck that goes straight on passes the craft.
    aside = np.abs(apart[:, 0] * closing[:, 1] - apart[:, 1] * closing[:, 0])
    aside /= np.maximum(np.hypot(*closing.T), _RESTS)
    touches = np.hypot(*apart.T) < pitch.contact_distance + STEP * np.hypot(*closing.T)
    if not touches.any():
        return None
    first = int(np.argmax(touches))
    if aside[first] > _SQUARE * pitch.contact_distance:
        return None
    stop = view.craft[:2] + motion * (pitch.delay + speed / (2 * pitch.acceleration))
    meet = (float(outlook.times[first]), *outlook.places[first].tolist())
    return Intention("defend", standing(pitch.clipped(stop)), meet)


class Wait:
    """Waits at home, between puck and goal; goes round a puck that lies in between."""

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return the waiting position."""
        pitch, puck = view.pitch, outlook.places[0]
        x, y = pitch.home
        before = x + pitch.goal_line
        if puck[0] > x + pitch.contact_distance:
            y = puck[1] * before / (puck[0] + pitch.goal_line)
        goal = pitch.clipped(np.array([x, y]))
        apart = float(np.linalg.norm(goal - puck))
        kind = "wait" if puck[0] < 0 else "home"
        radius = pitch.contact_distance + AVOIDED
        if apart < pitch.contact_distance + _NEAR and outlook.speed < _SLOW:
            # Another strategy will move the puck; it must not be pushed backwards.
            goal = puck + (goal - puck) / max(apart, _RESTS) * (radius + _NEAR)
        if outlook.speed > _FAST or puck[0] > _OTHER_HALF:
            return Intention(kind, standing(goal))
        return Intention(kind, around(view, outlook, goal), avoid=(*puck.tolist(), radius))


class Blind:
    """Defends the last predicted line of an unseen puck, and then goes home."""

    def __init__(self) -> None:
        self._since = -math.inf
        self._line = 0.0

    def seen(self, view: View, outlook: Outlook) -> None:
        """Remember where the puck will cross the line through the home position."""
        self._since = view.time
        before = outlook.places[:, 0] < view.pitch.home[0]
        half = view.pitch.equipment.table.goal_width_m / 2
        y = outlook.places[int(np.argmax(before)), 1] if before.any() else 0.0
        self._line = float(np.clip(y, -half, half))

    def propose(self, view: View) -> Intention:
        """Return the position to take without a puck."""
        x, y = view.pitch.home
        if view.time - self._since < _BLIND:
            return Intention("defend", SetPoint(x, self._line, 0.0))
        return Intention("home", SetPoint(x, y, 0.0))
