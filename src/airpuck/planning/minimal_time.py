"""A table of shortest times that answers in microseconds, for decisions many times a second."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from platformdirs import user_cache_path

from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Section, read_packaged, read_toml, write_toml
from airpuck.model.model_file import Model
from airpuck.planning.request import Goal, checked_request
from airpuck.planning.search import TIDY, ranked, search
from airpuck.planning.settings import Limits
from airpuck.planning.transcription import program_for

#: Number of plans to fit the times of another craft, and of further plans to measure the error.
_FITTED, _CHECKED = 8, 6
#: Fewest plans that suffice for the error if others fail.
_FEWEST_CHECKED = 3
#: Error (p95) of the packaged table; players' own reserves already cover it [s].
_USUAL_ERROR = 0.036
#: Weight of the factor's logarithm relative to relative errors of times.
_NEAR_ONE = 0.1
#: Tables in use in this process, by craft.
_KNOWN: dict[str, MinimalTimes] = {}
_FORMAT = "airpuck minimal times 2"
#: Intervals of the plans behind the table: times are within 0.5 % of those on finer grids.
_INTERVALS = 20
#: Number of flights on the coarse grid that are refined.
_REFINED = 3
#: Corners of a cell, as offsets along each axis.
_CORNERS = np.ogrid[:2, :2, :2]
#: Random states: least distance [m] and largest speed [m/s].
_NEAREST, _FASTEST = 0.02, 2.0
#: Figures of an error, as quantiles.
_QUANTILES = {"median": 0.5, "p95": 0.95, "worst": 1.0}
#: Decimals of times and of their errors in a file: 0.01 and 0.1 ms.
_DIGITS, _ERROR_DIGITS = 5, 4
#: Keeps the direction finite for a craft at rest or at its place [m²/s].
_TINY = 1e-12

TerminalCondition = Literal["rest", "any"]
TERMINAL_CONDITIONS: tuple[TerminalCondition, ...] = ("rest", "any")
#: Distance [m], velocity [m/s], yaw [rad].
_State = tuple[float, tuple[float, float], float]


@dataclass(frozen=True, eq=False)
class MinimalTimes:
    """Shortest times from a moving craft to a place, on a table without rails.

    The final yaw is free. Times are averaged over the initial yaw; its effect is part of the error.

    Attributes
    ----------
    source : str
        Description of the model that was planned for.
    craft : str
        Its fingerprint; see `craft_of`.
    distance, speed, direction : array
        Axes: distance to the place [m], speed [m/s], angle between the velocity and the direction
        of the place, from 0 (towards it) to π [rad].
    time : array, shape (2, distances, speeds, directions)
        Shortest times [s]: to rest there, and to pass with any velocity.
    error : mapping of str to float
        Errors of looked-up times against plans from random states: ``median``, ``p95``, ``worst``
        [s].
    """

    source: str
    craft: str
    distance: Float[np.ndarray, " D"]
    speed: Float[np.ndarray, " V"]
    direction: Float[np.ndarray, " A"]
    time: Float[np.ndarray, "2 D V A"]
    error: Mapping[str, float]

    @property
    def margin(self) -> float:
        """Time that players add to their reserve: the excess of the p95 error [s]."""
        return max(0.0, self.error.get("p95", 0.0) - _USUAL_ERROR)

    def __call__(self, away: Any, velocity: Any, arrival: TerminalCondition = "rest") -> Any:
        """Look up shortest times, interpolated in √distance, speed and cosine of the direction.

        Parameters
        ----------
        away : array, shape (2, ...)
            Distance from the craft to the place [m].
        velocity : array, shape (2, ...)
            Speed of the craft [m/s].
        arrival : {"rest", "any"}, default "rest"
            Whether the craft rests there or passes.

        Returns
        -------
        array
            Times [s]; beyond the table, extrapolated from its last cell.
        """
        away, velocity = np.asarray(away, dtype=float), np.asarray(velocity, dtype=float)
        distance, speed = np.hypot(*away), np.hypot(*velocity)
        # Times are even functions of the direction and flat at 0 and π, like a cosine.
        both = np.maximum(distance * speed, _TINY)
        cosine = (away[0] * velocity[0] + away[1] * velocity[1]) / both
        value = self.time[TERMINAL_CONDITIONS.index(arrival)]
        places = (
            _place(np.sqrt(self.distance), np.sqrt(distance)),
            _place(self.speed, speed),
            _place(-np.cos(self.direction), -cosine),
        )
        lows, shares = zip(*places, strict=True)
        # Interpolate between the corners of the cell, axis by axis.
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
            "craft": self.craft,
            "distance_m": self.distance.tolist(),
            "speed_m_s": self.speed.tolist(),
            "direction_rad": self.direction.tolist(),
            "time_s": np.round(self.time, _DIGITS).tolist(),
            "error_s": dict(self.error),
        }
        write_toml(path, content, header="Shortest times of airpuck plans.")


class _File(Section):
    format: Literal["airpuck minimal times 2"]
    source: str
    craft: str
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
        A file; by default the packaged table of the paper's craft.

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
    shape = (len(TERMINAL_CONDITIONS), *map(len, axes))
    flat = [t for kind in content.time_s for rows in kind for row in rows for t in row]
    if len(flat) != np.prod(shape) or min(shape) < 2 or any((np.diff(a) <= 0).any() for a in axes):
        raise InputError("does not fit its axes, which must rise", file=path, field="time_s")
    times = np.array(flat).reshape(shape)
    return MinimalTimes(
        content.source, content.craft, distance, speed, direction, times, content.error_s
    )


def craft_of(model: Model) -> str:
    """Return a fingerprint of everything that shortest times depend on."""
    vehicle, parameters = model.vehicle, model.parameters
    told = {
        "propellers": [(*p.position_m, p.direction_deg) for p in vehicle.propellers],
        "mass_kg": vehicle.mass_kg,
        "commands": (vehicle.command_min, vehicle.command_max),
        "frame": model.frame,
        "parameters": {
            q.name: np.ravel(getattr(parameters, q.name)).tolist()
            for q in parameters.quantities
            if q.name != "transport_delay"
        },
    }
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:16]


def minimal_times_of(
    model: Model, progress: Callable[[int, int], None] = lambda done, of: None
) -> MinimalTimes:
    """Return the shortest times of a craft: packaged, cached, or planned now.

    The table of another craft is the packaged one, scaled to fit some plans for that craft; further
    plans measure its error. Such tables are stored in the user's cache.

    Parameters
    ----------
    model : Model
        The craft.
    progress : callable, optional
        Called with the number of plans made and the total, if any must be made.

    Returns
    -------
    MinimalTimes
        Shortest times of this craft.
    """
    craft = craft_of(model)
    if craft not in _KNOWN:
        packaged = read_minimal_times()
        own = packaged.craft == craft
        _KNOWN[craft] = packaged if own else _remembered(model, craft, packaged, progress)
    return _KNOWN[craft]


def _remembered(
    model: Model, craft: str, packaged: MinimalTimes, progress: Callable[[int, int], None]
) -> MinimalTimes:
    """Read a craft's times from the user's cache, or plan and store them."""
    file = user_cache_path("airpuck", appauthor=False) / "minimal_times" / f"{craft}.toml"
    try:
        found = read_minimal_times(file)
        if found.craft == craft:
            return found
    except InputError:
        pass  # not cached, or from another version
    found = scaled(packaged, model, progress)
    # Continue without a cache if it cannot be written.
    with contextlib.suppress(OSError, InputError):
        file.parent.mkdir(parents=True, exist_ok=True)
        found.save(file)
    return found


def scaled(times: MinimalTimes, model: Model, progress: Callable[[int, int], None]) -> MinimalTimes:
    """Scale times to fit plans for another craft, and measure the remaining error.

    Suppose that a craft has s times the accelerations, and that all of its times, including motor
    lag and turns, are c times as long. Then T(d, v) = c T₀(d / s c², v / s c) holds exactly. For
    other craft, s, c and a factor are fitted. Plans, and therefore the error, end at rest, as
    players require; times to pass are scaled in the same way.
    """
    from scipy.optimize import least_squares  # takes half a second to import

    states, planned = _planned(model, times, progress)

    def stretched(logs: Float[np.ndarray, " 3"]) -> MinimalTimes:
        s, c, factor = np.exp(logs)
        return replace(
            times,
            distance=times.distance * s * c**2,
            speed=times.speed * s * c,
            time=times.time * c * factor,
        )

    def looked_up(table: MinimalTimes) -> Float[np.ndarray, " K"]:
        return np.array([float(table((d, 0.0), v)) for d, v, _ in states])

    def missed(logs: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " K"]:
        shares = np.log(looked_up(stretched(logs)) / planned)[:_FITTED]
        # A few plans cannot separate c from the factor, so a prior keeps the factor near 1.
        return np.append(shares, _NEAR_ONE * logs[2])

    found = stretched(least_squares(missed, np.zeros(3)).x)
    away = np.abs(looked_up(found) - planned)[_FITTED:]
    error = dict(zip(_QUANTILES, np.quantile(away, list(_QUANTILES.values())), strict=True))
    return replace(
        found,
        source=f"{model.vehicle.name}, {model.name}: scaled from {times.source}",
        craft=craft_of(model),
        error={name: round(float(value), _ERROR_DIGITS) for name, value in error.items()},
    )


def _planned(
    model: Model, times: MinimalTimes, progress: Callable[[int, int], None]
) -> tuple[list[_State], Float[np.ndarray, " K"]]:
    """Plan from random states; return the states that have a plan, and the planned times.

    Raises
    ------
    InputError
        If too few states have a plan.
    """
    drawn = _random_states(_FITTED + _CHECKED, times)
    states, planned = [], []
    for number, (distance, velocity, yaw) in enumerate(drawn):
        try:
            planned.append(shortest_time(model, distance, velocity, yaw, "rest"))
            states.append(drawn[number])
        except InputError as error:
            if len(drawn) - 1 - number + len(planned) < _FITTED + _FEWEST_CHECKED:
                raise InputError(
                    f"this craft's shortest times cannot be planned: {error.problem}", field="model"
                ) from error
        progress(number + 1, len(drawn))
    return states, np.array(planned)


def _random_states(count: int, times: MinimalTimes) -> list[_State]:
    """Draw states, the same for every craft."""
    random, drawn = np.random.default_rng(1), []
    for _ in range(count):
        distance = random.uniform(_NEAREST, times.distance[-1] / 2)
        speed = random.uniform(0, _FASTEST)
        angle, yaw = random.uniform(0, np.pi), random.uniform(-np.pi, np.pi)
        velocity = float(speed * np.cos(angle)), float(speed * np.sin(angle))
        drawn.append((float(distance), velocity, float(yaw)))
    return drawn


def shortest_time(
    model: Model, distance: float, velocity: Sequence[float], yaw: float, arrival: TerminalCondition
) -> float:
    """Plan the shortest time to a place ahead, along x; without a certificate [s]."""
    if distance == 0 and (arrival == "any" or not np.any(velocity)):
        return 0.0
    goal = Goal(distance, 0.0, None, (0.0, 0.0, 0.0) if arrival == "rest" else None)
    request = checked_request(
        model, [0.0, 0.0, yaw, velocity[0], velocity[1], 0.0], goal, (), None, (), Limits()
    )
    program = program_for(model, _INTERVALS, 1, 0)
    # The order on the coarse grid is not always that on the finer one.
    solved = [
        program.solve(request, one.path.resampled(_INTERVALS, model), one.yaw, TIDY)
        for one in ranked(request)[0][:_REFINED]
    ]
    times = [one.time for one in solved if one.converged]
    return min(times) if times else search(request, 2 * _INTERVALS)[0].time


def _place(axis: Float[np.ndarray, " k"], value: Any) -> tuple[Any, Any]:
    """Return the index of the entry below a value, and the fraction of the interval above it."""
    low = axis[1:-1].searchsorted(value, side="right")
    begin = axis[low]
    share = (value - begin) / (axis[low + 1] - begin)
    return low, np.maximum(share, 0.0)
