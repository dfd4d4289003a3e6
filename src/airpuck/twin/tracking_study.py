"""The tracking study (fig:control_lqr): the paper's set points on the twin and in reality."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError, about
from airpuck.boundary.results import Result, plain
from airpuck.control.law import Law
from airpuck.control.laws import PAPERS, law_label, numbered
from airpuck.control.lqr import LQRSettings, lqr_gain
from airpuck.control.reference import SetPoints, check_inside
from airpuck.control.settings import DWELL, ControllerKind, Dwell
from airpuck.control.tuning import Tuning, tuning_for
from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle
from airpuck.deviation.time_scale import patience
from airpuck.flight.loop import FlightLog, PilotMaker, pilot_named
from airpuck.flight.replay import Gains, replay
from airpuck.flight.track import SetPointResult, Track
from airpuck.model.model_file import Model
from airpuck.recording.stream import Recording
from airpuck.twin.experiments import track
from airpuck.twin.plant import build_plant, varied
from airpuck.twin.settings import TwinSettings, default_twin_settings

#: The paper's set points (fig:control_lqr): x, y [m], yaw [rad]; from the centre and back.
SET_POINTS = ((0.0, 0.0, 0.0), (1.0, 0.3, 1.5), (0.5, -0.3, -1.0), (0.0, 0.0, 0.0))
#: Distance of the paper's craft from a rail there [m]; time before the first set point [s].
_ROOM, _LEAD = 0.03, 0.9
_Border = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Tracked(Result):
    """One flight through the set points."""

    JSON = "model pilot law gains setpoints=results outcomes"

    #: Name of the controller's model.
    model: str
    #: Law of the controller; None if a user's pilot flew.
    law: str | None
    #: Gains of the LQR; None if another law or pilot flew.
    gains: Gains | None
    #: The flight on the twin.
    twin: Track
    #: The real flight that it reproduces.
    real: Track | None
    #: The controller's log on the twin.
    log: FlightLog
    #: The craft and its table.
    vehicle: Vehicle
    table: Table
    #: Label for tables: the model, plus the law or the pilot if there are several or a user's.
    label: str
    #: Class name of a user's pilot, and a warning.
    pilot: str | None = None
    warnings: tuple[str, ...] = ()

    @property
    def recording(self) -> Recording:
        """The recording of the flight on the twin."""
        return self.log.recording

    @property
    def file_name(self) -> str:
        """The suffix of file names that distinguishes flights."""
        return self.model if self.law in (None, PAPERS) else f"{self.model}_{law_label(self.law)}"

    @property
    def results(self) -> list[SetPointResult]:
        """Results of the set points on the twin, without the initial one."""
        return self.twin.moves()

    @property
    def tracks(self) -> dict[str, Track]:
        """The flight on the twin and, if there is one, the real flight."""
        return {"twin": self.twin} | ({} if self.real is None else {"real flight": self.real})

    @property
    def outcomes(self) -> Mapping[str, int]:
        """Number of control steps per outcome."""
        return dict(sorted(Counter(self.log.status).items()))

    @property
    def clearance(self) -> Float[np.ndarray, " N"]:
        """Distance of the craft's edge to the nearest rail at each pose of the twin [m]."""
        reach = np.array(self.table.reach(self.vehicle.radius_m))
        return np.min(reach - np.abs(self.twin.pose[:, :2]), axis=1)

    @property
    def saturated(self) -> Bool[np.ndarray, "K n"]:
        """Which commands are at the motors' maximum."""
        return np.abs(self.log.command) >= self.vehicle.command_max - 1e-6

    @property
    def step_times(self) -> list[float]:
        """Median, 99 % quantile and maximum of the control step's computing time [ms]."""
        return (1e3 * np.quantile(self.log.took, [0.5, 0.99, 1.0])).tolist()

    @property
    def origin(self) -> float:
        """Start of the figure's time axis [s]; see `Track.origin`."""
        return (self.real or self.twin).origin

    @property
    def rmse(self) -> Float[np.ndarray, " 3"] | None:
        """Difference between twin and real flight, root mean square [m, m, rad].

        Over the six seconds from the first set point that differs from the start, which is 0.5 to
        6.5 s on the figure's axis (`origin`).
        """
        if self.real is None:
            return None
        return np.sqrt(np.mean(self.real.difference(self.twin) ** 2, axis=0))

    def figures(self) -> dict[str, float]:
        """Summarise the flight: means over the set points, and the worst of errors."""
        results = self.results
        settled = [r.settling_time for r in results if r.settling_time is not None]
        steady = np.abs([r.steady_state_error or (np.nan,) * 3 for r in results]).max(axis=0)
        overshoot = np.max([r.overshoot for r in results], axis=0)
        met = sum(self.outcomes.get(status, 0) for status in ("exact", "optimal"))
        worst = {
            f"{name}_{channel}": float(value)
            for name, values in (("steady_state_error", steady), ("overshoot", overshoot))
            for channel, value in zip(("x_m", "y_m", "yaw_rad"), values, strict=True)
        }
        return {
            "not_settled": float(len(results) - len(settled)),
            "settling_time_s": float(np.mean(settled)) if settled else np.nan,
            **worst,
            "effort": float(np.mean([r.effort for r in results])),
            "inexact": 1 - met / len(self.log.status),
        }

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``saturated``, the share of commands at the upper limit; ``clearance_m``, the smallest
        distance of the craft's edge to a rail; ``step_ms``, times of a control step: ``p50``,
        ``p99``, ``max``. If a flight is reproduced, also ``flight_setpoints`` of that flight, and
        ``against_flight``: ``rmse`` of the twin against it over ``span_s``; times count from
        ``origin_s`` of the flight.
        """
        figures = super().to_json() | {
            "saturated": float(self.saturated.mean()),
            "clearance_m": float(self.clearance.min()),
            "step_ms": dict(zip(("p50", "p99", "max"), self.step_times, strict=True)),
        }
        if self.real is not None and self.rmse is not None:
            figures["against_flight"] = {
                "rmse": dict(zip(("x_m", "y_m", "yaw_rad"), self.rmse.tolist(), strict=True)),
                # On the figure's axis, which begins at this time of the flight.
                "span_s": [0.5, 6.5],
                "origin_s": self.origin,
            }
            figures["flight_setpoints"] = plain(self.real.moves())
        return figures


def tracking_study(
    models: Sequence[Model],
    truth: Model,
    *,
    flights: Sequence[Recording | None] = (),
    set_points: SetPoints | None = None,
    dwell: Dwell | None = None,
    seed: int = 0,
    controller: ControllerKind = None,
    laws: Sequence[str | type[Law] | Law] = (),
    settings: TwinSettings | None = None,
    tuning: Tuning | None = None,
    make_pilot: PilotMaker | None = None,
) -> list[Tracked]:
    """Fly set points, by default the paper's, on the twin with several models and laws.

    To compare with a real flight, the twin flies that flight's set points at its times, from the
    same start, with LQR gains fitted to its log. Otherwise it flies the given set points with the
    tuning's gains.

    Parameters
    ----------
    models : sequence of Model
        Models for the controller, one flight each.
    truth : Model
        The truth of the twin.
    flights : sequence of Recording or None, optional
        The real flight of each model, if there is one.
    set_points : SetPoints, optional
        Set points if no flight is reproduced; by default the paper's, moved inwards into reach.
    dwell : float, optional
        Time at each of the paper's set points [s]; by default 2, and longer for a slow craft.
    seed : int, default 0
        Seed of noise and radio.
    controller : {"paper", "full"}, optional
        ``full`` compensates the transport delay and rejects disturbances. By default it flies if a
        law is not ``lqr``; the paper's controller did neither.
    laws : sequence of str, subclass of Law or object of it, optional
        Laws that each model flies with, or FILE.py:NAME of a pilot; by default the tuning's law.
    settings : TwinSettings, optional
        Table, sensors, radio, faults; by default the paper's.
    tuning : Tuning, optional
        Tuning of the controller; by default the one for the model.
    make_pilot : callable, optional
        Factory of a user's pilot from (model, reference), which replaces the controller.

    Returns
    -------
    list of Tracked
        For each model, one flight per law.

    Raises
    ------
    InputError
        If a model does not fit the twin, a recording lacks a stream, a set point is beyond the
        rails, or the pilot is invalid.

    Examples
    --------
    >>> (flown,) = airpuck.tracking_study([model], model, flights=(None,), dwell=0.1)
    >>> bool(0 < flown.clearance.min() < 0.55)  # [m] from the rails
    True
    """
    settings = settings or default_twin_settings()
    border = settings.table.reach(truth.vehicle.radius_m)
    if set_points is not None:
        check_inside(set_points, border, "the rails")
    dwell = DWELL * patience(truth.vehicle) if dwell is None else dwell
    tunings = [tuning or tuning_for(model) for model in models]
    laws = laws or tuple({one.law.kind: None for one in tunings})
    beyond_paper = any(law != PAPERS for law in laws)
    full = beyond_paper if controller is None else controller == "full"
    fly = partial(
        _flown,
        truth=truth,
        seed=seed,
        compensate_delay=full,
        reject_disturbance=full,
        settings=settings,
        plant=build_plant(truth, settings),
    )
    found = []
    padded = [*flights, *[None] * (len(models) - len(flights))]
    for model, flight, tuned in zip(models, padded, tunings, strict=True):
        task = _Task.planned(set_points, dwell, border)
        if flight is not None:
            task = _Task.flown(Track.of(flight, model.vehicle, f"{model.name}, real"), border)
        for kind, name in zip(laws, numbered([law_label(law) for law in laws]), strict=True):
            label = f"{model.name} {name}" if beyond_paper else model.name
            named = isinstance(kind, str)
            with about(None, lambda field: field or "laws"):
                own = make_pilot or (pilot_named(kind) if named else None)
                controls = tuned.with_law(kind) if named else tuned
            found.append(fly(model, flight, task, label, kind, tuning=controls, make_pilot=own))
    return found


def _flown(
    model: Model,
    flight: Recording | None,
    task: _Task,
    label: str,
    law: str | type[Law] | Law,
    *,
    truth: Model,
    settings: TwinSettings,
    tuning: Tuning,
    make_pilot: PilotMaker | None,
    **options: Any,
) -> Tracked:
    """Fly a task on the twin with one model and one law; `options` go to `track`."""
    pilot = gains = None
    if make_pilot is not None:
        label = f"{(pilot := law_label(make_pilot))} ({model.name})"
    elif law == PAPERS:
        gains = Gains.of(lqr_gain(tuning.of(LQRSettings).weights, tuning.period_s))
        if flight is not None:
            gains = replay(flight, model, tuning=tuning, fit_gains=True).gains or gains
    log = track(
        model,
        task.set_points,
        task.duration,
        truth=truth,
        pose=task.pose,
        gain=None if gains is None else gains.matrix(),
        settings=settings,
        tuning=tuning,
        make_pilot=make_pilot,
        law=law,
        **options,
    )
    return Tracked(
        model=model.name,
        law=None if pilot else law if isinstance(law, str) else law_label(law),
        gains=gains,
        twin=Track.of(log.recording, truth.vehicle, f"{model.name}, twin"),
        real=task.real,
        log=log,
        vehicle=truth.vehicle,
        table=settings.table,
        label=label,
        pilot=pilot,
        warnings=() if pilot is None else log.warnings,
    )


@dataclass(frozen=True, eq=False)
class _Task:
    """The task of a flight: set points, start and duration."""

    set_points: SetPoints
    #: Length [s].
    duration: float
    #: Initial pose of the craft.
    pose: tuple[float, float, float]
    #: The real flight that it reproduces.
    real: Track | None

    @classmethod
    def planned(cls, set_points: SetPoints | None, dwell: float, border: _Border) -> _Task:
        """Return a flight from the centre; the paper's set points move inwards to be in reach."""
        if set_points is None:
            changes = _LEAD + dwell * np.arange(len(SET_POINTS) - 1)
            room = np.maximum(np.array([*border, np.inf]) - _ROOM, 0.0)
            points = np.clip(SET_POINTS, -room, room).tolist()
            set_points = SetPoints([0.0, *changes.tolist()], points)
        return cls(set_points, float(set_points.times[-1]) + dwell, (0.0, 0.0, 0.0), None)

    @classmethod
    def flown(cls, real: Track, border: _Border) -> _Task:
        """Return a real flight's set points at its times, from the same start."""
        first = min(int(np.searchsorted(real.time, 0.0)), len(real.time) - 1)
        # A craft that touches a rail may seem to be beyond it: noise, or another radius.
        reach = np.array([*border, np.inf])
        x, y, yaw = np.clip(real.pose[first], -reach, reach).tolist()
        return cls(real.set_points, float(real.command_time[-1]), (x, y, yaw), real)


