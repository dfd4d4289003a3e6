"""Weights of a law, found by flights on the twin.

A derivative-free method for constrained problems (COBYQA: Ragonneau, 2022) changes the logarithms
of the weights: the least error, with no more effort than at the start. Every trial flies the same
twins, with the same noise: half of them differ from the model as craft of one kind do, half are
stronger and later, so that weights that only suit the model do not win.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, explained
from airpuck.boundary.files import checked
from airpuck.boundary.results import Result
from airpuck.control.laws import law_class, name_among
from airpuck.control.reference import SetPoint, Target
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.deviation.time_scale import patience
from airpuck.flight.loop import fly
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import pose_difference
from airpuck.twin.plant import build_plant, varied
from airpuck.twin.radio import radio_delay
from airpuck.twin.settings import TwinSettings, default_twin_settings
from airpuck.twin.twin import Twin, check_seed

#: Amplitudes of the course [m, m, rad], as far as the table has room, and their rates, for the
#: paper's craft [rad/s].
_SIZE, _RATES = (0.3, 0.2, 1.0), (1.57, 2.36, 1.1)
#: Share of the table's room that the course uses.
_ROOM = 0.6
#: The set point after the course, as fractions of the amplitudes.
_END = (-0.7, -0.5, -0.5)
#: Times for the paper's craft: until errors count, and until the set point; from then until the
#: craft should be there, and until the end [s].
_COUNTS, _LEAVES, _THERE, _STOP = 1.0, 5.0, 1.5, 2.5
#: Twins of each kind in a trial, and later ones, which no trial flies; spread of the usual ones.
_TRIAL, _HELD_OUT, _SPREAD = 2, 8, 0.1
#: The other twins: their thrust, relative to the model, and additional delay [s]; predictive
#: control with the packaged weights oscillates on them (studies/learning.md).
_STRONGER, _LATER = 1.2, 0.02
#: A craft that comes to rest within this distance of the set point still flies [m].
_FLIES = 0.02
#: Largest additional delay [s], and factor of the thrust, that are tried for the margins; number of
#: bisections.
_LATEST, _STRONGEST, _HALVINGS = 0.16, 8.0, 5
#: First and last change of a weight, in factors of two.
_FIRST, _LAST = 1.0, 0.05
#: The search multiplies differences of effort by this, since they are small; differences below the
#: second number do not count.
_STEEP, _EQUAL = 10.0, 0.005
#: Cost of a tuning that no controller can be designed for, and of a contact with a rail: like 20
#: and 3 times the error.
_REFUSED, _CONTACT = 3.0, 1.0
#: Entries of the filter that are tuned, too: how fast it expects disturbances to change.
_FILTER = ("disturbance_density", "angular_disturbance_density")


@dataclass(frozen=True)
class Followed(Result):
    """How craft follow the course with a tuning.

    Attributes
    ----------
    error_m : float
        Root mean square distance of the points on the craft's rim from where they should be [m].
    effort : float
        Mean of the sum of squared commands above idle.
    contacts : int
        Number of contacts with a rail.
    delay_margin_s : float
        Delay beyond the model's with which a craft like the model still comes to rest at a set
        point [s]; delays up to 0.16 s are tried.
    thrust_margins : tuple of float
        Smallest and largest thrust, relative to the model's, with which it does; up to a factor
        of 8 is tried.
    """

    JSON = "error_m effort contacts delay_margin_s thrust_margins"

    error_m: float
    effort: float
    contacts: int
    delay_margin_s: float
    thrust_margins: tuple[float, float]


@dataclass(frozen=True)
class Tuned(Result):
    """A tuning found by flights, and what it changes for craft that it was not tuned on.

    Attributes
    ----------
    tuning : Tuning
        The tuning with the best flights.
    changes : dict of str to tuple of float
        Each weight before and after.
    before, after : Followed
        Flights with the tuning of the start, and with this one: the same craft and noise.
    trials : int
        Number of tunings flown.
    """

    JSON = "changes before after trials warnings"

    tuning: Tuning
    changes: dict[str, tuple[float, float]]
    before: Followed
    after: Followed
    trials: int

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the flights afterwards do not confirm."""
        if self.after.error_m < self.before.error_m:
            return ()
        return ("the error of craft that no trial flew did not fall; more trials may help",)


class _Course:
    """A closed curve along which the craft turns, then a set point."""

    def __init__(self, model: Model, settings: TwinSettings, leaves: float = _LEAVES) -> None:
        #: Factor of all times; time of the set point [s].
        self.slow = patience(model.vehicle)
        self.leaves = self.slow * leaves
        room = _ROOM * np.array([*settings.table.reach(model.vehicle.radius_m), math.inf])
        self._size, self._rates = np.minimum(_SIZE, room), np.array(_RATES) / self.slow
        end = self._size * _END
        self.start, self._end = (float(self._size[0]), 0.0, 0.0), SetPoint(*end.tolist())

    def at(self, now: float, ahead: float) -> Target:
        """Return the target; see `airpuck.Reference`."""
        if now >= self.leaves:
            return self._end.at(now, ahead)
        size, rates = self._size, self._rates
        angle = rates * (now + ahead) + [math.pi / 2, 0.0, 0.0]
        sin, cos = np.sin(angle), np.cos(angle)
        return Target(np.concatenate([size * sin, size * rates * cos]), -size * rates**2 * sin)


