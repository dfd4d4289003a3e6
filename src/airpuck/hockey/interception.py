"""Where and when the craft can touch the puck."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck.control.reference import Reference, Rendezvous, SetPoint
from airpuck.hockey.prediction import predict_path
from airpuck.hockey.shot import unit
from airpuck.hockey.tactic import View

#: Horizon and step of the puck's predicted path [s].
HORIZON, STEP = 2.0, 0.02
#: Time that the predictive law needs: this factor times the shortest time, plus a constant [s].
_SLOWER, _LATER = 1.1, 0.03
#: The craft aims this far beyond the contact, so that the discs surely touch [m].
_DEEPER = 0.006
#: Precision of a contact [m, m, rad, m/s, m/s, rad/s]: yaw is free.
_PRECISE = (0.0015, 0.0015, math.inf, 0.04, 0.04, math.inf)
#: Fractions of the path at which clearance from the puck is checked.
_SHARES = np.linspace(0.1, 0.9, 9)
#: Delay until the craft reacts to a recoil [s].
_NOTICED = 0.08
#: Distance from the start of the run-up to the contact [m].
_RUN_UP = 0.1
#: Clearance when passing the puck [m].
_PASSING = 0.012


class Outlook:
    """The predicted path of the untouched puck, computed once per decision."""

    def __init__(self, view: View) -> None:
        assert view.puck is not None
        self.view, self.belief = view, view.puck
        count = round(HORIZON / STEP)
        start = max(view.time, view.puck.time)
        #: Times [s], and states of the puck then.
        self.times = start + STEP * np.arange(count + 1)
        self.states = predict_path(view.pitch.play, view.puck, self.times)
        self.places, self.motions = self.states[:, :2], self.states[:, 3:]
        #: Speed now [m/s]; a row of the motions is vx, vy, spin.
        self.speed = float(np.hypot(*self.motions[0, :2]))
        self._searched = False

    def take_search(self) -> bool:
        """Take the only search of this decision; return whether it was left."""
        searched, self._searched = self._searched, True
        return not searched

    @cached_property
    def threat(self) -> float | None:
        """When the puck will be at the own goal [s]; None: it will not."""
        pitch = self.view.pitch
        half = pitch.play.table.goal_width_m / 2
        at = (self.places[:, 0] < -pitch.goal_line + pitch.play.puck.radius_m + 0.01) & (
            np.abs(self.places[:, 1]) < half + 0.02
        )
        return float(self.times[np.argmax(at)]) if at.any() else None

    @cached_property
    def known(self) -> bool:
        """Whether the velocity is known well enough to plan: some frames after a hit."""
        return float(np.trace(self.belief.covariance[3:5, 3:5])) < 0.05**2

    def at(self, time: Any) -> Float[np.ndarray, "*n 6"]:
        """Return the state of the puck at a time, or several, within the horizon."""
        steps = (np.asarray(time) - self.times[0]) / STEP
        index = np.minimum(np.maximum(steps, 0), len(self.times) - 2).astype(int)
        share = (steps - index)[..., None]
        return (1 - share) * self.states[index] + share * self.states[index + 1]

    def comes(self, x: float) -> bool:
        """Return whether the puck will be on the near side of a line across the table."""
        return bool((self.places[:, 0] < x).any())


def slack(
    view: View, time: Any, place: Float[np.ndarray, "*n 2"], velocity: Float[np.ndarray, "*n 2"]
) -> Any:
    """Return by how much the craft can be earlier at places, with velocities, than times [s].

    Seen from a frame that moves with the final velocity, it comes to rest there: the shortest time
    to rest from the relative state equals the shortest time to the rendezvous.
    """
    delay = view.pitch.delay
    left = np.maximum(np.asarray(time) - view.time - delay, 0.0)
    here = view.craft[:2] + view.craft[3:5] * delay
    away = place - velocity * left[..., None] - here
    relative = view.craft[3:5] - velocity
    needed = view.times(np.moveaxis(away, -1, 0), np.moveaxis(relative, -1, 0), "rest")
    return left - _SLOWER * needed - _LATER - view.times.margin


def stays_inside(
    view: View,
    place: Float[np.ndarray, "*n 2"],
    velocity: Float[np.ndarray, "*n 2"],
    recoil: Float[np.ndarray, "*n 2"] | float = 0.0,
) -> Any:
    """Return whether a craft with a velocity at a place got there, and can stop, on its half.

    The recoil is the change of velocity by a contact; it persists until the craft reacts.
    """
    pitch = view.pitch
    start = place - _braking(view, velocity)
    stop = place + recoil * _NOTICED + _braking(view, velocity + recoil)
    return pitch.inside(place) & pitch.inside(start) & pitch.inside(stop)


def _braking(view: View, velocity: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    """Return the braking distance as a vector."""
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    return velocity * speed / (2 * view.pitch.acceleration)


@dataclass(frozen=True)
class PlannedContact:
    """A contact that is planned: the craft's middle, the puck's, and how the craft moves then."""

    #: When [s].
    time: float
    #: Direction from the craft's middle to the puck's [rad].
    normal: float
    #: Speed of the craft along the normal; negative: it recedes [m/s].
    speed: float

    def place(self, view: View, puck: Float[np.ndarray, " 6"]) -> Float[np.ndarray, " 2"]:
        """Return where the craft's middle is when it touches a puck."""
        return puck[:2] - view.pitch.contact_distance * unit(self.normal)

    def reference(self, view: View, puck: Float[np.ndarray, " 6"]) -> Reference:
        """Return what leads the craft there, and then home."""
        way = unit(self.normal)
        place = self.place(view, puck)
        # The discs close in with the difference of their speeds.
        closing = self.speed - float(puck[3:5] @ way)
        later = min(_DEEPER / max(closing, 0.05), 0.03)
        place = view.pitch.clipped(place + way * self.speed * later)
        state = (*place, view.craft[2], *(way * self.speed), 0.0)
        after = SetPoint(*view.pitch.home, 0.0)
        return Rendezvous(self.time + later, state, precision=_PRECISE, then=after)


