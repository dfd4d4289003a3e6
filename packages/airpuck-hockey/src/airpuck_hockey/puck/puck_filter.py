"""A Kalman filter for the puck that includes the rails and detects hits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from airpuck import AirHockey, InputError, PuckState
from airpuck.extend import Touch, checked_class, numbers, sigma_of, time_of, walls_of
from airpuck_hockey.puck.prediction import (
    ACCELERATION_DENSITY,
    PuckBelief,
    PuckCrossing,
    PuckModel,
    PuckPrediction,
    predict_crossing,
    predict_puck,
    process_noise,
)

# Numbers without a source are guesses.
#: Time after a bounce or a hit until the velocity is known to a percent [s]: ten frames.
_SETTLES = 0.04
#: Bounces slower than this along the normal are not used [m/s]: the noise of the speed counts.
_SLOW = 0.3
#: Flights shorter than this say nothing about drag [s].
_SHORT = 0.1
#: Weight of the prior scatter, in bounces.
_PRIOR_BOUNCES = 3.0
#: Smallest deviation of the drag, which differs from place to place [1/s].
_DRAG_SCATTER = 0.01


@dataclass(frozen=True)
class Scattered:
    """Belief about a number that scatters from sample to sample, with unknown mean and scatter.

    Conjugate prior of normal samples: a normal mean with inverse-gamma variance.
    """

    mean: float
    #: Variance of a sample around the true mean.
    variance: float
    #: Weights of the belief in samples: of the mean, of the variance.
    known: float = 1.0
    freedom: float = _PRIOR_BOUNCES

    def seen(self, sample: float) -> Scattered:
        """Return the belief after another sample."""
        away, known, freedom = sample - self.mean, self.known + 1, self.freedom + 1
        squares = self.variance * self.freedom + away**2 * self.known / known
        return Scattered(self.mean + away / known, squares / freedom, known, freedom)

    @property
    def deviation(self) -> float:
        """Standard deviation of the next sample."""
        return math.sqrt(self.variance * (1 + 1 / self.known))


class PuckLearner:
    """Updates drag and restitution of the rails with each free flight and each bounce.

    Parameters
    ----------
    model : PuckModel
        Table and puck, with the uncertainty before play.
    """

    def __init__(self, model: PuckModel) -> None:
        self.model = model
        puck, spread = model.equipment.puck, model.spread
        self._rail = Scattered(puck.rail.restitution, spread["rail.restitution"] ** 2 / 2)
        self._drag = puck.drag_1_s, spread["drag_1_s"]
        #: Time of the last contact [s], and the bounce, if it was one.
        self._since, self._bounce = -math.inf, None
        self._start: PuckBelief | None = None

    def touched(
        self, time: float, last: PuckBelief | None = None, bounce: Touch | None = None
    ) -> None:
        """End the present flight: a bounce off a rail, or any other contact or gap."""
        if last is not None and self._start is not None:
            self._learn_drag(self._start, last)
        self._since, self._bounce, self._start = time, bounce, None

    def flies(self, belief: PuckBelief) -> None:
        """Receive the belief at a pose of the free flight."""
        if self._start is not None or belief.time < self._since + _SETTLES:
            return
        self._start = belief
        if self._bounce is not None:
            self._learn_restitution(self._bounce, belief)

    def _learn_drag(self, start: PuckBelief, end: PuckBelief) -> None:
        """Compare the speeds at both ends of a flight."""
        duration = end.time - start.time
        before, after = (math.hypot(*belief.mean[3:5]) for belief in (start, end))
        if duration < _SHORT or after < _SLOW:
            return
        seen = math.log(before / after) / duration
        variances = [float(belief.covariance[3, 3]) for belief in (start, end)]
        noise = (sum(variances) + ACCELERATION_DENSITY**2 * duration) / (after * duration) ** 2
        mean, deviation = self._drag
        gain = deviation**2 / (deviation**2 + noise)
        deviation = max(math.sqrt(1 - gain) * deviation, min(_DRAG_SCATTER, deviation))
        self._drag = max(mean + gain * (seen - mean), 0.0), deviation
        self._changed()

    def _learn_restitution(self, bounce: Touch, after: PuckBelief) -> None:
        """Compare the speeds along the normal before and after a bounce."""
        table, puck = self.model.equipment.table, self.model.equipment.puck
        x, y = table.reach(puck.radius_m)
        at = bounce.before
        side = abs(at.y) - y > abs(at.x) - x
        closing = at.vy if side else at.vx
        slower = math.exp(-puck.drag_1_s * (after.time - bounce.time))
        leaving = -float(after.mean[4 if side else 3]) / slower * math.copysign(1.0, closing)
        if abs(closing) > _SLOW and 0 < leaving < abs(closing):
            self._rail = self._rail.seen(leaving / abs(closing))
            self._changed()

    def _changed(self) -> None:
        """Rebuild the model."""
        equipment: AirHockey = self.model.equipment
        puck, (drag, drag_error) = equipment.puck, self._drag
        learned = {"drag_1_s": drag_error, "rail.restitution": self._rail.deviation}
        rail = puck.rail.model_copy(update={"restitution": self._rail.mean})
        update = {
            "drag_1_s": drag,
            "rail": rail,
            "standard_error": {**puck.standard_error, **learned},
        }
        puck = puck.model_copy(update=update)
        self.model = PuckModel(equipment.model_copy(update={"puck": puck}))


#: A measurement whose squared, normalised innovation exceeds this is not noise: once in 1e7 frames.
GATE = 35.0
#: Standard deviations of velocity and spin after a hit [m/s, rad/s].
_UNKNOWN = np.array([10.0, 10.0, 50.0])
#: Correlation time of the error of the drag [s].
_DRAG_MEMORY = 0.1
#: After a longer gap in the measurements the filter restarts [s].
_LOST = 0.5
#: Longest time that a puck is predicted ahead [s].
_LONGEST = 60.0
_AHEAD = numbers.Range(0, _LONGEST, "predictions begin at the last pose and are short", "s")
#: A smaller change of velocity has no direction [m/s].
_NO_CHANGE = 1e-6
#: Frames closer in time than this are the same frame [s].
_SAME = 1e-6


class PuckEvent(NamedTuple):
    """An event detected by the filter."""

    #: Time of the event [s].
    time: float
    #: A bounce off the table, a hit, or the first sighting.
    kind: Literal["rail", "post", "hit", "seen"]


@dataclass(frozen=True)
class PuckNoise:
    """Standard deviations of the measured poses."""

    position_m: float = 5e-5
    yaw_rad: float = 7e-4


@checked_class
class PuckFilter:
    """Estimates the puck's motion from its poses.

    Between bounces it is a Kalman filter with the drag of the puck; bounces off rails and posts are
    predicted. A pose too far from the prediction is a hit, unless the next pose agrees with the
    earlier belief: then it was an outlier.

    Parameters
    ----------
    equipment : AirHockey
        Table and puck.
    noise : PuckNoise, optional
        Noise of the poses.
    learns : bool, default True
        Whether to learn drag and restitution of the rails from the puck's flights.

    Attributes
    ----------
    belief : PuckBelief or None
        Belief at the last pose; None before the first.
    events : list of PuckEvent
        Events since the start.
    outliers : int
        Number of unused poses.
    model : PuckModel
        Current estimate of table and puck.

    Examples
    --------
    >>> puck = airpuck_hockey.PuckFilter(airpuck.AirHockey())
    >>> for k in range(10):
    ...     puck.pose(0.01 * k, np.array([0.01 * k, 0.0, 0.0]))  # 1 m/s along x
    >>> puck.belief.mean[3:5].round(1).tolist()
    [1.0, 0.0]
    """

    def __init__(
        self, equipment: AirHockey, noise: PuckNoise | None = None, *, learns: bool = True
    ) -> None:
        noise = noise or PuckNoise()
        self.model = PuckModel(equipment)
        self._learner = PuckLearner(self.model) if learns else None
        self.belief: PuckBelief | None = None
        self.events: list[PuckEvent] = []
        self.outliers = 0
        self._noise = np.diag(np.square([noise.position_m, noise.position_m, noise.yaw_rad]))
        self._walls = walls_of(equipment)
        # Belief before a pose that did not fit.
        self._before: PuckBelief | None = None

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Receive a pose of the puck.

        Parameters
        ----------
        time : float
            Time stamp of the pose [s]; a pose that is not newer than the last is ignored.
        pose : array, shape (3,)
            x, y [m], yaw [rad].

        Raises
        ------
        InputError
            If the pose is not three numbers.
        """
        if np.shape(pose) != (3,):
            raise InputError("must be three numbers", field="pose")
        if not (math.isfinite(time) and np.isfinite(pose).all()):
            return
        pose = np.asarray(pose, dtype=float)
        if self.belief is not None and time <= self.belief.time + _SAME:
            return
        if self.belief is None or time > self.belief.time + _LOST:
            self._begin(time, pose, "seen")
            return
        if self._before is not None:
            self._decide(time, pose)
        moved, bounces = self._moved(self.belief, time)
        innovation, gain, distance = self._compared(moved, pose)
        if distance > GATE:
            # Twice in a row: the first one was a hit.
            self._before = self.belief if self._before is None else None
            self._begin(time, pose, None)
            return
        self.events += [PuckEvent(t.time, t.met) for t in bounces if t.met in ("rail", "post")]
        last, self.belief = self.belief, self._corrected(moved, innovation, gain)
        if self._learner is not None:
            if bounces:
                single = bounces[0] if [t.met for t in bounces] == ["rail"] else None
                self._learner.touched(bounces[-1].time, last, single)
            self._learner.flies(self.belief)
            self.model = self._learner.model

    def predict(self, times: list[float]) -> PuckPrediction:
        """Predict an untouched puck; see `predict_puck`.

        Parameters
        ----------
        times : list of float
            Prediction times [s], increasing; none before the last pose.

        Returns
        -------
        PuckPrediction
            Mean, covariance and bounces.

        Raises
        ------
        InputError
            If no pose has come, a time is before the last pose, or times decrease.
        """
        if self.belief is None:
            raise InputError("no pose of the puck has come yet")
        for time in times:
            _AHEAD.check(time - self.belief.time, "times")
        if (np.diff(times) < 0).any():
            raise InputError("must not decrease", field="times")
        return predict_puck(self.model, self.belief, times)

    def crossing(self, x: float, horizon: float = 2.0) -> PuckCrossing | None:
        """Predict where an untouched puck will cross a line; see `predict_crossing`.

        Parameters
        ----------
        x : float
            Position of the line [m].
        horizon : float, default 2
            Prediction horizon [s].

        Returns
        -------
        PuckCrossing or None
            The crossing; None if there is none in time, or no pose has come.

        Raises
        ------
        InputError
            If a number is not finite, or the horizon is too long.
        """
        numbers.check_finite(x=x)
        _AHEAD.check(horizon, "horizon")
        return self.belief and predict_crossing(self.model, self.belief, x, horizon)

    def _begin(
        self, time: float, pose: Float[np.ndarray, " 3"], kind: Literal["seen"] | None
    ) -> None:
        """Restart from a pose, with unknown velocity."""
        if self._learner is not None:
            self._learner.touched(time)
        covariance = np.diag(np.concatenate([self._noise.diagonal(), np.square(_UNKNOWN)]))
        self.belief = PuckBelief(time, np.concatenate([pose, np.zeros(3)]), covariance)
        if kind is not None:
            self._before = None
            self.events.append(PuckEvent(time, kind))

    def _decide(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Decide from the next pose whether the one before was an outlier or a hit."""
        before, self._before = self._before, None
        assert before is not None
        assert self.belief is not None
        moved, _ = self._moved(before, time)
        if self._compared(moved, pose)[2] <= GATE:
            self.outliers += 1
            self.belief = before
            return
        # Where the old path and the new one meet.
        span = time - before.time
        now = (pose[:2] - self.belief.mean[:2]) / (time - self.belief.time)
        change = before.mean[3:5] - now
        missing = pose[:2] - before.mean[:2] - now * span
        when = float(missing @ change / max(change @ change, _NO_CHANGE**2))
        latest = self.belief.time
        self.events.append(PuckEvent(min(max(before.time + when, before.time), latest), "hit"))

    def _moved(self, belief: PuckBelief, time: float) -> tuple[PuckBelief, tuple[Touch, ...]]:
        """Return the belief at a later time, and the contacts until then."""
        puck, duration = self.model.equipment.puck, time - belief.time
        bounce = self._walls.first(PuckState(*belief.mean.tolist()))
        if time_of(puck.drag_1_s, bounce.sigma) <= duration:
            found = predict_puck(self.model, belief, [time])
            return PuckBelief(time, found.mean[0], found.covariance[0]), found.touches
        sigma, turned = (sigma_of(rate, duration) for rate in (puck.drag_1_s, puck.spin_drag_1_s))
        left, spins = 1 - puck.drag_1_s * sigma, 1 - puck.spin_drag_1_s * turned
        step = np.eye(6)
        step[3, 3] = step[4, 4] = left
        step[5, 5] = spins
        step[0, 3] = step[1, 4] = sigma
        step[2, 5] = turned
        speed = math.hypot(*belief.mean[3:5].tolist())
        slowed = self.model.spread["drag_1_s"] * speed
        density = ACCELERATION_DENSITY + slowed * math.sqrt(_DRAG_MEMORY)
        grown = step @ belief.covariance @ step.T + process_noise(duration, density)
        return PuckBelief(time, step @ belief.mean, grown), ()

    def _compared(
        self, belief: PuckBelief, pose: Float[np.ndarray, " 3"]
    ) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "6 3"], float]:
        """Return a pose's innovation, its gain, and its squared distance from the belief."""
        innovation = pose - belief.mean[:3]
        innovation[2] = math.remainder(innovation[2], 2 * math.pi)
        inverse = np.linalg.inv(belief.covariance[:3, :3] + self._noise)
        gain = belief.covariance[:, :3] @ inverse
        return innovation, gain, float(innovation @ inverse @ innovation)

    def _corrected(
        self,
        belief: PuckBelief,
        innovation: Float[np.ndarray, " 3"],
        gain: Float[np.ndarray, "6 3"],
    ) -> PuckBelief:
        """Update the belief with a measured pose."""
        # Joseph's form stays positive definite after a hit, when variances differ by 1e10.
        left = np.eye(6)
        left[:, :3] -= gain
        corrected = left @ belief.covariance @ left.T + gain @ self._noise @ gain.T
        return PuckBelief(belief.time, belief.mean + gain @ innovation, corrected)
