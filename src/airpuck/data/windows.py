"""Windows: short stretches of trajectories to encode on and to predict over."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from airpuck.boundary.errors import InputError
from airpuck.data.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows over one or several trajectories, kept as indices into the joined samples.

    A window has E samples for the encoder and then T samples to predict. Its *present* is the last
    encoder sample: the prediction starts there, and step k ends at the k-th sample after it.

    Attributes
    ----------
    time : array, shape (N,)
        Sample times of all trajectories, joined [s].
    state : array, shape (N, 6)
        Measured states, joined.
    input : array, shape (N, n)
        Held commands, joined.
    starts : array of int, shape (W,)
        First sample of each window; no window reaches from one trajectory into the next.
    encoder_length, prediction_length : int
        E and T, in samples.
    origins : tuple of int
        First sample of each trajectory.
    trajectories : tuple of Trajectory
        What was joined.
    input_slope : array, shape (N, n), or None
        Derivative of `input` with respect to the transport delay [1/s]; None where commands are
        held by whole samples.
    """

    time: Float[np.ndarray, " N"]
    state: Float[np.ndarray, "N 6"]
    input: Float[np.ndarray, "N n"]
    starts: Int[np.ndarray, " W"]
    encoder_length: int
    prediction_length: int
    origins: tuple[int, ...] = (0,)
    trajectories: tuple[Trajectory, ...] = ()
    input_slope: Float[np.ndarray, "N n"] | None = None

    def __len__(self) -> int:
        return len(self.starts)

    @property
    def present(self) -> Int[np.ndarray, " W"]:
        """Index of the sample that each prediction starts from."""
        return self.starts + self.encoder_length - 1

    def delayed(self, delay: float, assumed: float) -> Windows:
        """Hold the commands anew, for a transport delay to a fraction of a sample.

        Parameters
        ----------
        delay : float
            From a command's stamp to the motors [s].
        assumed : float
            The delay in trajectories whose commands somebody else has shifted [s]; see
            `Trajectory.delayed_input`.

        Returns
        -------
        Windows
            The same windows, with other inputs and their slope.
        """
        held = [trajectory.delayed_input(delay, assumed) for trajectory in self.trajectories]
        return replace(
            self,
            input=np.concatenate([values for values, _ in held]),
            input_slope=np.concatenate([slope for _, slope in held]),
        )

    def past(self, starts: Int[np.ndarray, " B"] | None = None, length: int | None = None) -> Past:
        """Gather what an encoder may look at.

        Parameters
        ----------
        starts : array of int, shape (B,), optional
            First samples of some windows; by default all.
        length : int, optional
            Samples up to the present, by default E. More of them begin before the window does.

        Returns
        -------
        Past
            The samples.
        """
        starts = self.starts if starts is None else starts
        length = length or self.encoder_length
        first = starts + self.encoder_length - length
        return gather_past(np, self.time, self.state, self.input, first, length)

    def future(
        self, starts: Int[np.ndarray, " B"] | None = None
    ) -> tuple[Float[np.ndarray, "T n B"], Float[np.ndarray, "T B"], Float[np.ndarray, "T 6 B"]]:
        """Gather what happened after the present.

        Parameters
        ----------
        starts : array of int, shape (B,), optional
            First samples of some windows; by default all.

        Returns
        -------
        commands : array, shape (T, n, B)
            The command in force over each step.
        durations : array, shape (T, B)
            Length of each step [s].
        state : array, shape (T, 6, B)
            Measured state at the end of each step.
        """
        starts = self.starts if starts is None else starts
        present = starts + self.encoder_length - 1
        index = present + np.arange(self.prediction_length + 1)[:, None]
        return (
            np.moveaxis(self.input[index[:-1]], -1, 1),
            np.diff(self.time[index], axis=0),
            np.moveaxis(self.state[index[1:]], -1, 1),
        )


@dataclass(frozen=True, eq=False)
class Past:
    """The samples up to and including the present, of a batch of windows.

    Attributes
    ----------
    state : array, shape (E, 6, B)
        Measured states.
    command : array, shape (E, n, B)
        Held commands.
    duration : array, shape (E - 1, B)
        Time from each sample to the next [s].
    """

    state: Any
    command: Any
    duration: Any


def gather_past(xp: Any, time: Any, state: Any, command: Any, starts: Any, length: int) -> Past:
    """Gather the first samples of windows.

    Parameters
    ----------
    xp : module
        Array namespace.
    time : array, shape (N,)
        Sample times [s].
    state : array, shape (N, 6)
        Measured states.
    command : array, shape (N, n)
        Held commands.
    starts : array of int, shape (B,)
        First samples.
    length : int
        Samples to gather, E.

    Returns
    -------
    Past
        The samples, batch last.
    """
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
) -> Windows:
    """Cut trajectories into windows.

    Parameters
    ----------
    trajectories : Trajectory or sequence of Trajectory
        Where to cut; all of one craft.
    encoder_length : int, default 20
        E, in samples.
    prediction_length : int or None, default 50
        T, in samples. None: one window from each trajectory, as long as the shortest of their
        usable stretches allows.
    stride : int, default 1
        Samples from one window's start to the next.

    Returns
    -------
    Windows
        All windows that touch no excluded span.

    Raises
    ------
    InputError
        If a trajectory has not a single window, or the propellers differ.
    """
    if isinstance(trajectories, Trajectory):
        trajectories = [trajectories]
    if prediction_length is None:
        longest = min(_longest_stretch(trajectory) for trajectory in trajectories)
        prediction_length = max(longest - encoder_length, 1)
        stride = max(map(len, trajectories))
    length = encoder_length + prediction_length
    starts, first = [], 0
    for trajectory in trajectories:
        if trajectory.propellers != trajectories[0].propellers:
            raise InputError(
                "has other propellers than the first recording "
                f"({', '.join(trajectory.propellers)}); identify each craft for itself",
                file=trajectory.source,
            )
        own = trajectory.window_starts(length, stride)
        if len(own) == 0:
            raise InputError(
                f"is too short: a window needs {length} samples in a row "
                f"({encoder_length} to encode, {prediction_length} to predict), the longest "
                f"usable stretch has {_longest_stretch(trajectory)}",
                file=trajectory.source,
            )
        starts.append(first + own)
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


def _longest_stretch(trajectory: Trajectory) -> int:
    """Return the length of the longest usable stretch, in samples."""
    return max((last - first for first, last in trajectory.segments), default=0)
