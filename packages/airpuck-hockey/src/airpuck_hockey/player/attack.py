"""Shooting: the reachable contact with the highest probability of scoring."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from airpuck_hockey.player.interception import (
    Outlook,
    PlannedContact,
    Searcher,
    effort,
    slack,
    stays_inside,
)
from airpuck_hockey.player.shot import ArrivalError, Contacts, Opposed, chances, flown, struck, unit
from airpuck_hockey.player.tactic import ActionKind, View
from airpuck_hockey.puck.prediction import PuckBelief, drawn_path, predict_puck

#: Candidate contacts: times from now [s], directions [rad], speeds of the craft [m/s].
_TIMES = np.concatenate([np.arange(0.1, 0.65, 0.08), np.arange(0.75, 1.7, 0.15)])
_NORMALS = np.linspace(-1.4, 1.4, 61)
SPEEDS = np.array([0.6, 1.5, 2.3])
#: Number of best candidates that are evaluated with all errors, and directions around each [rad].
_CLOSELY, _ASIDE = 3, np.array([0.0, -0.016, 0.016])
#: Number of candidates that the best are picked from.
_PICKED = 200
#: Only candidates above this share of the smallest accepted probability get all errors.
_PROMISING = 1 / 3
#: Least difference of the speeds of craft and puck along the normal [m/s].
_FASTER = 0.2
#: Additional error of a shot's direction in the first evaluation [rad].
_DIRECTION_ERROR = 0.02
#: A shot whose mean number of banks is higher is a bank shot.
_BANKED = 0.5
#: Discount rate of the probability of scoring with waiting time [1/s]; a guess.
_PATIENCE = 0.12
#: Value of a shot per speed of the puck along the table [s/m]: a saved fast shot comes back soon,
#: a slow one is the opponent's to strike, or dies in its half. A guess.
_PRESSURE = 0.03
#: Probability that the opponent scores if the puck comes back before the craft; a guess.
_CONCEDED = 0.4
#: Gain in value for which the planned shot is replaced; a guess.
_BETTER = 0.04
#: Decisions between searches for shots, and for the fallback that only clears the puck.
_EVERY, _EVERY_CLEAR = 4, 5
#: Largest share of the craft's acceleration that the path to a new contact may need. Chosen by
#: matches.
_EASY = 0.9
#: An opponent this near to its home has arrived [m].
_AT_HOME = 1e-6


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Contacts that a search found: times [s], directions [rad], speeds [m/s]."""

    time: Float[np.ndarray, " M"]
    normal: Float[np.ndarray, " M"]
    speed: Float[np.ndarray, " M"]


