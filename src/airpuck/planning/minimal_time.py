"""The shortest times as a table that answers in microseconds, for decisions many times a second."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Section, read_packaged, read_toml, write_toml
from airpuck.model.model_file import Model
from airpuck.planning.request import Goal, Limits, checked_request
from airpuck.planning.search import TIDY, ranked, search
from airpuck.planning.transcription import program_for

_FORMAT = "airpuck minimal times 1"
#: Intervals of the plans behind the table: within half a percent of finer ones.
_INTERVALS = 20
#: Offsets of the corners of a cell, along each axis.
_CORNERS = np.ogrid[:2, :2, :2]

Arrival = Literal["rest", "any"]
ARRIVALS: tuple[Arrival, ...] = ("rest", "any")


@dataclass(frozen=True, eq=False)
class MinimalTimes:
    """Shortest times from a moving craft to a place, on a table without rails.

    The final yaw is free; the one at the start is averaged over, and part of the error.

    Attributes
    ----------
    source : str
        The model that was planned for.
    distance, speed, direction : array
        Axes: distance to the place [m], speed [m/s], angle between the velocity and the way to the
        place, from 0 (towards it) to π [rad].
    time : array, shape (2, distances, speeds, directions)
        Shortest times [s]: to rest there, and to pass with any velocity.
    error : mapping of str to float
        Of times looked up against plans for random states: ``median``, ``p95``, ``worst`` [s].
    """

    source: str
    distance: Float[np.ndarray, " D"]
    speed: Float[np.ndarray, " V"]
    direction: Float[np.ndarray, " A"]
    time: Float[np.ndarray, "2 D V A"]
    error: Mapping[str, float]

    def __call__(self, away: Any, velocity: Any, arrival: Arrival = "rest") -> Any:
        """Look shortest times up, interpolated in √distance, speed and cosine of the direction.

        Parameters
        ----------
        away : array, shape (2, ...)
            From the craft to the place [m].
        velocity : array, shape (2, ...)
            Of the craft [m/s].
        arrival : {"rest", "any"}, default "rest"
            Whether it is to rest there, or to pass.

        Returns
        -------
        array
            Times [s]; beyond the table's axes those of the nearest entry.
        """
        away, velocity = np.asarray(away, dtype=float), np.asarray(velocity, dtype=float)
        distance, speed = np.hypot(*away), np.hypot(*velocity)
        # Times are even in the direction, and so flat where it is 0 or π, as a cosine is.
        both = np.maximum(distance * speed, 1e-12)
        cosine = (away[0] * velocity[0] + away[1] * velocity[1]) / both
        value = self.time[ARRIVALS.index(arrival)]
        places = (
            _place(np.sqrt(self.distance), np.sqrt(distance)),
            _place(self.speed, speed),
            _place(-np.cos(self.direction), -cosine),
        )
        lows, shares = zip(*places, strict=True)
        # The corners of the cell, as first three axes; then one axis after the other.
        flat = (1,) * both.ndim
        corners = (low + c.reshape(c.shape + flat) for low, c in zip(lows, _CORNERS, strict=True))
        time = value[tuple(corners)]
        for share in shares:
            time = time[0] + share * (time[1] - time[0])
        return time

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the table as TOML.

        Parameters
        ----------
        path : path-like
            The file to write.
        """
        content = {
            "format": _FORMAT,
            "source": self.source,
            "distance_m": self.distance.tolist(),
            "speed_m_s": self.speed.tolist(),
            "direction_rad": self.direction.tolist(),
            "time_s": np.round(self.time, 5).tolist(),
            "error_s": dict(self.error),
        }
        write_toml(path, content, header="Shortest times of airpuck plans.")


class _File(Section):
    format: Literal["airpuck minimal times 1"]
    source: str
    distance_m: tuple[float, ...]
    speed_m_s: tuple[float, ...]
    direction_rad: tuple[float, ...]
    time_s: tuple[tuple[tuple[tuple[float, ...], ...], ...], ...]
    error_s: dict[str, float]


def read_minimal_times(path: str | os.PathLike[str] | None = None) -> MinimalTimes:
    """Read a table of shortest times.

    Parameters
    ----------
    path : path-like, optional
        A file; by default that of the paper's craft, which comes with the package.

    Returns
    -------
    MinimalTimes
        The table.

    Raises
    ------
    InputError
        If the file cannot be read or is damaged.
    """
    content = read_packaged("minimal_times.toml", _File) if path is None else read_toml(path, _File)
    distance, speed = np.array(content.distance_m), np.array(content.speed_m_s)
    direction = np.array(content.direction_rad)
    axes = distance, speed, direction
    shape = (len(ARRIVALS), *map(len, axes))
    flat = [t for kind in content.time_s for rows in kind for row in rows for t in row]
    if len(flat) != np.prod(shape) or min(shape) < 2 or any((np.diff(a) <= 0).any() for a in axes):
        raise InputError("does not fit its axes, which must rise", file=path, field="time_s")
    times = np.array(flat).reshape(shape)
    return MinimalTimes(content.source, distance, speed, direction, times, content.error_s)


def shortest_time(
    model: Model,
    distance: float,
    velocity: Sequence[float],
    yaw: float,
    arrival: Arrival,
) -> float:
    """Plan the shortest time to a place ahead, along x; without certificate [s]."""
    if distance == 0 and (arrival == "any" or not np.any(velocity)):
        return 0.0
    goal = Goal(distance, 0.0, None, (0.0, 0.0, 0.0) if arrival == "rest" else None)
    request = checked_request(
        model, [0.0, 0.0, yaw, velocity[0], velocity[1], 0.0], goal, (), None, (), Limits()
    )
    best = ranked(request)[0][0]
    program = program_for(model, _INTERVALS, 1, 0)
    solved = program.solve(request, best.path.resampled(_INTERVALS), best.yaw, TIDY)
    return solved.time if solved.converged else search(request, 2 * _INTERVALS)[0].time


def _place(axis: Float[np.ndarray, " k"], value: Any) -> tuple[Any, Any]:
    """Return the entry below a value, and the share of the way to the next."""
    low = axis[1:-1].searchsorted(value, side="right")
    begin = axis[low]
    share = (value - begin) / (axis[low + 1] - begin)
    return low, np.minimum(np.maximum(share, 0.0), 1.0)