def way_is_free(view: View, outlook: Outlook, meeting: PlannedContact) -> bool:
    """Return whether the craft gets to a contact without touching the puck before.

    The way is the one of least effort: a cubic in time.
    """
    puck = outlook.at(meeting.time)
    left = meeting.time - view.time
    way = cubic(view.craft, meeting.place(view, puck), meeting.speed * unit(meeting.normal), left)
    times = view.time + _SHARES * left
    apart = np.linalg.norm(way - outlook.at(times)[:, :2], axis=1) - view.pitch.contact_distance
    # On the straight of the last bit it comes near by itself.
    return bool((apart > _PASSING * np.minimum(1.0, 2 * (1 - _SHARES))).all())


def cubic(
    craft: Float[np.ndarray, " 6"],
    place: Float[np.ndarray, " 2"],
    velocity: Float[np.ndarray, " 2"],
    duration: float,
) -> Float[np.ndarray, "S 2"]:
    """Return the way of least effort to a place and a velocity, at some shares of its time."""
    s = _SHARES[:, None]
    return (
        (1 + 2 * s) * (1 - s) ** 2 * craft[:2]
        + s * (1 - s) ** 2 * duration * craft[3:5]
        + s**2 * (3 - 2 * s) * place
        + s**2 * (s - 1) * duration * velocity
    )


def effort(
    view: View, time: Any, place: Float[np.ndarray, "*n 2"], velocity: Float[np.ndarray, "*n 2"]
) -> Any:
    """Return the greatest acceleration on the way of least effort, as a share of what there is."""
    delay = view.pitch.delay
    left = np.maximum(np.asarray(time) - view.time - delay, 1e-3)[..., None]
    start = view.craft[3:5]
    away = place - view.craft[:2] - start * delay
    first = (6 * away - left * (4 * start + 2 * velocity)) / left**2
    last = (-6 * away + left * (2 * start + 4 * velocity)) / left**2
    most = np.maximum((first**2).sum(axis=-1), (last**2).sum(axis=-1))
    return np.sqrt(most) / view.pitch.acceleration


def around(view: View, outlook: Outlook, goal: Float[np.ndarray, " 2"]) -> SetPoint:
    """Return the next waypoint to a goal, round a puck that lies in between."""
    here, puck = view.craft[:2], outlook.places[0]
    radius = view.pitch.contact_distance + 0.03
    way = goal - here
    length = float(np.hypot(*way))
    if length > 1e-6:
        along = way / length
        ahead = float((puck - here) @ along)
        across = puck - here - ahead * along
        beside = float(np.hypot(*across))
        if 0 < ahead < length + radius and beside < radius:
            # To the side on which it passes already, or where there is more room.
            out = -across / beside if beside > 0.01 else np.array([-along[1], along[0]])
            if not view.pitch.inside(puck + out * (radius + 0.01)):
                out = -out
            goal = puck + out * (radius + 0.04)
    return standing(view.pitch.clipped(goal))


def run_up(
    view: View, outlook: Outlook, meeting: PlannedContact
) -> tuple[SetPoint, tuple[float, float, float]]:
    """Return the next place on the way to where a contact begins, and the puck's disc to avoid."""
    behind = meeting.place(view, outlook.at(meeting.time)) - _RUN_UP * unit(meeting.normal)
    x, y = outlook.places[0].tolist()
    return around(view, outlook, behind), (x, y, view.pitch.contact_distance + 0.01)


def standing(place: Float[np.ndarray, " 2"]) -> SetPoint:
    """Return a set point at a place."""
    return SetPoint(float(place[0]), float(place[1]), 0.0)