#: Puts a true craft at a pose.
_Craft = Callable[..., Twin]


class _Flown(NamedTuple):
    """What counts of a flight."""

    #: Mean squared distance of points on the rim on the course, and at rest [m²].
    squared: float
    rest: float
    effort: float
    contacts: int


class _Trial(NamedTuple):
    """A tuning, and its flights together."""

    tuning: Tuning
    #: Logarithm of the error, the geometric mean of both kinds of twins, and of the usual effort.
    cost: float
    effort: float

    @classmethod
    def of(cls, tuning: Tuning, flights: Sequence[_Flown]) -> _Trial:
        """Sum up a trial's flights."""
        kinds = flights[:_TRIAL], flights[_TRIAL:]
        error = sum(math.log(sum(flight.squared for flight in kind)) for kind in kinds) / 4
        error += _CONTACT * sum(flight.contacts for flight in flights)
        effort = math.log(sum(flight.effort for flight in flights[:_TRIAL]))
        return cls(tuning, error, effort)


class _Flights:
    """Flights of a controller's model."""

    def __init__(self, model: Model, settings: TwinSettings, tell: Callable[[int], None]) -> None:
        self.model, self.settings = model, settings
        self.course, self._move = _Course(model, settings), _Course(model, settings, 0.0)
        self._count, self._tell = 0, tell

    def craft(self, seed: int, spread: float = 0, thrust: float = 1, later: float = 0) -> _Craft:
        """Return a craft that differs from the model."""
        truth = varied(self.model, spread, seed)
        stronger = replace(truth.parameters, thrust=thrust * truth.parameters.thrust)
        truth = replace(truth, parameters=stronger, uncertainty=None)
        usual = self.settings.with_usual_delay(radio_delay(truth))
        delay = {"delay_s": (usual.radio.delay_s or 0.0) + later}
        usual = usual.model_copy(update={"radio": usual.radio.model_copy(update=delay)})
        return partial(Twin, truth, usual, seed=seed, plant=build_plant(truth, usual))

    def flown(self, tuning: Tuning, craft: _Craft, course: _Course) -> _Flown:
        """Fly a course."""
        seen = tuning.with_camera(self.settings.motion_capture.rate_hz)
        pilot = TrackingController(self.model, course, seen, table=self.settings.table)
        twin, vehicle = craft(pose=course.start), self.model.vehicle
        log = fly(pilot, twin, course.leaves + course.slow * _STOP, tuning.period_s)
        self._count += 1
        self._tell(self._count)
        time, states = twin.truth
        wanted = np.array([course.at(now, 0.0).state for now in time.tolist()])
        off = pose_difference(np, states[:, :6].T, wanted.T)[:3]
        squared = off[0] ** 2 + off[1] ** 2 + (vehicle.radius_m * off[2]) ** 2
        rests = time > course.leaves + course.slow * _THERE
        counts = rests | ((time > course.slow * _COUNTS) & (time < course.leaves))
        return _Flown(
            float(squared[counts].mean()),
            float(squared[rests].mean()),
            float(((log.command - vehicle.idle) ** 2).sum(axis=1).mean()),
            len(twin.contacts),
        )

    def followed(self, tuning: Tuning, crafts: Sequence[_Craft]) -> Followed:
        """Fly craft along the course, and find the margins of a craft like the model."""
        flown = [self.flown(tuning, craft, self.course) for craft in crafts]

        def margin(changed: Callable[[float], dict[str, float]], most: float) -> float:
            """Return the largest change with which the craft flies, by bisection."""
            low, high = 0.0, most
            for _ in range(_HALVINGS):
                middle = (low + high) / 2
                flight = self.flown(tuning, self.craft(0, **changed(middle)), self._move)
                flies = flight.rest < _FLIES**2 and not flight.contacts
                low, high = (middle, high) if flies else (low, middle)
            return low

        most = math.log2(_STRONGEST)
        weaker = margin(lambda octaves: {"thrust": 2**-octaves}, most)
        stronger = margin(lambda octaves: {"thrust": 2**octaves}, most)
        return Followed(
            math.sqrt(np.mean([flight.squared for flight in flown])),
            float(np.mean([flight.effort for flight in flown])),
            sum(flight.contacts for flight in flown),
            margin(lambda delay: {"later": delay}, _LATEST),
            (2**-weaker, 2**stronger),
        )