class Shoot(Searcher):
    """Shoots, directly or off the rails, if the probability of scoring is high enough.

    Parameters
    ----------
    least : float, default 0.12
        Smallest value of a shot: its probability of scoring, and its speed and risk.
    error : ArrivalError, optional
        The craft's errors at a rendezvous.
    speeds : array, shape (L,), optional
        Speeds of the craft that are tried [m/s].
    clears : bool, default False
        Whether its shots only clear the puck.

    Examples
    --------
    >>> airpuck_hockey.Shoot(least=0.3).clears
    False
    """

    def __init__(
        self,
        least: float = 0.12,
        error: ArrivalError | None = None,
        speeds: Float[np.ndarray, " L"] = SPEEDS,
        clears: bool = False,
    ) -> None:
        super().__init__()
        self.clears, self._period = clears, _EVERY_CLEAR if clears else _EVERY
        self.least, self.error, self.speeds = least, error or ArrivalError(), speeds
        self._candidates: _Candidates | None = None
        self.every = self._period

    def applies(self, view: View, outlook: Outlook) -> bool:
        """Return whether the puck comes within reach; see `Searcher.applies`."""
        return outlook.known and outlook.is_reachable

    def wants_search(self, view: View, outlook: Outlook) -> bool:
        """Return whether a better shot could still be taken; see `Searcher.wants_search`."""
        if self._plan is not None and self._plan.is_committed(view):
            return False
        return self.applies(view, outlook)

    def forget(self) -> None:
        """Drop the planned shot and the candidates; see `Searcher.forget`."""
        super().forget()
        self._candidates, self.every = None, self._period

    def search(self, view: View, outlook: Outlook) -> None:
        """Find candidates, or evaluate the last ones; see `Searcher.search`."""
        found, self._candidates = self._candidates, None
        self.every = self._period
        if found is None:
            self._candidates = self._promising(view, outlook)
            if self._candidates is not None:
                self.every = 1
            elif self._plan is None:
                self._approach = None
            return
        shots = self._likely(view, outlook, found)
        if self._plan is not None:
            shots = [shot for shot in shots if shot.value > self._plan.value + _BETTER]
        self.adopt(view, outlook, shots)
        if self._plan in shots:
            self._plan = replace(self._plan, path=after_contact(view, outlook, self._plan))

    def _promising(self, view: View, outlook: Outlook) -> _Candidates | None:
        """Return the most promising contacts that the craft can reach in time."""
        pitch = view.pitch
        times = view.time + _TIMES
        pucks = outlook.at(times)
        near = pucks[:, 0] < pitch.fence[1, 0] + pitch.contact_distance
        near &= times <= outlook.until
        times, pucks = times[near], pucks[near]
        if not len(times):
            return None
        shape = len(times), len(_NORMALS), len(self.speeds)
        normal = np.broadcast_to(_NORMALS[None, :, None], shape)
        along = unit(_NORMALS)[:, None]
        velocity = np.broadcast_to(self.speeds[:, None] * along, (*shape, 2))
        place = pucks[:, None, None, :2] - pitch.contact_distance * along
        place = np.broadcast_to(place, (*shape, 2))
        closing = self.speeds - (pucks[:, 3:5] @ along[:, 0].T)[..., None]
        recoil = -pitch.recoil * closing[..., None] * along
        # The craft must be faster than the puck along the normal.
        fits = stays_inside(view, place, velocity, recoil) & (closing > _FASTER)
        when = np.broadcast_to(times[:, None, None], shape)
        able = np.nonzero(fits)
        able = _of(able, slack(view, when[able], place[able], velocity[able]) > 0)
        # The craft arrives more precisely with thrust to spare.
        able = _of(able, effort(view, when[able], place[able], velocity[able]) < _EASY)
        if not len(able[0]):
            return None
        rows, inverse = np.unique(able[0], return_inverse=True)
        part = inverse, able[1], able[2]
        chance, after = self._coarse(view, times[rows], pucks[rows], normal[rows], velocity[rows])
        value = np.full(shape, -np.inf)
        likely = chance[part] >= _PROMISING * self.least
        moves = velocity[able] + recoil[able]
        worth = _worth(view, when[able], chance[part], after[part], place[able], moves)
        value[able] = np.where(likely, worth, -np.inf)
        best = self._apart(
            np.unravel_index(np.argsort(value, axis=None)[:-_PICKED:-1], shape), value
        )
        if not best:
            return None
        k, j, s = (np.array(part) for part in zip(*best, strict=True))
        return _Candidates(times[k], _NORMALS[j], self.speeds[s])

    def _coarse(
        self,
        view: View,
        times: Float[np.ndarray, " K"],
        pucks: Float[np.ndarray, "K 6"],
        normal: Float[np.ndarray, "K J L"],
        velocity: Float[np.ndarray, "K J L 2"],
    ) -> tuple[Float[np.ndarray, "K J L"], Float[np.ndarray, "K J L 2"]]:
        """Return rough probabilities, averaged over nearby directions, and the puck's velocity."""
        pitch, shape = view.pitch, normal.shape
        contacts = Contacts(
            np.broadcast_to(pucks[:, None, None, :2], (*shape, 2)),
            np.broadcast_to(pucks[:, None, None, 3:], (*shape, 3)),
            normal,
            velocity,
        )
        after = struck(pitch, contacts)
        opponent = _opponent(view, times - view.time, pucks[:, 1])
        others = opponent and (opponent[0][:, None, None], *opponent[1:])
        flights = flown(pitch.equipment, contacts.place, after, others)
        spread = math.hypot(self.error.place / pitch.contact_distance, _DIRECTION_ERROR)
        apart = (_NORMALS[:, None] - _NORMALS[None, :]) / spread
        weights = np.exp(-(apart**2) / 2)
        weights /= weights.sum(axis=1, keepdims=True)
        return weights @ (flights.scores * flights.passes), after[..., :2]

    def _apart(
        self, order: tuple[np.ndarray, ...], value: Float[np.ndarray, "K J L"]
    ) -> list[tuple[int, int, int]]:
        """Return the best few contacts that differ from each other."""
        found: list[tuple[int, int, int]] = []
        for k, j, s in zip(*(part.tolist() for part in order), strict=True):
            if not np.isfinite(value[k, j, s]):
                break
            if all(abs(k - a) > 1 or abs(j - b) > 2 or s != c for a, b, c in found):
                found.append((k, j, s))
                if len(found) == _CLOSELY:
                    break
        return found

    def _likely(self, view: View, outlook: Outlook, found: _Candidates) -> list[PlannedContact]:
        """Evaluate contacts with all errors; return those that are likely enough, best first."""
        time = np.repeat(found.time, len(_ASIDE))
        speed = np.repeat(found.speed, len(_ASIDE))
        normal = (found.normal[:, None] + _ASIDE).ravel()
        times, where = np.unique(time, return_inverse=True)
        times = np.maximum(times, outlook.times[0])
        predicted = predict_puck(view.puck_model, outlook.belief, times.tolist())
        pucks = predicted.mean[where]
        contacts = Contacts(pucks[:, :2], pucks[:, 3:], normal, speed[:, None] * unit(normal))
        opponent = _opponent(view, time - view.time, pucks[:, 1])
        chance, bounces = chances(
            view.pitch,
            view.puck_model,
            contacts,
            predicted.covariance[where],
            self.error,
            opponent and (opponent[0][:, None], *opponent[1:]),
        )
        after = struck(view.pitch, contacts)[:, :2]
        place = contacts.place - view.pitch.contact_distance * unit(normal)
        # The craft loses the momentum that the puck gains.
        puck = view.pitch.equipment.puck
        lost = puck.mass_kg / view.pitch.craft_mass * (after - contacts.puck[:, :2])
        value = _worth(view, time, chance, after, place, contacts.craft - lost)
        shots = []
        for k in np.argsort(value)[::-1].tolist():
            if value[k] < self.least and not self.clears:
                break
            kind: ActionKind = "bank" if bounces[k] > _BANKED else "strike"
            when = float(time[k]), float(normal[k]), float(speed[k])
            kind = "clear" if self.clears else kind
            shots.append(PlannedContact(*when, kind, float(chance[k]), value=float(value[k])))
        return shots