@dataclass(frozen=True, eq=False, repr=False)
class ControllerComparison(Result):
    """Flights of several laws, on the same craft with the same noise.

    Attributes
    ----------
    laws : tuple of str
        The laws; others are compared with the first.
    figures : dict of str to array, shape (L, N)
        Of each law and flight: ``settling_time_s`` and ``effort`` (means over the set points; the
        settling time is NaN unless the craft settled at all of them), ``overshoot_x_m``,
        ``steady_state_error_x_m`` and so on (the worst), ``not_settled`` (number of set points),
        ``inexact`` (share of control steps whose command was neither exact nor optimal).

    Examples
    --------
    >>> points = airpuck.SetPoints([0.0, 0.2], [(0.0, 0.0, 0.0), (0.3, 0.1, 0.0)])
    >>> found = airpuck.compare_controllers(model, flights=2, set_points=points)
    >>> isinstance(found, airpuck.ControllerComparison), found.laws
    (True, ('lqr', 'mpc'))
    """

    JSON = "laws figures means differences"

    laws: tuple[str, ...]
    figures: dict[str, Float[np.ndarray, "L N"]]

    @property
    def means(self) -> dict[str, list[tuple[float, float, float]]]:
        """By figure, the mean of each law and the ends of its 95 % interval."""
        return {k: [_mean(row) for row in rows] for k, rows in self.figures.items()}

    @property
    def differences(self) -> dict[str, list[tuple[float, float, float]]]:
        """By figure, each further law minus the first, flight by flight; see `means`."""
        return {k: [_mean(row - rows[0]) for row in rows[1:]] for k, rows in self.figures.items()}

    def __repr__(self) -> str:
        count = len(self.figures["effort"][0])
        lines = [f"ControllerComparison of {count} flights each, with 95 % intervals"]
        failed = (self.figures["not_settled"] > 0).sum(axis=1)
        for name, words in (
            ("settling time", self._compared("settling_time_s", " s")),
            ("flights that did not settle", [f"{n} of {count}" if n else "0" for n in failed]),
            ("effort", self._compared("effort")),
        ):
            pairs = zip(map(law_label, self.laws), words, strict=True)
            lines.append(f"{name}: {'; '.join(map(' '.join, pairs))}")
        return "\n".join(lines)

    def _compared(self, name: str, unit: str = "") -> list[str]:
        """Write the mean of the first law, and differences of others if any pair has both."""
        means = [mean for mean, *_ in self.means[name]]
        words = ["never settled" if np.isnan(mean) else f"{mean:.3g}{unit}" for mean in means]
        for number, (mean, low, high) in enumerate(self.differences[name], start=1):
            if not np.isnan(mean):
                interval = "" if np.isnan(low) else f" ({low:+.3g} to {high:+.3g})"
                words[number] = f"{mean:+.3g}{unit}{interval}"
        return words