def tune(
    model: Model,
    tuning: Tuning | None = None,
    *,
    settings: TwinSettings | None = None,
    trials: int = 50,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Tuned:
    """Find weights with which a craft follows a course more closely, with no more effort.

    Each trial flies four twins, which differ from the model by 10 % in thrusts, inertia and lag;
    two also have 1.2 times the thrust and 20 ms more delay. Eight others fly the result.

    Parameters
    ----------
    model : Model
        The controller's model.
    tuning : Tuning, optional
        The start, whose law is tuned; by default the one for the model.
    settings : TwinSettings, optional
        Table, sensors, radio, faults; by default the paper's.
    trials : int, default 50
        Maximum number of tunings to fly; a search needs more than twice the number of weights.
    seed : int, default 0
        Seed of the first twin's craft, noise and radio.
    progress : callable, optional
        Called with the number of flights done and the maximum.

    Returns
    -------
    Tuned
        The tuning, with flights before and after.

    Raises
    ------
    InputError
        If the law names no weights (`airpuck.LawSettings.tuned`), or a number is out of range.

    Examples
    --------
    >>> found = airpuck.tune(model, trials=1)
    >>> found.after.error_m <= found.before.error_m
    True
    """
    from scipy.optimize import NonlinearConstraint, minimize

    numbers.CHECK_FLIGHTS.check(trials, "trials")
    check_seed(seed, "seed")
    start = tuning or tuning_for(model)
    weights = _weights(start)
    world = (settings or default_twin_settings()).without_on_board()
    most = 2 * _TRIAL * trials + 2 * (_HELD_OUT + 3 * _HALVINGS)
    flights = _Flights(model, world, lambda count: progress(count, most))
    kinds = ((), (_STRONGER, _LATER))
    crafts = [flights.craft(seed + k, _SPREAD, *more) for more in kinds for k in range(_TRIAL)]

    def judged(tried: Tuning) -> _Trial:
        """Fly a tuning."""
        return _Trial.of(tried, [flights.flown(tried, craft, flights.course) for craft in crafts])

    def trial(octaves: Float[np.ndarray, " w"]) -> _Trial:
        """Fly changed weights, unless they have been flown."""
        key = tuple(octaves.tolist())
        if key not in flown:
            if len(flown) == trials:
                raise StopIteration
            try:
                tried = _changed(start, weights, octaves)
                TrackingController(model, flights.course, tried)
            except InputError:  # no controller can be designed
                flown[key] = first._replace(cost=first.cost + _REFUSED)
            else:
                flown[key] = judged(tried)
        return flown[key]

    origin, first = np.zeros(len(weights)), judged(start)
    flown = {tuple(origin.tolist()): first}
    effort = NonlinearConstraint(lambda at: _STEEP * (trial(at).effort - first.effort), -np.inf, 0)
    options = {"initial_tr_radius": _FIRST, "final_tr_radius": _LAST, "maxfev": trials}
    search = partial(minimize, method="COBYQA", constraints=effort, options=options)
    with suppress(StopIteration):  # the method flies a few trials more than it counts
        search(lambda at: trial(at).cost - first.cost, origin)
    fair = [one for one in flown.values() if one.effort <= first.effort + _EQUAL]
    best = min(fair, key=lambda one: one.cost).tuning
    held_out = [flights.craft(seed + _TRIAL + number, _SPREAD) for number in range(_HELD_OUT)]
    before = flights.followed(start, held_out)
    after = before if best == start else flights.followed(best, held_out)
    ends = _weights(best)
    changes = {".".join(path[2:] or path[1:]): (weights[path], ends[path]) for path in weights}
    return Tuned(best, changes, before, after, len(flown))


def _weights(tuning: Tuning) -> dict[tuple[str, ...], float]:
    """Return what may change of a tuning, by its place in the file; zeros stay."""
    kind = tuning.law.kind
    settings = getattr(law_class(kind), "Settings", None)
    found: dict[tuple[str, ...], float] = {
        ("estimation", name): getattr(tuning.estimation, name) for name in _FILTER
    }
    if settings is None or not settings.tuned:
        problem = f"{kind!r} has no weights to tune; choose lqr, mpc, or a law of your own whose "
        raise InputError(f"{problem}LawSettings name them as `tuned`", field="law")
    own, table = tuning.of(settings), name_among(tuning.law.tables, settings.law, kind)
    problem = 'must be names of its numbers, such as ("weight",): {error}'
    wrong = AttributeError, TypeError, ValueError
    with explained(wrong, problem, field=f"{settings.__name__}.tuned"):
        for name in settings.tuned:
            found["law", table, *name.split(".")] = float(attrgetter(name)(own))
    positive = {path: value for path, value in found.items() if value > 0}
    if not positive:
        problem = "every number that may be tuned is zero, and tuning cannot change a zero"
        raise InputError(f"{problem}; set at least one above zero", field="tuning")
    return positive


def _changed(
    tuning: Tuning, weights: dict[tuple[str, ...], float], octaves: Float[np.ndarray, " w"]
) -> Tuning:
    """Multiply weights by powers of two."""
    content: dict[str, Any] = tuning.model_dump(mode="json")
    for (path, value), octave in zip(weights.items(), octaves.tolist(), strict=True):
        table = content
        for key in path[:-1]:
            table = table.setdefault(key, {})
        table[path[-1]] = float(f"{value * 2**octave:.3g}") if octave else value
    return checked(content, Tuning)
