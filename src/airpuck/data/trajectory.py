"""A trajectory: states at the sample times, commands at their own times, and excluded spans."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.arguments import numbers_of
from airpuck.boundary.errors import InputError, about
from airpuck.boundary.numbers import check_finite
from airpuck.boundary.outputs import replacing
from airpuck.boundary.results import html_table
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.data.sampling import bridged, hold, mean_hold, runs, spaced, usual_period

#: Format of the file; others are rejected.
FORMAT = "airpuck trajectory 1"
#: Arrays in a file besides the times, ``t``.
_SAVED = ("state", "input", "acceleration", "command_time", "command", "lost")

#: A command may lie outside [0, 1] by rounding.
_ROUNDING = 1e-9
#: Time beside a longer pause in which smoothing is one-sided, so that velocities are noisy [s].
_ONE_SIDED = 5.5 / 240


@dataclass(frozen=True)
class Span:
    """A closed interval of time that must not be used.

    The interval of a gap includes the samples on both sides, so that no window reaches across.

    Attributes
    ----------
    start, stop : float
        First and last time concerned [s].
    cause : str
        The reason, in a few words: ``gap``, ``frozen pose``, ….
    confidence : float, default 1
        Probability of the cause; 1 if it was measured.

    Examples
    --------
    >>> hit = airpuck.Span(1.0, 1.2, "somebody pushed it")
    >>> trajectory.leave_out([hit]).excluded[-1].cause
    'somebody pushed it'
    """

    start: float
    stop: float
    cause: str
    confidence: float = 1.0

    def __post_init__(self) -> None:
        check_finite(start=self.start, stop=self.stop, confidence=self.confidence)
        if self.stop < self.start:
            problem = f"must not be before the start, {self.start:g} s, but is {self.stop:g} s"
            raise InputError(problem, field="stop")
        if not 0 <= self.confidence <= 1:
            raise InputError("must be from 0 to 1", field="confidence")

    @property
    def certainty(self) -> str:
        """The confidence in words, which never rounds a probability to certainty."""
        return "measured" if self.confidence == 1 else f"{min(self.confidence, 0.99):.2f}"


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory:
    """States at the times of the motion capture, and commands at the times they were sent.

    Attributes
    ----------
    time : array of float64, shape (N,)
        Sample times, strictly increasing [s].
    state : array of float64, shape (N, 6)
        x, y [m], yaw γ (continuous, not wrapped) [rad], their rates [m/s, m/s, rad/s].
    acceleration : array of float64, shape (N, 3)
        Smoothed second derivatives of x, y, γ [m/s², m/s², rad/s²].
    command_time : array of float64, shape (K,)
        Time stamp of each command, on the same axis as `time`, not decreasing [s].
    command : array of float64, shape (K, n)
        Motor commands in [0, 1], one column for each propeller.
    delay : float
        Transport delay: a command acts from ``command_time + delay`` on [s].
    delay_known : bool
        False if the file's author had already shifted the commands by an unknown delay; `delay` is
        then zero.
    propellers : tuple of str
        Names of the command's columns.
    excluded : tuple of Span
        Intervals that no window may touch.
    source : str
        The file or folder it came from.
    hashes : mapping of str to str
        SHA-256 of every source file, by name.
    warnings : tuple of str
        Problems found by preprocessing that do not prevent the use of the data.
    vehicle : Vehicle or None
        The craft that it was preprocessed for; None if it was prepared elsewhere.
    lost : array of float64, shape (L,)
        Times of the samples whose frames the cameras lost [s]. The state is interpolated there and
        counts nowhere as a measurement.

    Examples
    --------
    >>> isinstance(trajectory, airpuck.Trajectory)
    True
    >>> trajectory.state.shape[1], trajectory.input.shape[1]
    (6, 6)
    >>> early, late = trajectory.slice(0.0, 0.6), trajectory.slice(0.6, 1.0)
    >>> bool(early.time[-1] <= late.time[0])
    True
    """

    time: Float[np.ndarray, " N"]
    state: Float[np.ndarray, "N 6"]
    acceleration: Float[np.ndarray, "N 3"]
    command_time: Float[np.ndarray, " K"]
    command: Float[np.ndarray, "K n"]
    propellers: tuple[str, ...]
    delay: float = 0.0
    delay_known: bool = True
    excluded: tuple[Span, ...] = ()
    source: str = ""
    hashes: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    vehicle: Vehicle | None = None
    lost: Float[np.ndarray, " L"] = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        samples, commands = np.size(self.time), np.size(self.command_time)
        shapes = {
            "time": (None,),
            "state": (samples, 6),
            "acceleration": (samples, 3),
            "command_time": (None,),
            "command": (commands, np.size(self.propellers)),
            "lost": (None,),
        }
        with about(self.source):
            for name, kind in {"propellers": str, "excluded": Span}.items():
                given = getattr(self, name)
                if not (isinstance(given, tuple) and all(isinstance(one, kind) for one in given)):
                    raise InputError(f"must be a tuple of {kind.__name__}", field=name)
            for name, shape in shapes.items():
                numbers_of(getattr(self, name), shape, name)
            check_finite(delay=self.delay)
            for name, least in {"time": 2, "command_time": 1}.items():
                if np.size(getattr(self, name)) < least:
                    raise InputError(f"must have {least} entries or more", field=name)
            if (np.diff(self.time) <= 0).any():
                raise InputError("must increase", field="time")
            if (np.diff(self.command_time) < 0).any():
                raise InputError("must not decrease", field="command_time")
            if (np.abs(np.asarray(self.command) - 0.5) > 0.5 + _ROUNDING).any():
                raise InputError("must be in [0, 1]", field="command")

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        return (
            f"Trajectory({self.source!r}, {len(self)} samples in {self.duration:.1f} s, "
            f"{len(self.propellers)} motors, {len(self.excluded)} spans excluded)"
        )

    def _repr_html_(self) -> str:
        rows = [
            ("source", self.source),
            ("samples", len(self)),
            ("duration [s]", self.duration),
            ("samples per second", 1 / self.sample_period),
            ("motors", ", ".join(self.propellers)),
            ("transport delay [ms]", 1e3 * self.delay if self.delay_known else "not known"),
            *((f"not used: {s.start:.2f} to {s.stop:.2f} s", s.cause) for s in self.excluded),
            *(("warning", warning) for warning in self.warnings),
        ]
        return html_table("Trajectory", ("", ""), rows)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def sample_period(self) -> float:
        """Usual time between samples [s]."""
        return usual_period(self.time)

    def steps(self, duration: float, least: int = 1) -> int:
        """Return a duration as a number of samples.

        Parameters
        ----------
        duration : float
            Duration [s].
        least : int, default 1
            Smallest number to return. An encoder needs two: commands act between samples.

        Returns
        -------
        int
            Rounded to the nearest sample, and at least `least`.
        """
        check_finite(duration=duration)
        return max(round(duration / self.sample_period), least)

    @cached_property
    def input(self) -> Float[np.ndarray, "N n"]:
        """The command in force at each sample: zero-order hold of the delayed command events."""
        return hold(self.command_time + self.delay, self.command, self.time)

    def acting_delay(self, delay: float, assumed: float) -> float:
        """Return how long after its time in this trajectory a command acts.

        Parameters
        ----------
        delay : float
            Transport delay d, from a command's stamp to the motors [s].
        assumed : float
            Delay by which the file's author is assumed to have shifted the commands if it is
            unknown: the vehicle's nominal delay [s].

        Returns
        -------
        float
            Time to add to `command_time` [s].
        """
        return delay if self.delay_known else self.delay + delay - assumed

    def delayed_input(
        self, delay: float, assumed: float
    ) -> tuple[Float[np.ndarray, "N n"], Float[np.ndarray, "N n"]]:
        """Return the mean command over each step for another delay, to a fraction of a sample.

        Parameters
        ----------
        delay, assumed : float
            See `acting_delay` [s].

        Returns
        -------
        input : array, shape (N, n)
            ``u_k(d)``; see `mean_hold`.
        slope : array, shape (N, n)
            ``du_k/dd`` [1/s].
        """
        shift = self.acting_delay(delay, assumed)
        return mean_hold(self.command_time + shift, self.command, self.time)

    @cached_property
    def usable(self) -> np.ndarray:
        """Shape (N,): False at every sample inside an excluded span."""
        usable = np.ones(len(self), dtype=bool)
        for span in self.excluded:
            first = np.searchsorted(self.time, span.start)
            usable[first : np.searchsorted(self.time, span.stop, side="right")] = False
        return usable

    @cached_property
    def measured(self) -> np.ndarray:
        """Shape (N,): False at samples whose frames were lost."""
        return ~np.isin(self.time, self.lost)

    @cached_property
    def usable_share(self) -> float:
        """Fraction of the time outside excluded spans."""
        first, last = self.time[[0, -1]].tolist()
        lost, reached = 0.0, first
        for span in sorted(self.excluded, key=lambda span: span.start):
            stop = min(span.stop, last)
            lost += max(stop - max(span.start, reached), 0.0)
            reached = max(reached, stop)
        return 1 - lost / (last - first)

    @cached_property
    def determined(self) -> np.ndarray:
        """Shape (N,): False where too many lost frames make velocities noisy or unknown."""
        determined = bridged(self.time, self.measured)
        for first, last in runs(~determined):
            begin, end = self.time[[first, last - 1]] + np.array([-_ONE_SIDED, _ONE_SIDED])
            determined[slice(*np.searchsorted(self.time, [begin, end]))] = False
        return determined

    @cached_property
    def bridged(self) -> np.ndarray:
        """Shape (N,): False at lost frames in pauses too long for smoothing to bridge."""
        return bridged(self.time, self.measured)

    @cached_property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """Index ranges [first, last) of consecutive usable samples."""
        return tuple(runs(self.usable))

    def window_starts(
        self, length: int, stride: int = 1, allowed: Bool[np.ndarray, " N"] | None = None
    ) -> Int[np.ndarray, " windows"]:
        """Return where windows of `length` samples can begin.

        Parameters
        ----------
        length : int
            Samples in a window.
        stride : int, default 1
            Samples from one start to the next; the count restarts after every excluded span.
        allowed : array of bool, shape (N,), optional
            Where windows may begin; a start that is not allowed moves to the next that is.

        Returns
        -------
        array of int, shape (windows,)
            Indices of first samples; no window touches an excluded span.

        Raises
        ------
        InputError
            If the length or the stride is below 1.
        """
        for name, count in {"length": length, "stride": stride}.items():
            if count < 1:
                raise InputError(f"must be at least 1, not {count}", field=name)
        starts = [
            np.arange(first, last - length + 1, stride)
            if allowed is None or allowed[first : last - length + 1].all()
            else spaced(first + np.flatnonzero(allowed[first : last - length + 1]), stride)
            for first, last in self.segments
            if last - first >= length
        ]
        return np.concatenate(starts) if starts else np.zeros(0, dtype=int)

    def slice(self, start: float, stop: float) -> Trajectory:
        """Return the part between two fractions of its length.

        Parameters
        ----------
        start, stop : float
            Fractions of the number of samples, 0 <= start < stop <= 1.

        Returns
        -------
        Trajectory
            The samples in between, on the same time axis. All commands are kept: the first samples
            need the ones sent before them.

        Raises
        ------
        InputError
            If the fractions are out of order or leave fewer than two samples.
        """
        if not 0 <= start < stop <= 1:
            raise InputError(
                f"{start:g} {stop:g} is not part of a recording; use two fractions of its length, "
                "0 <= A < B <= 1",
                field="span",
            )
        first, last = round(start * len(self)), round(stop * len(self))
        if last - first < 2:
            raise InputError(f"{start:g} {stop:g} leaves fewer than two samples", field="span")
        return replace(
            self,
            time=self.time[first:last],
            state=self.state[first:last],
            acceleration=self.acceleration[first:last],
        )

    def leave_out(self, spans: Sequence[Span]) -> Trajectory:
        """Exclude spans in addition to those already excluded.

        Parameters
        ----------
        spans : sequence of Span
            For example from `airpuck.find_faults`, on the same time axis.

        Returns
        -------
        Trajectory
            The same samples; no window touches a span.
        """
        spans = tuple(spans)
        if not all(isinstance(span, Span) for span in spans):
            raise InputError("must be a sequence of Span", field="spans")
        excluded = sorted({*self.excluded, *spans}, key=lambda span: (span.start, span.stop))
        same = tuple(excluded) == self.excluded  # what is known of this object then stays known
        return self if same else replace(self, excluded=tuple(excluded))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the trajectory as a NumPy archive.

        Parameters
        ----------
        path : path-like
            The .npz file to write. It holds ``t`` [s], ``state`` (N, 6), ``input`` (N, n) (the
            delayed, held command at each sample), ``acceleration`` (N, 3), ``command_time`` [s],
            ``command`` (K, n), ``lost`` (L,) [s] and, as JSON in ``about``, everything else.
        """
        about = {
            "format": FORMAT,
            "delay_s": self.delay,
            "delay_known": self.delay_known,
            "propellers": self.propellers,
            "excluded": [asdict(span) for span in self.excluded],
            "source": self.source,
            "hashes": dict(self.hashes),
            "warnings": self.warnings,
            "vehicle": self.vehicle and self.vehicle.model_dump(mode="json"),
        }
        with replacing(path) as temporary, temporary.open("wb") as file:
            arrays = {name: getattr(self, name) for name in _SAVED}
            np.savez_compressed(file, t=self.time, **arrays, about=np.array(json.dumps(about)))


