"""Getting the puck under control: slowing it down, and moving it off a rail."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck_hockey.player.interception import Outlook, PlannedContact, slack, stays_inside
from airpuck_hockey.player.searching import Searcher, first_clear
from airpuck_hockey.player.shot import Contacts, struck, unit
from airpuck_hockey.player.tactic import View
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
