"""Windows: short stretches of trajectories, for encoding a state and predicting from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory, as_trajectories

#: Longest integration step between poses [s], as long as there are at most this many, and a longer
#: one for poses further apart. The command of a step is its mean over the step h, which spreads a
#: switch by h²/6 on average: a lag of 28 ms is found h²/(12 τ) too short, 0.6 ms at 70 Hz.
_FINE, _FEW, _COARSE = 0.0055, 4, 0.02


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows over one or several trajectories, as indices into the joined samples.

    A window has E samples for the encoder and then T samples to predict. Its *present* is the last
    encoder sample: the prediction starts there, and step k ends at the k-th sample after it.
    """

    #: Sample times of all trajectories, joined [s].
    time: Float[np.ndarray, " N"]
    #: Measured states, joined.
    state: Float[np.ndarray, "N 6"]
    #: Held commands, joined.
    input: Float[np.ndarray, "N n"]
    #: First sample of each window; no window reaches from one trajectory into the next.
    starts: Int[np.ndarray, " W"]
    #: E and T, in samples.
    encoder_length: int
    prediction_length: int
    #: First sample of each trajectory.
    origins: tuple[int, ...] = (0,)
    #: The trajectories that were joined.
    trajectories: tuple[Trajectory, ...] = ()
    #: Derivative of `input` with respect to the transport delay [1/s]; None if commands are held by
    #: whole samples.
    input_slope: Float[np.ndarray, "N n"] | None = None
    #: Integration steps from one pose to the next; only the last of them ends at a pose.
    parts: int = 1

    @cached_property
    def measured(self) -> Bool[np.ndarray, " N"]:
        """Where there is a measured pose: neither a lost frame nor a step between two poses."""
        return np.concatenate([trajectory.measured for trajectory in self.trajectories])

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def present(self) -> Int[np.ndarray, " W"]:
        """Index of the sample that each prediction starts from."""
        return self.starts + self.encoder_length - 1

    @cached_property
    def poses(self) -> Int[np.ndarray, " W"]:
        """Number of measured poses that each window predicts."""
        count = np.concatenate([[0], np.cumsum(self.measured)])
        return count[self.present + 1 + self.prediction_length] - count[self.present + 1]

    def refined(self, parts: int) -> Windows:
        """Return the same windows with every step cut into equal parts."""
        if parts == 1:
            return self
        fine = [refined(trajectory, parts) for trajectory in self.trajectories]
        owner = np.searchsorted(self.origins, self.starts, side="right") - 1
        origins = np.cumsum([0, *map(len, fine[:-1])])
        first = np.array(self.origins)[owner]
        return replace(
            self,
            time=np.concatenate([one.time for one in fine]),
            state=np.concatenate([one.state for one in fine]),
            input=np.concatenate([one.input for one in fine]),
            starts=origins[owner] + parts * (self.starts - first),
            encoder_length=parts * (self.encoder_length - 1) + 1,
            prediction_length=parts * self.prediction_length,
            origins=tuple(origins.tolist()),
            trajectories=tuple(fine),
            parts=parts,
        )

    def delayed(self, delay: float, assumed: float) -> Windows:
        """Return the same windows with commands held for another transport delay [s].

        The delay need not be a whole number of samples; see `Trajectory.delayed_input`.
        """
        held = [trajectory.delayed_input(delay, assumed) for trajectory in self.trajectories]
        return replace(
            self,
            input=np.concatenate([values for values, _ in held]),
            input_slope=np.concatenate([slope for _, slope in held]),
        )

    def past(self, starts: Int[np.ndarray, " B"] | None = None, length: int | None = None) -> Past:
        """Gather the samples that an encoder may use, with B windows as last axis."""
        starts = self.starts if starts is None else starts
        length = length or self.encoder_length
        first = starts + self.encoder_length - length
        past = gather_past(np, self.time, self.state, self.input, first, length)
        return replace(past, measured=self.measured[first + np.arange(length)[:, None]])

    def future(
        self, starts: Int[np.ndarray, " B"] | None = None
    ) -> tuple[Float[np.ndarray, "T n B"], Float[np.ndarray, "T B"], Float[np.ndarray, "T 6 B"]]:
        """Gather commands, durations and measured states after the present."""
        starts = self.starts if starts is None else starts
        index = starts + self.encoder_length - 1 + np.arange(self.prediction_length + 1)[:, None]
        return (
            np.moveaxis(self.input[index[:-1]], -1, 1),
            np.diff(self.time[index], axis=0),
            np.moveaxis(self.state[index[1:]], -1, 1),
        )


