"""Places and times at which the craft can touch the puck, and the search for such contacts."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck import Rendezvous, SetPoint
from airpuck.extend import Reference
from airpuck_hockey.player.rival import STILL
from airpuck_hockey.player.shot import unit
from airpuck_hockey.player.tactic import ActionKind, Intention, View
from airpuck_hockey.puck.prediction import predict_path

# Numbers without a source are guesses that won matches.
#: Horizon and step of the puck's predicted path [s].
HORIZON, STEP = 2.0, 0.02
#: The puck threatens the goal within this of the line, and of the posts [m]: where it goes after a
#: post is not foreseen.
_AT_LINE, _AT_POSTS = 0.01, 0.04
#: Standard deviation of the puck's velocity up to which it is known well enough to plan [m/s]: five
#: frames after a hit.
_KNOWN = 0.05
#: A puck this far beyond the craft's half can still be touched: about the sum of the radii [m].
_TOUCHED = 0.1
#: This long before a contact the plan is final, because thrust can change little by then [s].
_COMMITMENT = 0.15
#: A contact that is overdue by this time did not happen [s]. The time exceeds the one for which the
#: craft aims beyond a contact.
_EXPIRY = 0.03
#: Largest share of the craft's acceleration that the path to a planned contact may need: above 1,
#: because thrust does not limit a short peak at the start.
_STRAINED = 1.4
#: Time that the predictive law needs: this factor times the shortest time, plus a constant [s].
_SLOWER, _LATER = 1.1, 0.03
#: The craft aims this far beyond the contact, so that the discs surely touch [m], or for this time
#: if that is less [s]. A slower approach counts as this fast [m/s].
_DEEPER, _LONGEST_DEEPER, _SLOWEST_APPROACH = 0.006, 0.03, 0.05
#: Precision of a contact [m, m, rad, m/s, m/s, rad/s]: yaw is free.
_PRECISE = (0.0015, 0.0015, math.inf, 0.04, 0.04, math.inf)
#: Fractions of the path at which clearance from the puck is checked.
_CHECKED = np.linspace(0.1, 0.9, 9)
#: Delay until the craft reacts to a recoil [s].
NOTICED = 0.08
#: Distance from the start of the run-up to the contact [m].
_RUN_UP = 0.1
#: Clearance when passing the puck [m]: on the path to a contact, of the disc that the law keeps out
#: of, on the straight path to a waypoint, and of the waypoint beside the puck.
_PASSING, AVOIDED, _BLOCKED, _BESIDE = 0.012, 0.01, 0.03, 0.07
#: A puck nearer to the straight path is passed on the left [m].
_STRAIGHT = 0.01
#: Shorter distances have no direction [m].
_NO_DISTANCE = 1e-6
#: A shorter time to a contact counts as this long [s].
_SHORTEST = 1e-3


class Outlook:
    """The predicted path of the untouched puck, computed once per decision."""

    def __init__(self, view: View) -> None:
        assert view.puck is not None
        self.view, self.belief = view, view.puck
        count = round(HORIZON / STEP)
        start = max(view.time, view.puck.time)
        #: Times [s], and states of the puck at these times.
        self.times = start + STEP * np.arange(count + 1)
        self.states = predict_path(view.pitch.equipment, view.puck, self.times)
        self.places, self.motions = self.states[:, :2], self.states[:, 3:]
        #: Current speed [m/s]; a row of the motions is vx, vy, angular velocity.
        self.speed = float(np.hypot(*self.motions[0, :2]))

    @cached_property
    def until(self) -> float:
        """Time of a threat, or of the opponent's first chance to touch the puck in its half [s]."""
        end = float(self.times[-1]) if self.threat is None else self.threat
        if self.view.opponent is None:
            return end
        here, motion = self.view.opponent[:2], self.view.opponent[2:]
        rival, pitch = self.view.rival, self.view.pitch
        # An opponent that is already moving has reacted.
        ahead = self.times - self.view.time + rival.reaction * (np.hypot(*motion) > STILL)
        radii = pitch.opponent_radius + pitch.equipment.puck.radius_m
        apart = lengths(self.places - here) - radii
        lost = (self.motions[:, 0] > 0) | (rival.reach(ahead) > apart)
        lost &= self.places[:, 0] > 0
        return min(end, float(self.times[np.argmax(lost)])) if lost.any() else end

    @cached_property
    def threat(self) -> float | None:
        """Time at which the puck will be at its own goal [s]; None: it will not."""
        pitch = self.view.pitch
        half = pitch.equipment.table.goal_width_m / 2
        line = -pitch.goal_line + pitch.equipment.puck.radius_m + _AT_LINE
        (x, y), (vx, vy) = self.places.T, self.motions[:, :2].T
        # Between two times the puck may reach a post and leave it again.
        passed = np.clip((line - x) / np.minimum(vx, -_NO_DISTANCE), 0, STEP)
        at = (x + np.minimum(vx, 0) * passed <= line) & (np.abs(y + vy * passed) < half + _AT_POSTS)
        return float((self.times + passed)[np.argmax(at)]) if at.any() else None

    @cached_property
    def known(self) -> bool:
        """Whether the puck's velocity is known well enough to plan."""
        return float(np.trace(self.belief.covariance[3:5, 3:5])) < _KNOWN**2

    def at(self, time: Any) -> Float[np.ndarray, "*n 6"]:
        """Return the state of the puck at a time, or several, within the horizon."""
        steps = (np.asarray(time) - self.times[0]) / STEP
        index = np.minimum(np.maximum(steps, 0), len(self.times) - 2).astype(int)
        share = (steps - index)[..., None]
        return (1 - share) * self.states[index] + share * self.states[index + 1]

    @cached_property
    def is_reachable(self) -> bool:
        """Whether the puck will be in the half in which the craft can touch it."""
        near = self.places[:, 0] < self.view.pitch.fence[1, 0] + _TOUCHED
        return bool((near & (self.times <= self.until)).any())