def as_trajectories(given: Any) -> list[Trajectory]:
    """Return one or several trajectories as a list; for a path or recording, explain what to do."""
    several = isinstance(given, Iterable) and not isinstance(given, str)
    listed: list[Any] = list(given) if several else [given]
    for one in listed:
        if not isinstance(one, Trajectory):
            raise InputError(
                f"is a {type(one).__name__}, not a Trajectory: airpuck.load_trajectory(path) makes "
                "one, or airpuck.preprocess(recording)",
                field="trajectory",
            )
    return listed


def vehicle_of(trajectories: Sequence[Trajectory]) -> Vehicle:
    """Return the craft that trajectories were preprocessed for; by default the paper's.

    Trajectories of different craft raise InputError.
    """
    found, source = None, ""
    for trajectory in trajectories:
        vehicle = trajectory.vehicle
        if vehicle is not None and found is not None and vehicle != found:
            raise InputError(
                f"was preprocessed for the vehicle {vehicle.name!r}, {source} for {found.name!r} "
                "with other values; pass the vehicle that applies to all",
                file=trajectory.source,
                field="vehicle",
            )
        if found is None:
            found, source = vehicle, trajectory.source
    return found or default_vehicle()


def check_propellers(vehicle: Vehicle, trajectory: Trajectory) -> None:
    """Raise InputError if a trajectory's propellers are not the vehicle's."""
    mine, theirs = vehicle.propeller_names, trajectory.propellers
    if mine != theirs:
        raise InputError(
            f"has {len(theirs)} motors ({', '.join(theirs)}), but the vehicle {vehicle.name!r} has "
            f"{len(mine)} ({', '.join(mine)}); use the right vehicle file or model",
            file=trajectory.source,
        )
