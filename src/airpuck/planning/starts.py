"""Paths to start the search from: local optima differ by how the craft turns, and by which way."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from airpuck.planning.attainable import strongest_push
from airpuck.planning.request import Request
from airpuck.planning.transcription import Path

#: Turned aside half way, by the names of starts [rad].
_ASIDE = {"straight": 0.0, "turned left": 0.5, "turned right": -0.5}
#: The last two are for craft that push one way only: they turn round to brake, and back again.
_FURTHER = {
    "straight, with time to turn round": 0.0,
    "turned far left": 1.2,
    "turned far right": -1.2,
    "turned round to the left": 4.5,
    "turned round to the right": -4.5,
}
#: Starts where the yaw is free: the final turn, and how far the craft turns aside half way [rad].
#: The first seven go all around. In the last two the craft first turns the other way; they lead to
#: flights that beat those of the others by up to 1.3 % (`studies/plan_search.py free-yaw`).
_FREE = (
    (0.0, 0.0),
    (0.9, 0.0),
    (-0.9, 0.0),
    (1.8, 0.0),
    (-1.8, 0.0),
    (2.7, 0.0),
    (-2.7, 0.0),
    (1.6, -1.3),
    (-1.6, 1.3),
)
#: Further from a disc than this share of its radius a way round it leads.
_ROUND = 1.3
#: Peak of the guess's speed over its mean, 1.5, and room to correct it.
_STEEPEST = 1.6


def starts(request: Request, intervals: int) -> Iterator[tuple[str, Path, float]]:
    """Yield what each start is called, its path and its final yaw."""
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
            late = ", the other way first" if aside else ""
            yield f"turned by {turn:+.1f} rad{late}", float(request.start[2] + turn), aside
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
        path = guess(request, intervals, yaw, aside, ways=request.via, turning=not aside)
        yield name, path, yaw


def guess(
    request: Request,
    intervals: int,
    yaw: float,
    aside: float,
    ways: Float[np.ndarray, "W 2"],
    turning: bool = False,
) -> Path:
    """Guess a path: straight from point to point, as smooth as rest to rest, turning on the way."""
    goal = request.goal.state
    corners = np.vstack([request.start[:2], ways, goal[:2]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    legs = len(request.via) + 1
    # Ends of the legs along the corners; a detour belongs to the one leg.
    ends = along if legs > 1 else along[[0, -1]]
    push = float(strongest_push(request, np.array([np.inf]))[0])
    lengths = np.maximum(np.diff(ends), 0.05)
    turn = abs(yaw - request.start[2])
    durations = np.maximum(2.2 * np.sqrt(lengths / push), 0.1)
    # The spin of a turn aside by a sine peaks at π times its mean.
    turn = max(_STEEPEST * turn, np.pi * abs(aside))
    durations = np.maximum(durations, turn / request.limits.spin / legs)
    durations = np.maximum(durations, _STEEPEST * lengths / request.limits.speed)
    if turning:  # velocities at the ends have to be turned round first
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
    """Return points beside the discs that lie on the straight way, in order; None if none does."""
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