def slack(
    view: View, time: Any, place: Float[np.ndarray, "*n 2"], velocity: Float[np.ndarray, "*n 2"]
) -> Any:
    """Return the time to spare if the craft is to reach places, with velocities, at times [s].

    In a frame that moves with the final velocity, the craft comes to rest there: the shortest time
    to rest from the relative state equals the shortest time to the rendezvous.
    """
    delay = view.pitch.delay
    left = np.maximum(np.asarray(time) - view.time - delay, 0.0)
    here = view.craft[:2] + view.craft[3:5] * delay
    away = place - velocity * left[..., None] - here
    relative = view.craft[3:5] - velocity
    needed = view.times(np.moveaxis(away, -1, 0), np.moveaxis(relative, -1, 0), "rest")
    return left - _SLOWER * needed - _LATER - view.times.margin


def lengths(vectors: Float[np.ndarray, "*n 2"]) -> Any:
    """Return the lengths of vectors; for thousands, NumPy's own norm takes ten times as long."""
    x, y = vectors[..., 0], vectors[..., 1]
    return np.sqrt(x * x + y * y)


def stays_inside(
    view: View,
    place: Float[np.ndarray, "*n 2"],
    velocity: Float[np.ndarray, "*n 2"],
    recoil: Float[np.ndarray, "*n 2"] | float = 0.0,
) -> Any:
    """Return whether the run-up to places with velocities, and the braking, stay within the fence.

    The recoil is the change of velocity by a contact; it persists until the craft reacts.
    """
    pitch = view.pitch
    start = place - _braking(view, velocity)
    stop = place + recoil * NOTICED + _braking(view, velocity + recoil)
    return pitch.inside(place) & pitch.inside(start) & pitch.inside(stop)


