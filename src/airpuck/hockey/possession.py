"""Getting the puck under control: slowing it down, and moving it off a rail."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.hockey.interception import (
    Outlook,
    PlannedContact,
    effort,
    run_up,
    slack,
    stays_inside,
    way_is_free,
)
from airpuck.hockey.prediction import PuckBelief, predict_path
from airpuck.hockey.shot import Contacts, struck, unit
from airpuck.hockey.tactic import Intention, View

#: Directions of a contact relative to the reversed motion of the puck [rad].
_BESIDE = np.array([0.0, -0.25, 0.25, -0.55, 0.55])
#: Speed at which a caught puck leaves the craft, so that they separate [m/s].
_LEAVES = 0.05
#: Speeds below which a puck is under control, and below which it may be pushed [m/s].
_SLOW, _PUSHED = 0.06, 0.2
#: A puck at a better place (`good_place`) is not moved.
_GOOD = 0.25
#: Room around a puck that makes a place fully good [m].
_ENOUGH = 0.12
#: Largest share of the craft's acceleration that a kept catch may need; a catch may be imprecise.
_STRAINED = 2.0
#: Times until a push, tried in turn [s], and its directions [rad].
_WAITS, _PUSHES = (0.5, 0.9, 1.3), np.arange(20) * (2 * math.pi / 20)
#: Search for a catch every second decision.
_EVERY = 2
#: A plan is kept so long before a contact, whatever else turns up [s].
_COMMITTED = 0.15


class Catch:
    """Slows a puck down: the craft recedes at the contact, so that nearly nothing is given back.

    Parameters
    ----------
    reserve : float, default 0
        By how much the craft must be able to be early [s].
    slowest : float, optional
        A slower puck is left alone; the default leaves pucks that nearly rest [m/s].
    """

    def __init__(self, reserve: float = 0.0, slowest: float = _SLOW) -> None:
        self.reserve, self.slowest = reserve, slowest
        self._meeting: PlannedContact | None = None
        self._age = _EVERY

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return a contact that slows the puck down; None: there is none, or it is slow."""
        self._age += 1
        meeting = self._still(view, outlook) or self._search(view, outlook)
        self._meeting = meeting
        if meeting is None:
            return None
        puck = outlook.at(meeting.time)
        meet = (meeting.time, *puck[:2].tolist())
        return Intention("prepare", meeting.reference(view, puck), meet)

    def _still(self, view: View, outlook: Outlook) -> PlannedContact | None:
        """Return the contact under way if it can still be kept, for the puck as it moves now."""
        if self._meeting is None or self._meeting.time < view.time - 0.03 or not outlook.known:
            return None
        puck = outlook.at(self._meeting.time)
        speed = float(np.hypot(*puck[3:5]))
        if speed < self.slowest:
            return None
        normal = math.atan2(-puck[4], -puck[3])
        turned = math.remainder(self._meeting.normal - normal, 2 * math.pi)
        if abs(turned) > 0.4:
            return None
        kept = PlannedContact(
            self._meeting.time, self._meeting.normal, _receding(view, speed, turned)
        )
        if kept.time - view.time < _COMMITTED:
            return kept
        place = kept.place(view, puck)
        velocity = kept.speed * unit(kept.normal)
        able = effort(view, kept.time, place, velocity) < _STRAINED
        return kept if able and view.pitch.inside(place) else None

    def _search(self, view: View, outlook: Outlook) -> PlannedContact | None:
        """Return the contact with the most time to spare, at a good place."""
        if not outlook.known or outlook.speed < self.slowest or self._age < _EVERY:
            return None
        if not outlook.take_search():
            return None
        self._age = 0
        motion = outlook.motions[4::3]
        speed = np.hypot(motion[:, 0], motion[:, 1])
        against = np.arctan2(-motion[:, 1], -motion[:, 0])
        normal = against[:, None] + _BESIDE
        recede = _receding(view, speed[:, None], _BESIDE)
        velocity = recede[..., None] * unit(normal)
        place = outlook.places[4::3, None] - view.pitch.contact_distance * unit(normal)
        times = np.broadcast_to(outlook.times[4::3, None], normal.shape)
        closing = speed[:, None] * np.cos(_BESIDE) + recede
        recoil = -view.pitch.recoil * closing[..., None] * unit(normal)
        fits = stays_inside(view, place, velocity, recoil) & (speed[:, None] > self.slowest)
        if not fits.any():
            return None
        late = np.full(normal.shape, -np.inf)
        late[fits] = slack(view, times[fits], place[fits], velocity[fits])
        # Enough time matters more than much; soon is better than late, head-on than aslant.
        value = np.minimum(late - self.reserve, 0.15) - 0.1 * (times - view.time)
        value = (
            value - 0.1 * np.abs(_BESIDE) + 0.3 * good_place(view, outlook.places[4::3])[:, None]
        )
        value[late < self.reserve] = -np.inf
        for index in np.argsort(value, axis=None)[::-1][:6].tolist():
            k, j = divmod(index, len(_BESIDE))
            if not np.isfinite(value[k, j]):
                return None
            meeting = PlannedContact(float(times[k, j]), float(normal[k, j]), float(recede[k, j]))
            if way_is_free(view, outlook, meeting):
                return meeting
        return None


