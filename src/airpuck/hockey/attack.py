"""Shooting: the reachable contact with the highest probability of scoring."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from airpuck.hockey.interception import (
    Outlook,
    PlannedContact,
    effort,
    run_up,
    slack,
    stays_inside,
    way_is_free,
)
from airpuck.hockey.prediction import PuckBelief, drawn_path, predict_puck
from airpuck.hockey.shot import ArrivalError, Contacts, chances, flown, struck, unit
from airpuck.hockey.tactic import Intention, Kind, View

#: Candidate contacts: times from now [s], directions [rad], speeds of the craft [m/s].
_TIMES = np.concatenate([np.arange(0.1, 0.65, 0.08), np.arange(0.75, 1.7, 0.15)])
_NORMALS = np.linspace(-1.4, 1.4, 61)
_SPEEDS = np.array([0.6, 1.3, 2.1])
#: Number of best candidates that are evaluated with all errors, and directions around each [rad].
_CLOSELY, _ASIDE = 3, np.array([0.0, -0.016, 0.016])
#: Discount rate of the probability of scoring with waiting time [1/s]; a guess.
_PATIENCE = 0.12
#: Gain in probability for which the shot under way is replaced; a guess.
_BETTER = 0.08
#: Search every fourth decision; evaluate the best candidates in the next.
_EVERY = 4
#: After a longer break between calls, the shot under way is dropped [s].
_INTERRUPTED = 0.05
#: Nearer than this before a contact nothing is changed but its place [s].
_COMMITTED = 0.15
#: Largest share of the craft's acceleration that the path to a contact may need: when the contact
#: is planned, and while it is kept. Chosen by matches.
_EASY, _STRAINED = 0.9, 1.4
#: Model of the opponent, guesses: distance of its home from its goal line [m], reaction time [s],
#: and speed on its way home [m/s].
_OPPONENT_WAITS, _OPPONENT_REACTS, _OPPONENT_RETURNS = 0.25, 0.2, 1.5


@dataclass(frozen=True, eq=False)
class _Shot:
    """A planned contact with its probability of scoring."""

    meeting: PlannedContact
    chance: float
    kind: Kind
    path: Float[np.ndarray, "N 2"]


@dataclass(frozen=True, eq=False)
class _Found:
    """Contacts that a search found: times [s], directions [rad], speeds [m/s]."""

    time: Float[np.ndarray, " M"]
    normal: Float[np.ndarray, " M"]
    speed: Float[np.ndarray, " M"]


class Shoot:
    """Shoots, directly or over banks, where the probability of scoring is high enough.

    Parameters
    ----------
    least : float, default 0.05
        Probability of scoring from which on it shoots.
    error : ArrivalError, optional
        How well the craft keeps a rendezvous.
    speeds : array, shape (L,), optional
        Speeds of the craft that are tried [m/s].
    clears : bool, default False
        Whether its shots only get the puck away.
    """

    def __init__(
        self,
        least: float = 0.05,
        error: ArrivalError | None = None,
        speeds: Float[np.ndarray, " L"] = _SPEEDS,
        clears: bool = False,
    ) -> None:
        self.clears = clears
        self.least, self.error, self.speeds = least, error or ArrivalError(), speeds
        self._plan: _Shot | None = None
        #: The path to the start of a shot that is not possible from here.
        self._approach: Intention | None = None
        self._found: _Found | None = None
        self._age, self._asked = _EVERY, -math.inf

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return a shot, or the way to where one is possible; None: there is none."""
        # After a break, a planned contact is out of date.
        interrupted, self._asked = view.time > self._asked + _INTERRUPTED, view.time
        if interrupted:
            self._plan = self._approach = self._found = None
            self._age = _EVERY
        if not outlook.known or not outlook.comes(view.pitch.fence[1, 0] + 0.1):
            self._plan = self._approach = self._found = None
            self._age = _EVERY
            return None
        self._plan = plan = self._still(view, outlook)
        self._age += 1
        if self._found is not None and outlook.take_search():
            self._choose(view, outlook, self._found)
            self._found = None
        elif self._found is None and self._is_due(view, plan) and outlook.take_search():
            self._age, self._found = 0, self._search(view, outlook)
            if self._found is None:
                self._approach = None
        if self._plan is None:
            return self._approach
        return self._intention(view, outlook, self._plan)

    def _is_due(self, view: View, plan: _Shot | None) -> bool:
        """Return whether a search for another contact is due."""
        committed = plan is not None and plan.meeting.time - view.time < _COMMITTED
        return self._age >= _EVERY and not committed

    def _still(self, view: View, outlook: Outlook) -> _Shot | None:
        """Return the plan under way if it can still be kept."""
        if self._plan is None:
            return None
        meeting = self._plan.meeting
        left = meeting.time - view.time
        if left < -0.02:
            return None
        if left < _COMMITTED:
            return self._plan
        place = meeting.place(view, outlook.at(meeting.time))
        velocity = meeting.speed * unit(meeting.normal)
        able = effort(view, meeting.time, place, velocity) < _STRAINED
        return self._plan if able and stays_inside(view, place, velocity) else None

    def _choose(self, view: View, outlook: Outlook, found: _Found) -> None:
        """Adopt the best contact found if it is better than the shot under way."""
        shot, approach = self._closely(view, outlook, found)
        if self._plan is None or (shot and shot.chance > self._plan.chance + _BETTER):
            self._plan = shot
        self._approach = approach if self._plan is None else None

    def _search(self, view: View, outlook: Outlook) -> _Found | None:
        """Return the most promising contacts that the craft can reach in time."""
        pitch = view.pitch
        times = view.time + _TIMES
        pucks = outlook.at(times)
        near = pucks[:, 0] < pitch.fence[1, 0] + pitch.contact_distance
        times, pucks = times[near], pucks[near]
        if not len(times):
            return None
        shape = len(times), len(_NORMALS), len(self.speeds)
        normal = np.broadcast_to(_NORMALS[None, :, None], shape)
        velocity = self.speeds[:, None] * unit(normal)
        place = pucks[:, None, None, :2] - pitch.contact_distance * unit(normal)
        fits = stays_inside(view, place, velocity)
        # The craft must be faster than the puck along the normal.
        motion = np.broadcast_to(pucks[:, None, None, 3:], (*shape, 3))
        fits &= ((velocity - motion[..., :2]) * unit(normal)).sum(axis=-1) > 0.2
        when = np.broadcast_to(times[:, None, None], shape)
        able = np.nonzero(fits)
        able = _of(able, slack(view, when[able], place[able], velocity[able]) > 0)
        # The craft arrives more precisely with thrust to spare.
        able = _of(able, effort(view, when[able], place[able], velocity[able]) < _EASY)
        if not len(able[0]):
            return None
        rows, inverse = np.unique(able[0], return_inverse=True)
        chance = self._coarse(view, times[rows], pucks[rows], normal[rows], velocity[rows])
        value = np.full(shape, -1.0)
        later = np.exp(-_PATIENCE * (when[able] - view.time))
        value[able] = chance[inverse, able[1], able[2]] * later
        best = self._apart(np.unravel_index(np.argsort(value, axis=None)[:-200:-1], shape), value)
        if not best:
            return None
        k, j, s = (np.array(part) for part in zip(*best, strict=True))
        return _Found(times[k], _NORMALS[j], self.speeds[s])

    def _coarse(
        self,
        view: View,
        times: Float[np.ndarray, " K"],
        pucks: Float[np.ndarray, "K 6"],
        normal: Float[np.ndarray, "K J L"],
        velocity: Float[np.ndarray, "K J L 2"],
    ) -> Float[np.ndarray, "K J L"]:
        """Return rough probabilities: whether shots score, averaged over nearby directions."""
        pitch, shape = view.pitch, normal.shape
        contacts = Contacts(
            np.broadcast_to(pucks[:, None, None, :2], (*shape, 2)),
            np.broadcast_to(pucks[:, None, None, 3:], (*shape, 3)),
            normal,
            velocity,
        )
        after = struck(pitch, contacts)
        opponent = _opponent(view, times - view.time)
        others = opponent and (opponent[0][:, None, None], opponent[1])
        flights = flown(pitch.play, contacts.place, after, others)
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
        for k, j, s in zip(*(part.tolist() for part in order), strict=True):
            if value[k, j, s] < self.least / 3:
                break
            if all(abs(k - a) > 1 or abs(j - b) > 2 or s != c for a, b, c in found):
                found.append((k, j, s))
                if len(found) == _CLOSELY:
                    break
        return found

    def _closely(
        self, view: View, outlook: Outlook, found: _Found
    ) -> tuple[_Shot | None, Intention | None]:
        """Evaluate contacts with all errors; return the best, or the path to where it begins."""
        time = np.repeat(found.time, len(_ASIDE))
        speed = np.repeat(found.speed, len(_ASIDE))
        normal = (found.normal[:, None] + _ASIDE).ravel()
        times, where = np.unique(time, return_inverse=True)
        times = np.maximum(times, outlook.times[0])
        told = predict_puck(view.puck_model, outlook.belief, times.tolist())
        pucks = told.mean[where]
        contacts = Contacts(pucks[:, :2], pucks[:, 3:], normal, speed[:, None] * unit(normal))
        opponent = _opponent(view, time - view.time)
        chance, bounces = chances(
            view.pitch,
            view.puck_model,
            contacts,
            told.covariance[where],
            self.error,
            opponent and (opponent[0][:, None], opponent[1]),
        )
        value = chance * np.exp(-_PATIENCE * (time - view.time))
        blocked = None
        for each in np.argsort(value)[::-1].tolist():
            # A later contact of lower value may have a higher chance.
            if chance[each] < self.least:
                continue
            meeting = PlannedContact(float(time[each]), float(normal[each]), float(speed[each]))
            kind: Kind = "bank" if bounces[each] > 0.5 else "strike"
            kind = "clear" if self.clears else kind
            path = after_contact(view, meeting, pucks[each])
            shot = _Shot(meeting, float(chance[each]), kind, path)
            if way_is_free(view, outlook, meeting):
                return shot, None
            blocked = blocked or shot
        if blocked is None:
            return None, None
        return None, self._way_to(view, outlook, blocked)

    def _way_to(self, view: View, outlook: Outlook, shot: _Shot) -> Intention:
        """Return how to go round the puck to the start of the run-up."""
        meeting = shot.meeting
        behind, avoid = run_up(view, outlook, meeting)
        meet = (meeting.time, *outlook.at(meeting.time)[:2].tolist())
        return Intention(shot.kind, behind, meet, shot.path, shot.chance, avoid)

    def _intention(self, view: View, outlook: Outlook, shot: _Shot) -> Intention:
        """Return a planned contact as an intention."""
        meeting = shot.meeting
        puck = outlook.at(meeting.time)
        meet = (meeting.time, float(puck[0]), float(puck[1]))
        return Intention(shot.kind, meeting.reference(view, puck), meet, shot.path, shot.chance)


