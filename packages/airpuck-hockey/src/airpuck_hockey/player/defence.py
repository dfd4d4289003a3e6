"""Defence: blocking or catching an approaching puck, freeing a resting one, waiting at home."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck import Rendezvous, SetPoint
from airpuck_hockey.player.interception import (
    AVOIDED,
    NOTICED,
    STEP,
    Outlook,
    PlannedContact,
    Searcher,
    around,
    first_clear,
    lengths,
    slack,
    standing,
    stays_inside,
)
from airpuck_hockey.player.shot import Contacts, struck, unit
from airpuck_hockey.player.tactic import Intention, View
from airpuck_hockey.puck.prediction import PuckBelief, predict_path

# Numbers without a source are guesses that won matches.
#: Points of the puck's predicted path at which a catch is tried: up to 1.4 s ahead, because later
#: the path is too uncertain to leave the goal for it.
_TRIED = slice(4, 71, 3)
#: A faster puck is not caught, because it soon threatens the goal again if the catch fails [m/s].
_FAST = 3.0
#: Directions of a contact relative to the reversed motion of the puck, and the largest turn of the
#: puck's motion for which a catch is kept [rad].
_BESIDE, _TURNED = np.array([0.0, -0.25, 0.25, -0.55, 0.55]), 0.4
#: Speed at which a caught puck leaves the craft, so that they separate [m/s].
_LEAVES = 0.05
#: Speeds below which a puck is under control, and below which it may be pushed [m/s].
_SLOW, _PUSHED = 0.06, 0.2
#: A puck in a better position (`good_place`) is not moved.
_GOOD = 0.25
#: Room around a puck that makes a position fully good [m].
_ENOUGH = 0.12
#: Value of a catch, in seconds of spare time. Spare time counts up to the first number [s]. Then:
#: costs per second of waiting and per radian off the puck's motion; gain of a fully good place.
_SPARE, _WAITING, _ASLANT, _AT_GOOD_PLACE = 0.15, 0.1, 0.1, 0.3
#: Number of best catches of which the first with a clear path is planned.
_BEST = 6
#: Times until a push, tried in turn [s], its directions [rad], and the craft's speed [m/s].
_WAITS, _PUSHES, _PUSH = (0.5, 0.9, 1.3), np.arange(20) * (2 * math.pi / 20), 0.3
#: Times after a push at which the puck's place is valued [s]; weight of their mean beside the best;
#: lost per second of waiting.
_AFTER, _MEAN, _PUSH_WAITING = np.array([0.6, 1.0, 1.4, 1.8]), 0.3, 0.2
#: A push must miss the own goal by this [m]: a contact may be a little off.
_MISSES = 0.1
#: Decisions between searches for a catch, and for a push.
_EVERY_CATCH, _EVERY_PUSH = 2, 3


class Catch(Searcher):
    """Slows a puck down: the craft recedes at the contact, so that the puck barely rebounds.

    Parameters
    ----------
    reserve : float, default 0
        Time to spare that the craft needs [s].
    slowest : float, optional
        A slower puck is left alone; the default leaves pucks that are nearly at rest [m/s].
    """

    every = _EVERY_CATCH

    def __init__(self, reserve: float = 0.0, slowest: float = _SLOW) -> None:
        super().__init__()
        self.reserve, self.slowest = reserve, slowest

    def applies(self, view: View, outlook: Outlook) -> bool:
        """Return whether the puck is fast enough to be caught; see `Searcher.applies`."""
        return outlook.known and outlook.speed >= self.slowest

    def updated(self, view: View, outlook: Outlook, plan: PlannedContact) -> PlannedContact | None:
        """Return the catch with its speed adapted to the puck's present motion."""
        vx, vy = outlook.at(plan.time)[3:5].tolist()
        turned = math.remainder(plan.normal - math.atan2(-vy, -vx), 2 * math.pi)
        if abs(turned) > _TURNED or math.hypot(vx, vy) < self.slowest:
            return None
        plan = replace(plan, speed=_receding(view, math.hypot(vx, vy), turned))
        return super().updated(view, outlook, plan)

    def search(self, view: View, outlook: Outlook) -> None:
        """Plan the contact with the most time to spare, at a good place."""
        motion, pucks, when = (x[_TRIED] for x in (outlook.motions, outlook.places, outlook.times))
        speed = np.hypot(motion[:, 0], motion[:, 1])
        normal = np.arctan2(-motion[:, 1], -motion[:, 0])[:, None] + _BESIDE
        recede = _receding(view, speed[:, None], _BESIDE)
        velocity = recede[..., None] * unit(normal)
        place = pucks[:, None] - view.pitch.contact_distance * unit(normal)
        times = np.broadcast_to(when[:, None], normal.shape)
        closing = speed[:, None] * np.cos(_BESIDE) + recede
        recoil = -view.pitch.recoil * closing[..., None] * unit(normal)
        suits = (speed > self.slowest) & (speed < _FAST) & (when <= outlook.until)
        fits = stays_inside(view, place, velocity, recoil) & suits[:, None]
        spare = np.full(normal.shape, -np.inf)
        spare[fits] = slack(view, times[fits], place[fits], velocity[fits])
        # Having enough time matters more than having much; sooner is better, and so is head-on.
        value = np.minimum(spare - self.reserve, _SPARE) - _WAITING * (times - view.time)
        value -= _ASLANT * np.abs(_BESIDE)
        value += _AT_GOOD_PLACE * good_place(view, pucks)[:, None]
        value[spare < self.reserve] = -np.inf
        best = np.argsort(value, axis=None)[::-1][:_BEST]
        found = [
            PlannedContact(float(times.flat[k]), float(normal.flat[k]), float(recede.flat[k]))
            for k in best[np.isfinite(value.flat[best])]
        ]
        self._plan = first_clear(view, outlook, found)