def _mean(sample: Float[np.ndarray, " N"]) -> tuple[float, float, float]:
    """Return the mean of finite values and its 95 % interval, by Student's t."""
    from scipy.special import stdtrit

    sample = sample[np.isfinite(sample)]
    if len(sample) < 2:
        return (float(sample.mean()) if len(sample) else np.nan, np.nan, np.nan)
    half = stdtrit(len(sample) - 1, 0.975) * sample.std(ddof=1) / np.sqrt(len(sample))
    return float(sample.mean()), float(sample.mean() - half), float(sample.mean() + half)


def compare_controllers(
    model: Model,
    laws: Sequence[str | type[Law] | Law] = ("lqr", "mpc"),
    *,
    truth: Model | None = None,
    flights: int = 10,
    spread: float = 0.1,
    seed: int = 0,
    set_points: SetPoints | None = None,
    dwell: Dwell | None = None,
    settings: TwinSettings | None = None,
    tuning: Tuning | None = None,
) -> ControllerComparison:
    """Fly laws through the same set points, on the same craft with the same noise.

    Parameters
    ----------
    model : Model
        The controllers' model.
    laws : sequence of str, subclass of Law or object of it, default ("lqr", "mpc")
        Laws, as for `track`; the others are compared with the first.
    truth : Model, optional
        The true craft; by default the model.
    flights : int, default 10
        Flights of each law.
    spread : float, default 0.1
        Relative random spread of the true thrusts, inertia and lag between flights.
    seed : int, default 0
        Seed of the first flight's craft, noise and radio; later flights count up from it.
    set_points : SetPoints, optional
        By default the paper's.
    dwell : float, optional
        Time at the last set point [s]; see `tracking_study`.
    settings : TwinSettings, optional
        Table, sensors, radio, faults; by default the paper's.
    tuning : Tuning, optional
        Tuning of the controllers; by default the one for the model.

    Returns
    -------
    ControllerComparison
        Settling times, overshoots, errors and effort, with intervals of their differences.

    Raises
    ------
    InputError
        If there is no law, a law is unknown, a number is out of range, or a set point is beyond the
        rails.

    Examples
    --------
    >>> points = airpuck.SetPoints([0.0, 0.2], [(0.0, 0.0, 0.0), (0.3, 0.1, 0.0)])
    >>> found = airpuck.compare_controllers(model, flights=2, set_points=points)
    >>> found.figures["settling_time_s"].shape
    (2, 2)
    """
    numbers.CHECK_FLIGHTS.check(flights, "flights")
    numbers.CRAFT_SPREAD.check(spread, "spread")
    if not laws:
        raise InputError("must name at least one law", field="laws")
    flown = [
        tracking_study(
            [model],
            varied(truth or model, spread, seed + number),
            set_points=set_points,
            dwell=dwell,
            seed=seed + number,
            controller="full",
            laws=laws,
            settings=settings,
            tuning=tuning,
        )
        for number in range(flights)
    ]
    rows = [[one.figures() for one in flight] for flight in flown]
    figures = {k: np.array([[one[k] for one in flight] for flight in rows]).T for k in rows[0][0]}
    # A mean over the points where a law settled would favour a law that settles only at easy ones.
    figures["settling_time_s"][figures["not_settled"] > 0] = np.nan
    names = numbered([law if isinstance(law, str) else law_label(law) for law in laws])
    return ControllerComparison(tuple(names), figures)
