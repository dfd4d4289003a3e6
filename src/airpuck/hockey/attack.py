"""Shooting: the contact that scores most probably, of all that the craft can be in time for."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from airpuck.hockey.interception import (
    Meeting,
    Outlook,
    around,
    effort,
    slack,
    stays_inside,
    way_is_free,
)
from airpuck.hockey.prediction import PuckBelief, predict_path, predict_puck
from airpuck.hockey.shot import ArrivalError, Contacts, chances, flown, struck, unit
from airpuck.hockey.tactic import Intention, Kind, View

#: When a contact may be [s from now]; its directions [rad]; speeds of the craft [m/s].
_TIMES = np.concatenate([np.arange(0.1, 0.6, 0.06), np.arange(0.65, 1.65, 0.1)])
_NORMALS = np.linspace(-1.4, 1.4, 81)
_SPEEDS = np.array([0.5, 0.9, 1.4])
#: So many of the best are looked at closely.
_CLOSELY = 5
#: By which share a chance is worth less a second later.
_PATIENCE = 0.12
#: A better contact must be better by this than the one that is under way.
_BETTER = 0.08
#: A search is made in every so many decisions.
_EVERY = 4
#: Nearer than this before a contact nothing is changed but its place [s].
_COMMITTED = 0.15
#: A contact is kept while the way to it needs at most this share of the craft's acceleration.
_STRAINED = 1.3
#: How long the way of a shot is drawn [s].
_DRAWN = np.arange(0.0, 1.0, 0.025)


class Shoot:
    """Shoots, directly or over banks, where the probability of scoring is high enough.

    Parameters
    ----------
    least : float, default 0.3
        Probability of scoring from which on it shoots.
    error : ArrivalError, optional
        How well the craft keeps a rendezvous.
    speeds : array, shape (L,), optional
        Speeds of the craft that are tried [m/s].
    """

    def __init__(
        self,
        least: float = 0.3,
        error: ArrivalError | None = None,
        speeds: Float[np.ndarray, " L"] = _SPEEDS,
    ) -> None:
        self.least, self.error, self.speeds = least, error or ArrivalError(), speeds
        # Directions spread by errors of the contact.
        self._plan: tuple[Meeting, float, Kind] | None = None
        self._approach: Intention | None = None
        self._age = 0

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return a shot, or the way to where one is possible; None: there is none."""
        if not outlook.known or not outlook.comes(view.pitch.fence[1, 0] + 0.1):
            self._plan = self._approach = None
            return None
        plan = self._still(view, outlook)
        committed = plan is not None and plan[0].time - view.time < _COMMITTED
        self._age += 1
        if not committed and (plan is None or self._age >= _EVERY):
            if plan is None and self._age < _EVERY and self._approach is not None:
                return self._approach
            self._age = 0
            found, approach = self._search(view, outlook)
            keeps = plan is not None and (found is None or found[1] < plan[1] + _BETTER)
            plan = plan if keeps else found
            self._approach = approach
        self._plan = plan
        if plan is None:
            return self._approach
        self._approach = None
        return self._intention(view, outlook, *plan)

    def _still(self, view: View, outlook: Outlook) -> tuple[Meeting, float, Kind] | None:
        """Return the plan under way if it can still be kept."""
        if self._plan is None:
            return None
        meeting = self._plan[0]
        left = meeting.time - view.time
        if left < -0.02:
            return None
        if left < _COMMITTED:
            return self._plan
        place = meeting.place(view, outlook.at(meeting.time))
        velocity = meeting.speed * unit(meeting.normal)
        able = effort(view, meeting.time, place, velocity) < _STRAINED
        return self._plan if able and stays_inside(view, place, velocity) else None

    def _search(
        self, view: View, outlook: Outlook
    ) -> tuple[tuple[Meeting, float, Kind] | None, Intention | None]:
        """Return the best contact of all; or the way to where a better one begins."""
        pitch = view.pitch
        times = view.time + _TIMES
        pucks = np.array([outlook.at(time) for time in times.tolist()])
        near = pucks[:, 0] < pitch.fence[1, 0] + pitch.contact_distance
        times, pucks = times[near], pucks[near]
        if not len(times):
            return None, None
        shape = len(times), len(_NORMALS), len(self.speeds)
        normal = np.broadcast_to(_NORMALS[None, :, None], shape)
        velocity = self.speeds[:, None] * unit(normal)
        place = pucks[:, None, None, :2] - pitch.contact_distance * unit(normal)
        fits = stays_inside(view, place, velocity)
        # Of what the puck does not run away from.
        motion = np.broadcast_to(pucks[:, None, None, 3:], (*shape, 3))
        fits &= ((velocity - motion[..., :2]) * unit(normal)).sum(axis=-1) > 0.2
        late = np.full(shape, -np.inf)
        when = np.broadcast_to(times[:, None, None], shape)
        late[fits] = slack(view, when[fits], place[fits], velocity[fits])
        if not (late > 0).any():
            return None, None
        chance = self._coarse(view, outlook, pucks, normal, velocity)
        value = np.where(late > 0, chance * np.exp(-_PATIENCE * (when - view.time)), -1.0)
        order = np.argsort(value, axis=None)[::-1]
        best = self._apart(np.unravel_index(order, shape), value)
        if not best:
            return None, None
        return self._closely(view, outlook, best, times, pucks)

    def _coarse(
        self,
        view: View,
        outlook: Outlook,
        pucks: Float[np.ndarray, "K 6"],
        normal: Float[np.ndarray, "K J L"],
        velocity: Float[np.ndarray, "K J L 2"],
    ) -> Float[np.ndarray, "K J L"]:
        """Return rough chances: what scores, averaged over directions near by."""
        pitch, shape = view.pitch, normal.shape
        contacts = Contacts(
            np.broadcast_to(pucks[:, None, None, :2], (*shape, 2)),
            np.broadcast_to(pucks[:, None, None, 3:], (*shape, 3)),
            normal,
            velocity,
        )
        after = struck(pitch, contacts)
        flights = flown(pitch.play, contacts.place, after, _opponent(view))
        spread = math.hypot(self.error.place / pitch.contact_distance, 0.02)
        apart = (_NORMALS[:, None] - _NORMALS[None, :]) / spread
        weights = np.exp(-(apart**2) / 2)
        weights /= weights.sum(axis=1, keepdims=True)
        return np.einsum("ji,kil->kjl", weights, flights.scores * flights.passes)

    def _apart(
        self, order: tuple[np.ndarray, ...], value: Float[np.ndarray, "K J L"]
    ) -> list[tuple[int, int, int]]:
        """Return the best few contacts that differ from each other."""
        found: list[tuple[int, int, int]] = []
        for k, j, s in zip(*(part[:200].tolist() for part in order), strict=True):
            if value[k, j, s] < self.least / 3:
                break
            if all(abs(k - a) > 1 or abs(j - b) > 2 or s != c for a, b, c in found):
                found.append((k, j, s))
                if len(found) == _CLOSELY:
                    break
        return found

    def _closely(
        self,
        view: View,
        outlook: Outlook,
        best: list[tuple[int, int, int]],
        times: Float[np.ndarray, " K"],
        pucks: Float[np.ndarray, "K 6"],
    ) -> tuple[tuple[Meeting, float, Kind] | None, Intention | None]:
        """Try the best contacts with all errors; return the best of them."""
        k, j, s = (np.array(part) for part in zip(*best, strict=True))
        normal = _NORMALS[j]
        contacts = Contacts(
            pucks[k, :2], pucks[k, 3:], normal, self.speeds[s][:, None] * unit(normal)
        )
        when = np.unique(k)
        told = predict_puck(view.puck_model, outlook.belief, times[when].tolist()).covariance
        covariance = told[np.searchsorted(when, k)]
        chance, bounces = chances(
            view.pitch, view.puck_model, contacts, covariance, self.error, _opponent(view)
        )
        value = chance * np.exp(-_PATIENCE * (times[k] - view.time))
        blocked = None
        for each in np.argsort(value)[::-1].tolist():
            if chance[each] < self.least:
                break
            meeting = Meeting(
                float(times[k[each]]), float(normal[each]), float(self.speeds[s[each]])
            )
            kind: Kind = "bank" if bounces[each] > 0.5 else "strike"
            if way_is_free(view, outlook, meeting):
                return (meeting, float(chance[each]), kind), None
            blocked = blocked or (meeting, kind, float(chance[each]))
        if blocked is None:
            return None, None
        return None, self._way_to(view, outlook, *blocked)

    def _way_to(
        self, view: View, outlook: Outlook, meeting: Meeting, kind: Kind, chance: float
    ) -> Intention:
        """Go round the puck to where a run-up begins."""
        puck = outlook.at(meeting.time)
        behind = meeting.place(view, puck) - 0.1 * unit(meeting.normal)
        reference = around(view, outlook, behind)
        avoid = (*outlook.places[0].tolist(), view.pitch.contact_distance + 0.01)
        meet = (meeting.time, *puck[:2].tolist())
        return Intention(kind, reference, meet, None, chance, avoid)

    def _intention(
        self, view: View, outlook: Outlook, meeting: Meeting, chance: float, kind: Kind
    ) -> Intention:
        """Return a planned contact as an intention."""
        puck = outlook.at(meeting.time)
        meet = (meeting.time, *puck[:2].tolist())
        path = after_contact(view, meeting, puck)
        return Intention(kind, meeting.reference(view, puck), meet, path, chance)


def after_contact(
    view: View, meeting: Meeting, puck: Float[np.ndarray, " 6"]
) -> Float[np.ndarray, "N 2"]:
    """Return where the puck goes after a contact."""
    contact = Contacts(puck[:2], puck[3:], meeting.normal, meeting.speed * unit(meeting.normal))
    state = np.concatenate([puck[:3], struck(view.pitch, contact)])
    belief = PuckBelief(meeting.time, state, np.zeros((6, 6)))
    return predict_path(view.pitch.play, belief, meeting.time + _DRAWN)[:, :2]


def _opponent(view: View) -> tuple[Float[np.ndarray, " 4"], float] | None:
    """Return the other's disc, if it is seen."""
    if view.opponent is None:
        return None
    return view.opponent, view.pitch.opponent_radius