def _braking(view: View, velocity: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    """Return the braking distance as a vector."""
    return velocity * lengths(velocity)[..., None] / (2 * view.pitch.acceleration)


@dataclass(frozen=True, eq=False)
class PlannedContact:
    """A contact that the craft plans: when, from which side, and how fast it moves then."""

    #: Time [s].
    time: float
    #: Direction from the craft's centre to the puck's [rad].
    normal: float
    #: Speed of the craft along the normal; negative: it recedes [m/s].
    speed: float
    #: Purpose, probability of scoring, and path of the puck afterwards; see `Intention`.
    kind: ActionKind = "prepare"
    chance: float | None = None
    path: Float[np.ndarray, "N 2"] | None = None
    #: Value of a shot when it was planned, on the scale of its probability.
    value: float = 0.0

    @property
    def velocity(self) -> Float[np.ndarray, " 2"]:
        """Velocity of the craft at the contact [m/s]."""
        return self.speed * unit(self.normal)

    def place(self, view: View, puck: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 2"]:
        """Return the craft's centre when it touches a puck."""
        return puck[:2] - view.pitch.contact_distance * unit(self.normal)

    def is_committed(self, view: View) -> bool:
        """Return whether the contact is too near in time to be changed."""
        return self.time - view.time < _COMMITMENT

    def holds(self, view: View, outlook: Outlook) -> bool:
        """Return whether the craft can still keep the contact."""
        if self.is_committed(view):
            return view.time - self.time <= _EXPIRY
        if self.time > outlook.until:
            return False
        puck, along = outlook.at(self.time), unit(self.normal)
        place = self.place(view, puck)
        able = effort(view, self.time, place, self.velocity) < _STRAINED
        recoil = -view.pitch.recoil * (self.speed - float(puck[3:5] @ along)) * along
        return bool(able and stays_inside(view, place, self.velocity, recoil))

    def reference(self, view: View, puck: Float[np.ndarray, " 6"]) -> Reference:
        """Return a reference that leads the craft there, and then home."""
        normal = unit(self.normal)
        # The discs approach with the difference of their speeds.
        closing = self.speed - float(puck[3:5] @ normal)
        later = min(_DEEPER / max(closing, _SLOWEST_APPROACH), _LONGEST_DEEPER)
        place = view.pitch.clipped(self.place(view, puck) + self.velocity * later)
        state = (*place, view.craft[2], *self.velocity, 0.0)
        after = SetPoint(*view.pitch.home, 0.0)
        return Rendezvous(self.time + later, state, precision=_PRECISE, then=after)

    def intention(self, view: View, outlook: Outlook) -> Intention:
        """Return the intention to touch the puck."""
        return self._intention(self.reference(view, outlook.at(self.time)), outlook)

    def approach(self, view: View, outlook: Outlook) -> Intention:
        """Return the intention to go round the puck to where the run-up begins."""
        behind = self.place(view, outlook.at(self.time)) - _RUN_UP * unit(self.normal)
        x, y = outlook.places[0].tolist()
        avoid = (x, y, view.pitch.contact_distance + AVOIDED)
        return replace(self._intention(around(view, outlook, behind), outlook), avoid=avoid)

    def _intention(self, reference: Reference, outlook: Outlook) -> Intention:
        meet = (self.time, *outlook.at(self.time)[:2].tolist())
        return Intention(self.kind, reference, meet, self.path, self.chance)


def path_is_clear(view: View, outlook: Outlook, contact: PlannedContact) -> bool:
    """Return whether the craft reaches a contact without touching the puck earlier.

    The path is the one of least effort: a cubic in time.
    """
    left = contact.time - view.time
    place = contact.place(view, outlook.at(contact.time))
    path = cubic(view.craft, place, contact.velocity, left)
    pucks = outlook.at(view.time + _CHECKED * left)[:, :2]
    apart = lengths(path - pucks) - view.pitch.contact_distance
    # The discs approach each other on the last part of the path.
    return bool((apart > _PASSING * np.minimum(1.0, 2 * (1 - _CHECKED))).all())


def cubic(
    craft: Float[np.ndarray, " 6"],
    place: Float[np.ndarray, " 2"],
    velocity: Float[np.ndarray, " 2"],
    duration: float,
) -> Float[np.ndarray, "S 2"]:
    """Return points of the path of least effort to a place and a velocity."""
    s = _CHECKED[:, None]
    return (
        (1 + 2 * s) * (1 - s) ** 2 * craft[:2]
        + s * (1 - s) ** 2 * duration * craft[3:5]
        + s**2 * (3 - 2 * s) * place
        + s**2 * (s - 1) * duration * velocity
    )


def effort(
    view: View, time: Any, place: Float[np.ndarray, "*n 2"], velocity: Float[np.ndarray, "*n 2"]
) -> Any:
    """Return the greatest acceleration on the path of least effort, relative to the craft's."""
    delay = view.pitch.delay
    left = np.maximum(np.asarray(time) - view.time - delay, _SHORTEST)[..., None]
    start = view.craft[3:5]
    away = place - view.craft[:2] - start * delay
    first = (6 * away - left * (4 * start + 2 * velocity)) / left**2
    last = (-6 * away + left * (2 * start + 4 * velocity)) / left**2
    return np.maximum(lengths(first), lengths(last)) / view.pitch.acceleration


def around(view: View, outlook: Outlook, goal: Float[np.ndarray, " 2"]) -> SetPoint:
    """Return the next waypoint to a goal, round a puck in between."""
    here, puck = view.craft[:2], outlook.places[0]
    radius = view.pitch.contact_distance
    path = goal - here
    length = float(np.hypot(*path))
    if length > _NO_DISTANCE:
        along = path / length
        ahead = float((puck - here) @ along)
        across = puck - here - ahead * along
        beside = float(np.hypot(*across))
        if 0 < ahead < length + radius + _BLOCKED and beside < radius + _BLOCKED:
            # On the side that it already passes, or where there is more room.
            out = -across / beside if beside > _STRAIGHT else np.array([-along[1], along[0]])
            if not view.pitch.inside(puck + out * (radius + _BLOCKED + AVOIDED)):
                out = -out
            goal = puck + out * (radius + _BESIDE)
    return standing(view.pitch.clipped(goal))


def standing(place: Float[np.ndarray, " 2"]) -> SetPoint:
    """Return a set point at a place."""
    return SetPoint(float(place[0]), float(place[1]), 0.0)


#: After a longer break between two decisions a plan is out of date [s]; five periods, in which the
#: puck's velocity becomes known again after a hit.
_INTERRUPTED = 0.05


class Searcher(ABC):
    """A strategy that searches for a contact, and keeps the best one while it remains feasible."""

    #: Number of decisions between searches.
    every: int

    def __init__(self) -> None:
        self._plan: PlannedContact | None = None
        #: The path to the start of a contact that cannot be reached directly.
        self._approach: Intention | None = None
        self._last_proposal = -math.inf

    @abstractmethod
    def applies(self, view: View, outlook: Outlook) -> bool:
        """Return whether this strategy applies to the puck."""

    @abstractmethod
    def search(self, view: View, outlook: Outlook) -> None:
        """Search for a contact, and plan it if it is better than the present plan."""

    def wants_search(self, view: View, outlook: Outlook) -> bool:
        """Return whether this strategy would accept another contact."""
        return self._plan is None and self.applies(view, outlook)

    def propose(self, view: View, outlook: Outlook) -> Intention | None:
        """Return the planned contact, or the path to where one is possible; None without either."""
        interrupted = view.time > self._last_proposal + _INTERRUPTED
        self._last_proposal = view.time
        if interrupted or not self.applies(view, outlook):
            self.forget()
        if self._plan is not None:
            self._plan = self.updated(view, outlook, self._plan)
        return self._approach if self._plan is None else self._plan.intention(view, outlook)

    def forget(self) -> None:
        """Drop the plan."""
        self._plan = self._approach = None

    def updated(self, view: View, outlook: Outlook, plan: PlannedContact) -> PlannedContact | None:
        """Return the plan for the puck's present motion; None if it is no longer feasible."""
        return plan if plan.holds(view, outlook) else None

    def adopt(self, view: View, outlook: Outlook, contacts: Sequence[PlannedContact]) -> None:
        """Plan the first contact whose path is clear, or else how to get to the first one."""
        self._approach = None
        plan = first_clear(view, outlook, contacts)
        if plan is not None:
            self._plan = plan
        elif self._plan is None and contacts:
            self._approach = contacts[0].approach(view, outlook)


def first_clear(
    view: View, outlook: Outlook, contacts: Sequence[PlannedContact]
) -> PlannedContact | None:
    """Return the first contact that the craft reaches without touching the puck earlier."""
    return next((each for each in contacts if path_is_clear(view, outlook, each)), None)
