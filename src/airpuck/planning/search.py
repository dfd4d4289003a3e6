"""The search for the fastest flight: solve all starts on a coarse grid, refine the best."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.model.model_file import Model
from airpuck.planning.certificate import unavoidable_rail
from airpuck.planning.request import Request
from airpuck.planning.transcription import Path, Solved, Transcription, program_for

#: Names of the starts, and the angle by which the craft turns aside half way [rad].
_ASIDE = {"straight": 0.0, "turned left": 0.5, "turned right": -0.5}
#: The last two are for craft that push one way only: they turn round to brake, then back again.
_FURTHER = {
    "straight, with time to turn round": 0.0,
    "turned far left": 1.2,
    "turned far right": -1.2,
    "turned round to the left": 4.5,
    "turned round to the right": -4.5,
}
#: Starts if the yaw is free: the final turn, and how far the craft turns aside half way [rad]. The
#: first seven cover the full circle. In two the craft first turns the other way, and in two it
#: turns aside and back; each pair leads to flights more than 1 % faster than any other start
#: (`studies/plan_search.py free-yaw`).
_FREE = (
    *((0.0, 0.0), (0.9, 0.0), (-0.9, 0.0), (1.8, 0.0), (-1.8, 0.0), (2.7, 0.0), (-2.7, 0.0)),
    *((1.6, -1.3), (-1.6, 1.3), (0.0, 1.5), (0.0, -1.5)),
)
#: A detour around a disc keeps this fraction of its radius as extra distance.
_ROUND = 1.3
#: Ratio of the guess's peak speed to its mean speed, 1.5, with room for corrections.
_STEEPEST = 1.6
#: Duration of the guess for a leg of length l at acceleration a, in units of √(l/a): rest to rest
#: takes 2, and turns need some more.
_SLACK = 2.2
#: Shortest leg [m] and shortest time [s] of a guess.
_SHORTEST_LEG, _SHORTEST_TIME = 0.05, 0.1
#: Number of intervals of the program that ranks the starts, and largest number in a refined leg.
COARSE, _MOST_INTERVALS = 12, 400
#: Longest time that a command is held on the coarse and on the fine grid [s]. The number of
#: intervals doubles until both are met: longer intervals let the yaw rate exceed its limit between
#: nodes.
_LONGEST_COARSE, _LONGEST_FINE = 0.12, 0.04
#: Number of paths that may be refined before the search gives up, and number of grids for each.
_REFINED, _FINER = 5, 3
#: Relative error of the durations on the coarse grid.
_WORTH = 1.02
#: Weights of the commands' changes [s]. With the larger one all starts converge, to flights some
#: 0.1 % slower; from those, most flights also converge with the smaller one.
TIDY, _FAST = 1e-2, 1e-3
#: Parts into which an interval is divided to check a path by simulation. Tolerances of this check:
#: error at the end (x, y, γ and their rates), overlap between nodes with anything it must not touch
#: [m], and relative excess of the yaw rate there.
_PARTS, _MISSED = 5, np.array([1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 2e-2])
_GRAZED, _OVERSPUN = 3e-3, 1e-3


def starts(request: Request, intervals: int) -> Iterator[tuple[str, Path, float]]:
    """Yield each start's name, path and final yaw."""
    for name, yaw, aside in _turns(request):
        yield name, guess(request, intervals, yaw, aside, ways=request.via), yaw
    for name, side in (("round on the left", 1.0), ("round on the right", -1.0)):
        detours = _detours(request, side)
        if detours is not None:
            yaw = request.goal_yaws()[0]
            yield name, guess(request, intervals, yaw, 0.0, ways=detours), yaw


def _turns(request: Request) -> Iterator[tuple[str, float, float]]:
    """Yield names, final yaws, and how far the craft turns aside half way."""
    if request.goal.yaw is None:
        for turn, aside in _FREE:
            late = ", the other way first" if turn else f", by {aside:+.1f} rad half way"
            name = f"turned by {turn:+.1f} rad{late if aside else ''}"
            yield name, float(request.start[2] + turn), aside
        return
    nearest, *others = request.goal_yaws()
    for name, aside in _ASIDE.items():
        yield name, nearest, aside
    for yaw in others:
        yield f"turned by {yaw - request.start[2]:+.1f} rad", yaw, 0.0


def further_starts(request: Request, intervals: int) -> Iterator[tuple[str, Path, float]]:
    """Yield other starts, for plans that may not be the best."""
    yaw = request.goal_yaws()[0]
    for name, aside in _FURTHER.items():
        yield name, guess(request, intervals, yaw, aside, ways=request.via, turning=not aside), yaw


