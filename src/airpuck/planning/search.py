"""The search for the fastest flight: starts solved on a coarse grid, the best of them refined."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.model.model_file import Model
from airpuck.planning.certificate import unavoidable_rail
from airpuck.planning.request import Request
from airpuck.planning.starts import further_starts, starts
from airpuck.planning.transcription import Path, Solved, Transcription, program_for

#: Intervals of the program that ranks the starts, and the most of a refined leg.
COARSE, _MOST_INTERVALS = 12, 400
#: Commands are held at most so long on the coarse and on the fine grid, which doubles until they
#: are: longer intervals let the spin swing beyond its limit between nodes [s].
_LONGEST_COARSE, _LONGEST_FINE = 0.12, 0.04
#: Paths that may be refined before the search gives up, each on so many grids.
_REFINED, _FINER = 5, 3
#: Coarse times are off by as much [share].
_WORTH = 1.02
#: Weights of the commands' changes [s]: with the larger one all starts converge, some 0.1 % slower;
#: from there most flights converge with the smaller one, too.
TIDY, _FAST = 1e-2, 1e-3
#: Parts of an interval in which a path is simulated again; how far off its end may be (x, y, γ and
#: their rates), how far between nodes it may be beyond what it must not touch [m], and how much
#: faster than its limit it may spin there [share].
_PARTS, _MISSED = 5, np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 2e-2])
_GRAZED, _OVERSPUN = 3e-3, 1e-3


@dataclass(frozen=True)
class Start:
    """A start of the search and what became of it.

    Attributes
    ----------
    name : str
        How the craft turns, or passes, in the first guess.
    time_s : float or None
        The duration that it led to, mostly on a coarse grid; None if it did not converge.
    status : str
        The solver's words.
    """

    name: str
    time_s: float | None
    status: str


@dataclass(frozen=True)
class _Candidate:
    """A path that may be refined: its duration [s], its final yaw [rad]."""

    time: float
    yaw: float
    path: Path


def search(
    request: Request, intervals: int, near: Path | None = None
) -> tuple[Solved, tuple[Start, ...]]:
    """Find the fastest flight from the request's starts, or from a neighbouring path alone.

    Raises
    ------
    InputError
        If no start leads to a flight.
    """
    if near is None:
        candidates, tried = ranked(request)
    else:
        yaw = min(request.goal_yaws(), key=lambda yaw: abs(yaw - near.states[-1, 2]))
        candidates, tried = [_Candidate(0.0, yaw, near)], []
    statuses, best = [start.status for start in tried], None
    for one in candidates[:_REFINED]:
        # Times on the coarse grid are above those on the fine one, unless that led elsewhere.
        if best is not None and one.time >= best.time:
            break
        solved, status = refined(request, one.path, one.yaw, intervals, guessed=one.time == np.inf)
        if solved is None:
            statuses.append(status)
        elif best is None or solved.time < best.time:
            best = solved
    if best is not None:
        near_start = Start("the neighbouring plan", best.time, best.status)
        return best, tuple(tried if near is None else [near_start])
    others = list(further(request, intervals)) if near is None else []
    tried += [begun for begun, _ in others]
    flights = [solved for _, solved in others if solved is not None]
    if flights:
        return min(flights, key=lambda one: one.time), tuple(tried)
    statuses += [begun.status for begun, _ in others]
    axis = unavoidable_rail(request)
    if axis is not None:
        raise InputError(
            f"from this yaw and spin it hits a rail along {axis} whatever it does", field="start"
        )
    words = ", ".join(sorted(set(statuses)))
    raise InputError(
        f"no plan was found from any of {max(len(tried), 1)} starts ({words}); there may be no way "
        "within the limits",
        field="plan",
    )


def ranked(request: Request) -> tuple[list[_Candidate], list[Start]]:
    """Solve all starts on a coarse grid; return paths to refine, the fastest first, and starts."""
    found, guesses, tried = [], [], []
    for name, guess, yaw in starts(request, COARSE):
        one = _coarse(request, guess, yaw)
        tried.append(Start(name, one.time if one.converged else None, one.status))
        if one.converged:
            found.append(_Candidate(one.time, yaw, one.path))
        guesses.append(_Candidate(np.inf, yaw, guess))
    # What the coarse grid lets pass a rail may be no start for the fine one; a guess may be.
    found.sort(key=lambda one: one.time)
    return [*found[: _REFINED - 1], *guesses], tried


def further(
    request: Request, intervals: int, best: float = np.inf
) -> Iterator[tuple[Start, Solved | None]]:
    """Try the further starts, and refine those that may beat the best time [s]; else None."""
    for name, guess, yaw in further_starts(request, COARSE):
        one, solved = _coarse(request, guess, yaw), None
        time, status = one.time if one.converged else None, one.status
        if not one.converged or one.time < _WORTH * best:
            path = one.path if one.converged else guess
            guessed = not one.converged
            solved, status = refined(request, path, yaw, intervals, guessed=guessed)
            time = time if solved is None else solved.time
        yield Start(name, time, status), solved


def refined(
    request: Request, path: Path, yaw: float, intervals: int, *, guessed: bool = False
) -> tuple[Solved | None, str]:
    """Solve on a fine grid, from a flight or a guess; return the solver's words, too.

    Where that flies elsewhere, or spins too fast between nodes, on a finer grid and within a limit
    of spin that is lower by as much.
    """
    flown = None if guessed else request.model
    path, status, tight = _on_grid(path, intervals, _LONGEST_FINE, flown), "", request
    for _ in range(_FINER):
        program = _program(request, path)
        tidy = program.solve(tight, path, yaw, TIDY)
        if not tidy.converged:
            return None, tidy.status
        fast = program.solve(tight, tidy.path, yaw, _FAST)
        for one in (fast, tidy):
            if one.converged and _flies(request, one.path):
                return one, one.status
        status = "misses its goal or its limits between nodes"
        peak = np.abs(_simulated(request, tidy.path)[:, 5]).max()
        if peak > request.limits.spin:
            spin = tight.limits.spin * request.limits.spin / peak
            tight = replace(request, limits=replace(request.limits, spin=spin))
        per_leg = len(path.commands) // len(path.durations)
        path = tidy.path.resampled(min(2 * per_leg, max(per_leg, _MOST_INTERVALS)))
    return None, status


def _coarse(request: Request, guess: Path, yaw: float) -> Solved:
    """Solve on the coarse grid."""
    guess = _on_grid(guess, COARSE, _LONGEST_COARSE)
    return _program(request, guess).solve(request, guess, yaw, TIDY)


def _program(request: Request, path: Path) -> Transcription:
    """Return the program with the grid of a path."""
    legs = len(path.durations)
    return program_for(request.model, len(path.commands) // legs, legs, len(request.keep_out))


def _on_grid(path: Path, intervals: int, longest: float, flown: Model | None = None) -> Path:
    """Resample a path: each leg with so many intervals, doubled while they are too long."""
    while path.durations.max() > longest * intervals and 2 * intervals <= _MOST_INTERVALS:
        intervals *= 2
    return path.resampled(intervals, flown)


def _simulated(request: Request, path: Path) -> Float[np.ndarray, "M s"]:
    """Return states of the flight between the nodes, too."""
    return path.simulated(request.model, path.times, _PARTS)[1]


def _flies(request: Request, path: Path) -> bool:
    """Simulate a path in smaller steps: it must end where it should, and keep what limits it."""
    states = _simulated(request, path)
    if (np.abs(states[-1] - path.states[-1])[:6] > _MISSED).any():
        return False
    if np.abs(states[:, 5]).max() > (1 + _OVERSPUN) * request.limits.spin:
        return False
    place = states[:, :2]
    discs = request.keep_out
    away = np.hypot(*(place[:, None] - discs[:, :2]).transpose(2, 0, 1)) - discs[:, 2]
    inside = (np.abs(place) < np.array(request.reach) + _GRAZED).all()
    return bool(inside and (away > -_GRAZED).all())