def _receding(view: View, speed: Any, aslant: Any) -> Any:
    """Return the craft's speed along the normal after which the puck leaves it slowly."""
    pitch, puck = view.pitch, view.pitch.play.puck
    gives = pitch.craft_mass / (pitch.craft_mass + puck.mass_kg) * (1 + puck.craft.restitution)
    along = speed * np.cos(aslant)
    return (_LEAVES + along) / gives - along


def good_place(view: View, place: Float[np.ndarray, "K 2"]) -> Float[np.ndarray, " K"]:
    """Return from 0 to 1 how good places of the puck are to shoot from.

    Good are those with room for the craft behind, well within its half.
    """
    pitch, table = view.pitch, view.pitch.play.table
    room = table.width_m / 2 - pitch.play.puck.radius_m - 2 * pitch.craft_radius
    across = np.clip((room - np.abs(place[:, 1])) / _ENOUGH, 0, 1)
    behind = place[:, 0] + pitch.goal_line - pitch.play.puck.radius_m - 2 * pitch.craft_radius
    before = -place[:, 0] - 2 * pitch.contact_distance
    along = np.clip(np.minimum(behind, before) / _ENOUGH, 0, 1)
    return across * along


class Free:
    """Moves a slow puck away from where it cannot be shot: off a rail, out of a corner.

    Parameters
    ----------
    speed : float, default 0.3
        Of the craft at the contact [m/s].
    """

    def __init__(self, speed: float = 0.3) -> None:
        self.speed = speed
        self._meeting: PlannedContact | None = None
        self._turn = -1

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return a gentle push; None: the puck is fast, or out of reach."""
        good = float(good_place(view, outlook.places[:1])[0]) > _GOOD
        if good or outlook.speed > _PUSHED or not outlook.comes(view.pitch.fence[1, 0] + 0.1):
            self._meeting = None
            return None
        kept = self._meeting
        if kept is None or kept.time < view.time - 0.03:
            kept = self._search(view, outlook) if outlook.take_search() else None
        self._meeting = kept
        if kept is None:
            return None
        puck = outlook.at(kept.time)
        meet = (kept.time, *puck[:2].tolist())
        if kept.time - view.time > _COMMITTED and not way_is_free(view, outlook, kept):
            self._meeting = None
            behind, avoid = run_up(view, outlook, kept)
            return Intention("free", behind, meet, avoid=avoid)
        return Intention("free", kept.reference(view, puck), meet)

    def _search(self, view: View, outlook: Outlook) -> PlannedContact | None:
        """Return the push after which the puck is at the best place a second later."""
        self._turn = (self._turn + 1) % len(_WAITS)
        wait = _WAITS[self._turn]
        time = view.time + wait
        puck, normals = outlook.at(time), _PUSHES
        velocity = self.speed * unit(normals)
        place = puck[:2] - view.pitch.contact_distance * unit(normals)
        late = slack(view, np.full(len(normals), time), place, velocity)
        able = view.pitch.inside(place) & (late > 0)
        many = (len(normals), 1)
        contacts = Contacts(np.tile(puck[:2], many), np.tile(puck[3:], many), normals, velocity)
        after = struck(view.pitch, contacts)
        best, found = -0.5, None
        for j in np.flatnonzero(able).tolist():
            state = np.concatenate([puck[:3], after[j]])
            belief = PuckBelief(time, state, np.zeros((6, 6)))
            end = predict_path(view.pitch.play, belief, time + np.array([0.6, 1.0, 1.4, 1.8]))
            if end[:, 0].min() < -view.pitch.goal_line:
                continue
            places = good_place(view, end[:, :2])
            worth = float(places.max() + 0.3 * places.mean()) - 0.2 * wait
            if worth > best:
                best, found = worth, PlannedContact(time, float(normals[j]), self.speed)
        return found