def guess(
    request: Request,
    intervals: int,
    yaw: float,
    aside: float,
    ways: Float[np.ndarray, "W 2"],
    turning: bool = False,
) -> Path:
    """Guess a path of straight lines from point to point, as smooth as a rest-to-rest flight."""
    goal = request.goal.state
    corners = np.vstack([request.start[:2], ways, goal[:2]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    legs = len(request.via) + 1
    # Ends of the legs along the corners; a detour belongs to the leg that it bypasses.
    ends = along if legs > 1 else along[[0, -1]]
    push = request.strongest_push
    lengths = np.maximum(np.diff(ends), _SHORTEST_LEG)
    turn = abs(yaw - request.start[2])
    durations = np.maximum(_SLACK * np.sqrt(lengths / push), _SHORTEST_TIME)
    # The yaw rate of a half-sine turn peaks at π times its mean.
    turn = max(_STEEPEST * turn, np.pi * abs(aside))
    durations = np.maximum(durations, turn / request.limits.spin / legs)
    durations = np.maximum(durations, _STEEPEST * lengths / request.limits.speed)
    if turning:  # the initial or final velocity must be reversed first
        durations[0] += 2 * np.hypot(*request.start[3:5]) / push
        durations[-1] += 2 * np.hypot(*np.nan_to_num(goal[3:5])) / push
    total = intervals * legs
    share = np.linspace(0, 1, total + 1)
    smooth = share**2 * (3 - 2 * share)
    position = np.interp(share * legs, np.arange(legs + 1), ends) if legs > 1 else smooth * ends[1]
    place = np.array([np.interp(position, along, column) for column in corners.T]).T
    turned = request.start[2] + (yaw - request.start[2]) * smooth + aside * np.sin(np.pi * share)
    pose = np.column_stack([place, turned])
    times = np.concatenate([[0.0], np.cumsum(np.repeat(durations / intervals, intervals))])
    rates = np.gradient(pose, times, axis=0)
    n = len(request.start) - 6
    motors = np.full((total + 1, n), 0.5)
    return Path(durations, np.column_stack([pose, rates, motors]), np.full((total, n), 0.5))


def _detours(request: Request, side: float) -> Float[np.ndarray, "W 2"] | None:
    """Return points beside the discs on the straight line, in order; None without such discs."""
    if len(request.via) or not len(request.keep_out):
        return None
    start, goal = request.start[:2], request.goal.state[:2]
    way = goal - start
    length = float(np.hypot(*way)) or 1.0
    along, left = way / length, np.array([-way[1], way[0]]) / length
    found = []
    for x, y, radius in request.keep_out:
        to = np.array([x, y]) - start
        if 0 < to @ along < length and abs(to @ left) < radius:
            found.append((to @ along, np.array([x, y]) + side * _ROUND * radius * left))
    return np.array([point for _, point in sorted(found, key=lambda f: f[0])]) if found else None


@dataclass(frozen=True)
class Start:
    """A start of the search and its result.

    Attributes
    ----------
    name : str
        How the craft turns or passes discs in the initial guess.
    time_s : float or None
        Duration of the resulting flight, mostly on a coarse grid; None if the solver did not
        converge.
    status : str
        The solver's status message.
    """

    name: str
    time_s: float | None
    status: str


@dataclass(frozen=True)
class _Candidate:
    """A path that may be refined, its duration [s] and its final yaw [rad]."""

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
        # Durations on the coarse grid exceed those on the fine grid, unless the fine solution
        # differs.
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
        f"no plan was found from any of {max(len(tried), 1)} starts ({words}); none may exist "
        "within the limits",
        field="plan",
    )


def ranked(request: Request) -> tuple[list[_Candidate], list[Start]]:
    """Solve all starts on a coarse grid; return paths to refine, fastest first, and starts."""
    found, guesses, tried = [], [], []
    for name, guess, yaw in starts(request, COARSE):
        one = _coarse(request, guess, yaw)
        tried.append(Start(name, one.time if one.converged else None, one.status))
        if one.converged:
            found.append(_Candidate(one.time, yaw, one.path))
        guesses.append(_Candidate(np.inf, yaw, guess))
    # The coarse grid may allow a path past a rail, which is a bad start for the fine grid; a guess
    # may work.
    found.sort(key=lambda one: one.time)
    return [*found[: _REFINED - 1], *guesses], tried


def further(
    request: Request, intervals: int, best: float = np.inf
) -> Iterator[tuple[Start, Solved | None]]:
    """Try the further starts, refining those that may beat the best time [s]; else None."""
    for name, guess, yaw in further_starts(request, COARSE):
        one, solved = _coarse(request, guess, yaw), None
        time, status = one.time if one.converged else None, one.status
        if not one.converged or one.time < _WORTH * best:
            path = one.path if one.converged else guess
            solved, status = refined(request, path, yaw, intervals, guessed=not one.converged)
            time = time if solved is None else solved.time
        yield Start(name, time, status), solved


def refined(
    request: Request, path: Path, yaw: float, intervals: int, *, guessed: bool = False
) -> tuple[Solved | None, str]:
    """Solve on a fine grid, from a flight or a guess; also return the solver's message.

    If that flight misses its goal, or turns too fast between nodes, repeat with a finer grid and a
    limit of the yaw rate that is lower by the excess.
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
    """Return the program for a path's grid."""
    legs = len(path.durations)
    return program_for(request.model, len(path.commands) // legs, legs, len(request.keep_out))


def _on_grid(path: Path, intervals: int, longest: float, flown: Model | None = None) -> Path:
    """Resample a path: divide each leg into `count` intervals, doubled while they are too long."""
    while path.durations.max() > longest * intervals and 2 * intervals <= _MOST_INTERVALS:
        intervals *= 2
    return path.resampled(intervals, flown)


def _simulated(request: Request, path: Path) -> Float[np.ndarray, "M s"]:
    """Return the states of a flight, including states between the nodes."""
    return path.simulated(request.model, path.times, _PARTS)[1]


def _flies(request: Request, path: Path) -> bool:
    """Simulate a path in smaller steps to check that it reaches its end and respects its limits."""
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