@dataclass(frozen=True, eq=False)
class Past:
    """The samples up to and including the present, of a batch of B windows as last axis."""

    #: Measured states, shape (E, 6, B).
    state: Any
    #: Held commands, shape (E, n, B).
    command: Any
    #: Time from each sample to the next, shape (E - 1, B) [s].
    duration: Any
    #: Where poses were measured, shape (E, B); None: everywhere.
    measured: Any = None


def gather_past(xp: Any, time: Any, state: Any, command: Any, starts: Any, length: int) -> Past:
    """Gather `length` samples of each window from its start on; under NumPy or JAX."""
    index = starts + xp.arange(length)[:, None]
    return Past(
        state=xp.moveaxis(state[index], -1, 1),
        command=xp.moveaxis(command[index], -1, 1),
        duration=xp.diff(time[index], axis=0),
    )


def make_windows(
    trajectories: Trajectory | Sequence[Trajectory],
    encoder_length: int = 20,
    prediction_length: int | None = 50,
    stride: int = 1,
    judged: int | None = None,
) -> Windows:
    """Cut trajectories into windows.

    Parameters
    ----------
    trajectories : Trajectory or sequence of Trajectory
        Trajectories of one craft.
    encoder_length : int, default 20
        E, in samples.
    prediction_length : int or None, default 50
        T, in samples. None: one window from each trajectory, as long as the shortest of their
        longest usable stretches.
    stride : int, default 1
        Samples from one window's start to the next.
    judged : int, optional
        Step of the prediction whose pose must have been measured.

    Returns
    -------
    Windows
        All windows that touch no excluded span, and whose velocity is known at the present.

    Raises
    ------
    InputError
        If a trajectory has no window at all, or the propellers differ.
    """
    trajectories = as_trajectories(trajectories)
    if prediction_length is None:
        longest = min(_longest_stretch(trajectory) for trajectory in trajectories)
        prediction_length = max(longest - encoder_length, 1)
        stride = max(map(len, trajectories))
    length = encoder_length + prediction_length
    starts, first = [], 0
    for trajectory in trajectories:
        if trajectory.propellers != trajectories[0].propellers:
            raise InputError(
                "has different propellers from the first recording "
                f"({', '.join(trajectory.propellers)}); identify each craft separately",
                file=trajectory.source,
            )
        allowed = np.roll(trajectory.determined, 1 - encoder_length)
        if judged is not None:
            allowed = allowed & np.roll(trajectory.measured, 1 - encoder_length - judged)
        found = trajectory.window_starts(length, stride, allowed)
        if len(found) == 0:
            raise InputError(
                f"is too short: a window needs {length} samples in a row "
                f"({encoder_length} to encode, {prediction_length} to predict); the longest "
                f"usable stretch has {_longest_stretch(trajectory)}",
                file=trajectory.source,
            )
        starts.append(first + found)
        first += len(trajectory)
    return Windows(
        time=np.concatenate([trajectory.time for trajectory in trajectories]),
        state=np.concatenate([trajectory.state for trajectory in trajectories]),
        input=np.concatenate([trajectory.input for trajectory in trajectories]),
        starts=np.concatenate(starts),
        encoder_length=encoder_length,
        prediction_length=prediction_length,
        origins=tuple(np.cumsum([0, *map(len, trajectories[:-1])]).tolist()),
        trajectories=tuple(trajectories),
    )


def integration_parts(trajectory: Trajectory) -> int:
    """Return the number of integration steps from one pose to the next: one from 182 Hz on."""
    period = trajectory.sample_period
    return max(min(math.ceil(period / _FINE), _FEW), round(period / _COARSE))


def refined(trajectory: Trajectory, parts: int) -> Trajectory:
    """Cut every step of a trajectory into equal parts.

    States between the poses are interpolated: they are only for integrating between poses.
    """
    if parts == 1:
        return trajectory
    count = len(trajectory)
    number = np.arange((count - 1) * parts + 1) / parts

    def at(values: Float[np.ndarray, "N *k"]) -> Float[np.ndarray, "M *k"]:
        columns = values.reshape(count, -1).T
        between = [np.interp(number, np.arange(count), column) for column in columns]
        return np.stack(between, axis=-1).reshape(len(number), *values.shape[1:])

    times, states = at(trajectory.time), at(trajectory.state)
    measured = np.zeros(len(number), dtype=bool)
    measured[::parts] = trajectory.measured
    return replace(
        trajectory,
        time=times,
        state=states,
        acceleration=at(trajectory.acceleration),
        lost=times[~measured],
    )


def _longest_stretch(trajectory: Trajectory) -> int:
    """Return the length of the longest usable stretch, in samples."""
    return max((last - first for first, last in trajectory.segments), default=0)