def _worth(
    view: View,
    time: Float[np.ndarray, " n"],
    chance: Float[np.ndarray, " n"],
    puck: Float[np.ndarray, "n 2"],
    place: Float[np.ndarray, "n 2"],
    craft: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, " n"]:
    """Return the values of shots at times, by the velocities of puck and craft after them.

    A shot that comes back before the craft is at home again may be a goal against it.
    """
    value = chance + _PRESSURE * puck[:, 0]
    if view.rival.returns:
        home = np.moveaxis(np.array(view.pitch.home) - place, -1, 0)
        back = view.times(home, np.moveaxis(craft, -1, 0), "rest") + view.pitch.delay
        crosses = -place[:, 0] / np.maximum(puck[:, 0], _FASTER)
        value = value - _CONCEDED * view.rival.is_quicker(back - crosses)
    return value * np.exp(-_PATIENCE * (time - view.time))


def _of(indices: tuple[np.ndarray, ...], which: Bool[np.ndarray, " N"]) -> tuple[np.ndarray, ...]:
    """Return some of the indices of an array's elements."""
    return tuple(part[which] for part in indices)


def after_contact(
    view: View, outlook: Outlook, contact: PlannedContact
) -> Float[np.ndarray, "N 2"]:
    """Return where the puck goes after a contact."""
    puck = outlook.at(contact.time)
    touch = Contacts(puck[:2], puck[3:], contact.normal, contact.velocity)
    state = np.concatenate([puck[:3], struck(view.pitch, touch)])
    return drawn_path(view.pitch.equipment, PuckBelief(contact.time, state, np.zeros((6, 6))))


def _opponent(
    view: View, ahead: Float[np.ndarray, " n"], aside: Float[np.ndarray, " n"]
) -> Opposed | None:
    """Return where the opponent will be on its return home, given the puck's y; None if unseen."""
    if view.opponent is None:
        return None
    here, rival = view.opponent[:2], view.rival
    home = np.full((len(ahead), 2), view.pitch.goal_line - rival.waits)
    home[:, 1] = rival.follows * aside
    path = home - here
    length = np.maximum(np.hypot(path[:, 0], path[:, 1]), _AT_HOME)
    share = np.minimum(rival.reach(ahead) / length, 1.0)
    return here + share[:, None] * path, view.pitch.opponent_radius, rival
