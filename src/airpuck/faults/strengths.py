"""Actuators that are weak, dead, reversed or swapped throughout a recording.

`find_faults` compares a recording with a model of the healthy craft. A fit to a recording in which
an actuator never works describes that craft as healthy. So identified strengths are compared with
the vehicle file here, and with each other: an error of the file's mass, or a weak supply, changes
all strengths alike and is no actuator's fault.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.numbers import percent
from airpuck.boundary.results import Finding, Result, by_cause
from airpuck.craft.vehicle import Vehicle
from airpuck.data.trajectory import Trajectory
from airpuck.evaluation.presentation import physical_thrust
from airpuck.faults.layout_check import check_layout
from airpuck.faults.layout_findings import AXES, LayoutCheck, propeller_findings
from airpuck.faults.propeller_check import PropellerCheck
from airpuck.model.model_file import Model, nominal_model
from airpuck.physics.thrust import thrust

#: Standard errors which, with the usual spread, a weak actuator is below the others.
_CERTAIN = 4.0
#: Strength relative to the vehicle file below which an actuator without others is weak, and
#: strength above which any is strong.
_WEAK, _STRONG = 0.8, 1.25
#: An actuator that may give nothing, and certainly gives less than this, is dead.
_DEAD = 0.5
#: Half the interval, relative to the others' strength, above which the strength counts as unknown.
_VAGUE = 0.5
#: An effect that is certainly below this fraction of the nominal one is reversed.
_REVERSED = -0.2
#: Deviation of all strengths alike that is worth mentioning: data sheets are 20 % optimistic.
_SCALE = 0.25
#: Fewest actuators whose median distinguishes a common error from one actuator's.
_FEWEST = 3
_TINY = float(np.finfo(float).tiny)
#: Half the 95 % interval of a normal distribution, in standard deviations.
_NORMAL = 1.96
#: Level of all verdicts on a craft together.
_LEVEL = 0.05


@dataclass(frozen=True)
class Strength(Result):
    """Strength of one actuator over a whole recording."""

    JSON = (
        "name nominal_N=nominal strength_N=value interval_95 of_nominal of_others "
        "of_others_interval_95 verdict"
    )

    name: str
    #: Full thrust in the vehicle file, and as identified along the stated direction [N].
    nominal: float
    value: float
    #: Ends of the 95 % interval; None if unknown.
    interval_95: tuple[float, float] | None
    #: Strength relative to the median of the others, each over its nominal one, and its standard
    #: error; relative to the nominal one for wheels, and for craft of one or two propellers.
    of_others: float
    of_others_error: float
    #: Ends of the 95 % interval of that; None if unknown.
    of_others_interval_95: tuple[float, float] | None
    #: ``sound``, ``weak``, ``dead``, ``strong``, ``reversed``, ``acts like NAME`` or ``unknown``.
    verdict: str

    @property
    def of_nominal(self) -> float:
        """Identified strength over the nominal one."""
        return self.value / self.nominal

    @property
    def remarkable(self) -> bool:
        """Whether it is named."""
        return self.verdict not in ("sound", "unknown")

    @property
    def sentence(self) -> str:
        """The finding in words."""
        if self.verdict.startswith("acts like"):
            return f"{self.name} {self.verdict}"
        if self.interval_95 is None:
            return f"{self.name} is {self.verdict}"
        if self.verdict in ("weak", "strong"):
            share, error = 100 * self.of_others, 100 * self.of_others_error
            return f"{self.name} gives {share:.0f} ± {error:.1g} % of the others"
        return f"{self.name} is {self.verdict} ({self._range} of its nominal strength)"

    @property
    def extent(self) -> str:
        """Name and interval."""
        return f"{self.name} ({self._range} of nominal)"

    @property
    def _range(self) -> str:
        """The interval, relative to the nominal strength."""
        low, high = (100 * end / self.nominal for end in self.interval_95 or (np.nan, np.nan))
        return f"{low:.0f} % to {high:.0f} %"


@dataclass(frozen=True)
class Strengths(Result):
    """Strengths of all actuators."""

    JSON = "of_nominal=common actuators sentences"

    actuators: tuple[Strength, ...]
    #: Median of the strengths over their nominal ones.
    common: float

    @property
    def remarkable(self) -> tuple[Strength, ...]:
        """The actuators that are not sound."""
        return tuple(one for one in self.actuators if one.remarkable)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences on actuators that are not sound, and on errors common to all."""
        found = [one.sentence for one in self.remarkable]
        lines = [f"Throughout the recording: {'; '.join(found)}."] if found else []
        vague = [one for one in self.actuators if one.verdict == "unknown" and one.interval_95]
        if vague:
            names = ", ".join(one.extent for one in vague)
            lines.append(f"The recording does not determine the strength of {names}.")
        alone = self.remarkable or abs(self.common - 1) <= _SCALE
        if not alone and all(one.verdict == "sound" for one in self.actuators):
            lines.append(
                f"All propellers give about {percent(self.common)} of their nominal strength: "
                "check mass, supply and nominal thrust in the vehicle file."
            )
        return tuple(lines)