def _receding(view: View, speed: Any, aslant: Any) -> Any:
    """Return the normal speed of the craft that lets the puck leave slowly."""
    pitch, puck = view.pitch, view.pitch.equipment.puck
    gives = pitch.craft_mass / (pitch.craft_mass + puck.mass_kg) * (1 + puck.craft.restitution)
    along = speed * np.cos(aslant)
    return (_LEAVES + along) / gives - along


def _aims_at_goal(
    view: View, puck: Float[np.ndarray, " 6"], after: Float[np.ndarray, " 3"]
) -> bool:
    """Return whether a puck moves towards the own goal, or narrowly past it."""
    table = view.pitch.equipment.table
    if after[0] >= 0.0:
        return False
    ahead = (view.pitch.goal_line + puck[0]) / -after[0]
    return abs(float(puck[1] + after[1] * ahead)) < table.goal_width_m / 2 + _MISSES


def good_place(view: View, place: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, " K"]:
    """Return how good places of the puck are to shoot from, 0 to 1.

    A good place has room for the craft behind the puck, well within its half.
    """
    pitch, table = view.pitch, view.pitch.equipment.table
    room = table.width_m / 2 - pitch.equipment.puck.radius_m - 2 * pitch.craft_radius
    across = np.clip((room - np.abs(place[:, 1])) / _ENOUGH, 0, 1)
    behind = place[:, 0] + pitch.goal_line - pitch.equipment.puck.radius_m - 2 * pitch.craft_radius
    before = -place[:, 0] - 2 * pitch.contact_distance
    return across * np.clip(np.minimum(behind, before) / _ENOUGH, 0, 1)


class Free(Searcher):
    """Moves a slow puck away from where it cannot be shot: off a rail, out of a corner."""

    every = _EVERY_PUSH

    def __init__(self) -> None:
        super().__init__()
        self._turn = -1

    def applies(self, view: View, outlook: Outlook) -> bool:
        """Return whether a slow puck is at a bad place in reach; see `Searcher.applies`."""
        good = float(good_place(view, outlook.places[:1])[0]) > _GOOD
        return outlook.known and outlook.speed <= _PUSHED and outlook.is_reachable and not good

    def search(self, view: View, outlook: Outlook) -> None:
        """Plan the push that moves the puck to the best places."""
        self._turn = (self._turn + 1) % len(_WAITS)
        wait = _WAITS[self._turn]
        time = view.time + wait
        puck, normals = outlook.at(time), _PUSHES
        velocity = _PUSH * unit(normals)
        place = puck[:2] - view.pitch.contact_distance * unit(normals)
        able = stays_inside(view, place, velocity)
        able &= slack(view, np.full(len(normals), time), place, velocity) > 0
        many = (len(normals), 1)
        contacts = Contacts(np.tile(puck[:2], many), np.tile(puck[3:], many), normals, velocity)
        after = struck(view.pitch, contacts)
        best, found = -math.inf, []
        for j in np.flatnonzero(able).tolist():
            if _aims_at_goal(view, puck, after[j]):
                continue
            belief = PuckBelief(time, np.concatenate([puck[:3], after[j]]), np.zeros((6, 6)))
            end = predict_path(view.pitch.equipment, belief, time + _AFTER)
            # Not into the own goal, and not to the opponent.
            if end[:, 0].min() < -view.pitch.goal_line or end[:, 0].max() > 0:
                continue
            places = good_place(view, end[:, :2])
            value = float(places.max() + _MEAN * places.mean()) - _PUSH_WAITING * wait
            if value > best:
                best, found = value, [PlannedContact(time, float(normals[j]), _PUSH, "free")]
        self.adopt(view, outlook, found)


#: Precision of a block [m, m, rad, m/s, m/s, rad/s]: yaw is free, velocities are loose.
_BLOCK = (0.003, 0.003, math.inf, 0.3, 0.3, math.inf)
# The following numbers are guesses that won matches. Value of a block in seconds to spare: beyond
# this, more time to spare is worth nothing [s]; cost per metre of distance; cost per metre off the
# puck's path; cost of a block behind the puck.
_BLOCK_SPARE, _AWAY, _OFF_PATH, _PASSED = 0.1, 0.2, 2.0, 5.0
#: Largest offset of a puck that the craft surely stops, as a share of the contact distance.
_SQUARE = 0.5
#: Overlap of craft and puck at a block that the fence allows [m].
_OVERLAP = 0.004
#: Distance to a resting puck at which the craft waits [m], beyond the disc to avoid.
_NEAR = 0.02
#: Slowest puck that is pushed [m/s]; fastest puck that is avoided [m/s], and how far it may be in
#: the other half [m].
_PUSHABLE, _AVOIDABLE, _OTHER_HALF = 0.3, 0.5, 0.1
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
    value = np.minimum(spare, _BLOCK_SPARE) - _AWAY * lengths(places - view.craft[:2])
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
    if motion[0] > -_PUSHABLE or outlook.threat is None:
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
        if apart < pitch.contact_distance + _NEAR and outlook.speed < _PUSHABLE:
            # Another strategy will move the puck; it must not be pushed backwards.
            goal = puck + (goal - puck) / max(apart, _RESTS) * (radius + _NEAR)
        if outlook.speed > _AVOIDABLE or puck[0] > _OTHER_HALF:
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