def _of(indices: tuple[np.ndarray, ...], which: Bool[np.ndarray, " N"]) -> tuple[np.ndarray, ...]:
    """Return some of the indices of an array's elements."""
    return tuple(part[which] for part in indices)


def after_contact(
    view: View, meeting: PlannedContact, puck: Float[np.ndarray, " 6"]
) -> Float[np.ndarray, "N 2"]:
    """Return where the puck goes after a contact."""
    contact = Contacts(puck[:2], puck[3:], meeting.normal, meeting.speed * unit(meeting.normal))
    state = np.concatenate([puck[:3], struck(view.pitch, contact)])
    belief = PuckBelief(meeting.time, state, np.zeros((6, 6)))
    return drawn_path(view.pitch.play, belief)


def _opponent(
    view: View, ahead: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2"], float] | None:
    """Return where the opponent will be on its way home, and its radius; None if unseen."""
    if view.opponent is None:
        return None
    here = view.opponent[:2]
    way = np.array([view.pitch.goal_line - _OPPONENT_WAITS, 0.0]) - here
    covered = _OPPONENT_RETURNS * np.maximum(ahead - _OPPONENT_REACTS, 0.0)
    share = np.minimum(covered / max(float(np.hypot(*way)), 1e-6), 1.0)
    return here + share[:, None] * way, view.pitch.opponent_radius