def find_strengths(model: Model, trajectory: Trajectory | None = None) -> Strengths:
    """Compare identified strengths with the vehicle file, and with each other.

    Strengths are the model's. Thrust cannot be negative in a model, so the recording is checked for
    effects in any direction, too (`check_layout`). If that shows reversed or swapped actuators, the
    fit is useless, and all strengths come from the check. The same applies if the table is
    tilted, or rough, and the model does not say so.

    Parameters
    ----------
    model : Model
        A model with the vehicle that its strengths are compared with.
    trajectory : Trajectory, optional
        The recording that it was identified from.

    Returns
    -------
    Strengths
        Each actuator's strength, interval and verdict, and the median of all.

    Examples
    --------
    >>> [one.verdict for one in airpuck.find_strengths(fit.model, trajectory).actuators][:2]
    ['unknown', 'unknown']
    """
    vehicle, wrong = model.vehicle, {}
    stated = _full_thrust(nominal_model(vehicle))
    value, error = _full_thrust(model), np.asarray(model.standard_error(_full_thrust))
    quantile = model.known.quantile if model.known else _NORMAL
    held, by_check = np.full(len(value), False), value
    if trajectory is not None:
        check = checked_layout(trajectory, vehicle)
        wrong = {k: said for k, one in enumerate(check.propellers) if (said := _wrong_way(one))}
        # Strengths that a constraint holds have no error of their own; with wrong axes or a wrong
        # layout, or a floor that the fit attributed to thrusts, none is right.
        lacks = any(getattr(model.parameters, name) is None for name in check.floor)
        useless = wrong or lacks or any(one.suspect for one in check.common)
        held = (np.isfinite(error) & (error <= 0)) | bool(useless)
        if check.conclusive:
            seen = [(p.strength, p.strength_error) for p in check.propellers]
            by_check, spread = stated * np.transpose(seen)
            value = np.where(held, by_check, value)
            error = np.where(held, spread, error)
    among = np.array([not channel.is_wheel for channel in vehicle.actuation.channels])
    # An error of the mass, or of one supply, is common to all propellers, but not to wheels.
    alone = ~among | (np.count_nonzero(among) < _FEWEST)
    among[list(wrong)] = False

    def of_others(strength: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        ratio = strength / stated
        return ratio / np.where(alone, 1.0, _medians_of_others(ratio, among))

    relative = of_others(value)
    by_fit = np.asarray(model.standard_error(lambda one: of_others(_full_thrust(one))))
    by_value = np.abs(relative) * error / np.maximum(np.abs(value), _TINY)
    # Physics that the model lacks, such as drag, spoils the fit's thrusts more than the check's.
    apart = np.where(alone | ~(by_fit > 0), 0.0, np.abs(of_others(by_check) - relative))
    spread = np.where(held, by_value, np.hypot(by_fit, apart))
    verdicts = _verdicts(
        relative, spread, quantile, np.where(alone, np.nan, vehicle.nominal.thrust_spread)
    )
    return Strengths(
        tuple(
            Strength(
                name,
                float(stated[k]),
                float(value[k]),
                _interval(float(value[k]), float(quantile * error[k])),
                float(relative[k]),
                float(spread[k]),
                _interval(float(relative[k]), float(quantile * spread[k])),
                wrong.get(k, verdicts[k]),
            )
            for k, name in enumerate(vehicle.propeller_names)
        ),
        float(np.median((value / stated)[among if among.any() else slice(None)])),
    )


def _medians_of_others(
    ratio: Float[np.ndarray, " n"], among: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Return for each actuator the median of the other actuators that can be compared."""
    # Nearly dead actuators do not count, or a sound one would look strong beside them.
    works = ratio >= _DEAD * np.median(ratio[among]) if among.any() else among
    others = among & works & ~np.eye(len(ratio), dtype=bool)
    medians = [np.median(ratio[row]) if row.any() else 1.0 for row in others]
    return np.where(np.array(medians) > 0, medians, 1.0)


def usual_rung(trajectory: Trajectory, vehicle: Vehicle) -> str:
    """Return the rung to fit by default: M3 plus the effects that the floor clearly has."""
    floor = checked_layout(trajectory, vehicle).floor
    # A rough floor also brakes in proportion to the speed.
    terms = {"tilt": "+tilt", "dish": "+dish", "friction": "+drag+friction"}
    return "M3" + "".join(term for name, term in terms.items() if name in floor)


def on_table_of(model: Model, trajectory: Trajectory) -> Model:
    """Return the model with the effects of a recording's floor that it does not have yet."""
    parameters, floor = model.parameters, checked_layout(trajectory, model.vehicle).floor
    added = {name: v for name, v in floor.items() if getattr(parameters, name) is None}
    if not added:
        return model
    free = {q.name: model.free[parameters.mask(frozenset({q.name}))] for q in parameters.quantities}
    parameters = replace(parameters, **added)
    free = parameters.laid_out(free, False)
    return replace(model, parameters=parameters, free=free, uncertainty=None)


def _wrong_way(one: PropellerCheck) -> str:
    """Return the verdict on an actuator that is reversed or swapped; empty if it is not."""
    if one.verdict.startswith("behaves like"):
        return f"acts like {one.behaves_like}"
    reversed_ = one.strength + _simultaneous(1, np.inf) * one.strength_error < _REVERSED
    return "reversed" if one.verdict.startswith("pushes the other way") and reversed_ else ""


def _full_thrust(model: Model) -> Float[np.ndarray, " n"]:
    """Return the thrust of each actuator at the largest command [N]."""
    coefficients = physical_thrust(model)
    return thrust(coefficients, np.full(len(coefficients), model.vehicle.command_max))


def _simultaneous(count: int, degrees: float) -> float:
    """Return half the width of intervals that hold for all actuators at once [errors]."""
    from scipy.special import stdtrit

    return float(stdtrit(min(degrees, 1e6), 1 - _LEVEL / 2 / count))


def _verdicts(
    relative: Float[np.ndarray, " n"],
    error: Float[np.ndarray, " n"],
    quantile: float,
    usual: Float[np.ndarray, " n"],
) -> list[str]:
    """Judge strengths relative to the others, whose `usual` spread is NaN without others."""
    reach = _simultaneous(len(relative), _degrees(quantile)) * error
    judged = []
    for middle, half, single, spread in zip(relative, reach, error, usual, strict=True):
        below = (
            middle + half < _WEAK
            if np.isnan(spread)
            else 1 - middle > math.hypot(_CERTAIN * single, spread)
        )
        if not half > 0:
            judged.append("unknown")
        elif middle + half < _DEAD and middle - half <= 0:
            judged.append("dead")
        elif below:
            judged.append("weak")
        elif half > _VAGUE:
            judged.append("unknown")
        else:
            judged.append("strong" if middle - half > _STRONG else "sound")
    return judged


def _degrees(quantile: float) -> float:
    """Return the degrees of freedom of Student's distribution with this 97.5 % quantile."""
    from scipy.special import stdtridf

    return float(stdtridf(0.975, quantile)) if quantile > _NORMAL else np.inf


def _interval(value: float, reach: float) -> tuple[float, float] | None:
    """Return the ends of an interval; None if its width is unknown."""
    return (float(value - reach), float(value + reach)) if reach > 0 else None


#: Headings of `strength_rows`.
STRENGTH_HEADINGS = (
    "actuator",
    "nominal [N]",
    "identified [N]",
    "95 %",
    "of nominal",
    "of the others",
    "verdict",
)


def strength_rows(strengths: Strengths) -> list[list[str]]:
    """Return the row of a printed table for each actuator."""
    rows = []
    # Three digits of the weakest nominal strength, so that all rows of a column are comparable.
    weakest = min((one.nominal for one in strengths.actuators if one.nominal > 0), default=1.0)
    digits = max(0, 2 - math.floor(math.log10(weakest)))
    for one in strengths.actuators:
        ends = one.interval_95 and " … ".join(f"{end:.{digits}f}" for end in one.interval_95)
        numbers = [f"{one.nominal:.{digits}f}", f"{one.value:.{digits}f}", ends or "unknown"]
        shares = [f"{100 * share:.0f} %" for share in (one.of_nominal, one.of_others)]
        rows.append([one.name, *numbers, *shares, one.verdict])
    return rows


#: Pulses of 1 to 2 ms divided by the longest leave commands above this, while motors idle below
#: the second number, and the fraction of the time that a command rests at its lowest value.
_LOWEST_PULSE, _IDLES_BELOW, _RESTS = 0.4, 0.3, 0.05
#: Least largest command of pulses, and fraction of the unexplained motion left by their neutral.
_REACHES, _BETTER = 0.9, 0.6
#: Tolerance of equal commands [1].
_SAME = 1e-3

#: The latest check of each recording, and the vehicle file that it was checked against.
_checks: WeakKeyDictionary[Trajectory, tuple[Vehicle, LayoutCheck]] = WeakKeyDictionary()


def checked_layout(
    trajectory: Trajectory, vehicle: Vehicle, axes: Sequence[str] = AXES
) -> LayoutCheck:
    """Check the layout, once for all who ask."""
    known = _checks.get(trajectory)
    if known is None or known[0] != vehicle:
        known = _checks[trajectory] = vehicle, check_layout(trajectory, vehicle)
    return replace(known[1], axes=tuple(axes))


def recording_findings(
    trajectory: Trajectory, vehicle: Vehicle, axes: Sequence[str] = AXES
) -> tuple[Finding, ...]:
    """Return what is wrong with poses, commands and layout, in the order of causes.

    Lines for the mapping file are in terms of its `axes`. The floor is left out: a model with the
    right terms is not wrong on it.
    """
    if pulses := _pulse_widths(trajectory, vehicle):
        return pulses
    check = checked_layout(trajectory, vehicle, axes)
    if not check.conclusive:
        return ()
    common = [one for one in check.common if one.kind != "physics"]
    return by_cause((*common, *propeller_findings(check)))


def _pulse_widths(trajectory: Trajectory, vehicle: Vehicle) -> tuple[Finding, ...]:
    """Report commands that look like pulse widths whose neutral was not subtracted."""
    command = trajectory.command
    if vehicle.actuation.two_way.any() or vehicle.command_min > _IDLES_BELOW or not len(command):
        return ()
    lowest = command.min(axis=0)
    rests = np.mean(command <= lowest + _SAME, axis=0)
    idle = float(np.median(lowest))
    moves = np.ptp(command, axis=0) > _SAME
    if not (moves.all() and (np.abs(lowest - idle) <= _SAME).all() and (rests > _RESTS).all()):
        return ()
    if idle < _LOWEST_PULSE or command.max() < _REACHES:
        return ()
    # As pulses they must explain the motion better; a motor may also rest at such a command.
    pulses = replace(trajectory, command=(command - idle) / (1 - idle))
    left = 1 - check_layout(pulses, vehicle).explained
    if left > _BETTER * (1 - checked_layout(trajectory, vehicle).explained):
        return ()
    cause = "The commands look like pulse widths without their neutral"
    remedy = (
        "Use neutral and span instead of scale in the mapping file, under [command], such as "
        "neutral = 1000, span = 1000; if motors do idle there, say so in the vehicle file "
        "(command_min)."
    )
    return (Finding("units", cause, f"every motor rests at {idle:.2g}, never below", remedy),)
