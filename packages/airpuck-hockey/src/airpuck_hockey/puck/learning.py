"""Learning a puck's drag and its bounces off the rails during play."""

from __future__ import annotations

import math
from dataclasses import dataclass

from airpuck import AirHockey
from airpuck.extend import Touch
from airpuck_hockey.puck.prediction import ACCELERATION_DENSITY, PuckBelief, PuckModel

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
        rail, spread = model.equipment.puck.rail, model.spread["rail.restitution"]
        self._rail = Scattered(rail.restitution, spread**2 / 2)
        self._drag = model.equipment.puck.drag_1_s, model.drag_error
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
