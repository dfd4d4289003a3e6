"""Flights of a puck between its contacts, found in its poses; and its drag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

#: Number of frames over which a flight is extrapolated, which is also its minimum.
_LOOK_BACK, LEAST = 8, 8
#: Poses farther apart in time belong to two flights [s].
_GAP = 0.1
#: Distance that a moving puck covers in two frames, at least [m].
_MOVING = 5e-4
#: Standard deviations beyond which a frame does not belong to the flight.
_GATE = 6.0
#: Largest error of the drag assumed while searching for flights [1/s].
_DRAG_MARGIN = 0.3
#: Number of Gauss-Newton steps for the drag.
_ITERATIONS = 6


@dataclass(frozen=True, eq=False)
class Flight:
    """Poses without any contact in between."""

    #: [s].
    time: Float[np.ndarray, " n"]
    #: x, y [m], yaw [rad], continuous.
    pose: Float[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class Line:
    """A fitted flight: a straight path in σ."""

    #: The flight's first and last time [s].
    start: float
    end: float
    #: Pose and velocity at the start.
    pose: Float[np.ndarray, " 3"]
    velocity: Float[np.ndarray, " 3"]
    #: Drag of each coordinate [1/s].
    drag: Float[np.ndarray, " 3"]
    #: Standard deviations of the velocity.
    deviation: Float[np.ndarray, " 3"]

    def at(self, time: float) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Return pose and velocity at a time near the flight."""
        sigma = sigmas(self.drag, np.array([time - self.start]))[0]
        return self.pose + self.velocity * sigma, self.velocity * (1 - self.drag * sigma)


def sigmas(
    drag: Float[np.ndarray, " 3"], time: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Return σ of each coordinate; negative for times before the start."""
    rate = np.maximum(drag, 1e-9)
    return -np.expm1(-rate * time[:, None]) / rate


def noise_of(
    time: Float[np.ndarray, " N"], pose: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "3"]:
    """Return the standard deviation of single poses, from second differences away from bounces."""
    step = np.diff(time)
    even = np.abs(np.diff(step)) < 0.1 * np.median(step)
    # At rest, rounded poses do not differ at all.
    moving = np.hypot(*(pose[2:, :2] - pose[:-2, :2]).T) > _MOVING
    second = np.diff(pose, 2, axis=0)[even & moving]
    if len(second) < LEAST:
        return np.full(3, np.nan)
    return np.median(np.abs(second), axis=0) / 0.6745 / np.sqrt(6.0)


def find_flights(
    time: Float[np.ndarray, " N"],
    pose: Float[np.ndarray, "N 3"],
    noise: Float[np.ndarray, " 3"],
    drag: float,
) -> list[Flight]:
    """Split poses where the puck met something; single outlying frames are excluded."""

    def continues(kept: list[int], i: int) -> bool:
        """Return whether a pose continues a flight."""
        if kept and time[i] - time[kept[-1]] > _GAP:
            return False
        if len(kept) < 3:
            return True
        last = kept[-_LOOK_BACK:]
        # The latest first, so that σ is small.
        sigma = np.expm1(-drag * (time[last] - time[i])) / -drag
        middle, here = sigma.mean(), pose[last, :2].mean(axis=0)
        around = sigma - middle
        spread = around @ around
        speed = around @ (pose[last, :2] - here) / spread
        off = pose[i, :2] - (here - speed * middle)
        deviation = noise[0] * np.sqrt(1 + 1 / len(last) + middle**2 / spread)
        bend = _DRAG_MARGIN * np.hypot(*speed) * (time[i] - time[last[0]]) ** 2 / 2
        return bool(np.hypot(*off) < _GATE * deviation + bend)

    flights, kept = [], list[int]()
    for i in range(len(time)):
        fits = continues(kept, i)
        off = not fits and i + 1 < len(time) and len(kept) >= _LOOK_BACK
        if off and continues(kept, i + 1):
            continue  # one outlying frame; the next one continues the flight
        if not fits:
            # With too few frames, the oldest may be from before a contact.
            if len(kept) < _LOOK_BACK and kept and time[i] - time[kept[-1]] < _GAP:
                kept = kept[1:]
                while kept and not continues(kept, i):
                    kept = kept[1:]
            else:
                flights.append(kept)
                kept = []
        kept.append(i)
    flights.append(kept)
    # The frames next to a contact may be affected by it.
    trimmed = [indices[1:-1] for indices in flights]
    return [Flight(time[found], pose[found]) for found in trimmed if len(found) >= LEAST]


def fit_flights(
    flights: list[Flight], noise: Float[np.ndarray, " 3"], start: Float[np.ndarray, " 3"]
) -> tuple[list[Line], Float[np.ndarray, " 3"], Float[np.ndarray, " 3"], Bool[np.ndarray, " F"]]:
    """Fit all flights with one drag for translation and one for rotation.

    Variable projection: given the drag, a flight is linear in pose and velocity. Returns the lines,
    the drags, their standard errors (flights are the clusters), and which flights were used: other
    forces bend the rest.
    """
    used = np.ones(len(flights), dtype=bool)
    drag = start.copy()
    error = np.full(3, np.nan)
    for _ in range(_ITERATIONS):
        gradient, curvature, squares = (np.zeros((len(flights), 3)) for _ in range(3))
        for f, flight in enumerate(flights):
            gradient[f], curvature[f], squares[f] = _reduced(flight, drag, noise)
        # x and y together, yaw alone.
        squared = squares[:, :2].mean(axis=1)
        used = squared < max(9.0, 4 * float(np.median(squared)))
        for columns in ([0, 1], [2]):
            slope = gradient[used][:, columns].sum(axis=1)
            bend = curvature[used][:, columns].sum()
            if bend <= 0:
                continue
            drag[columns] = np.clip(drag[columns] + slope.sum() / bend, 0.0, 10.0)
            error[columns] = _standard_error(slope, bend)
    return [_line(flight, drag, noise) for flight in flights], drag, error, used


def _standard_error(slope: Float[np.ndarray, " F"], curvature: float) -> float:
    """Return the standard error of a drag, from noise or from the spread between flights."""
    n = len(slope)
    between = np.sqrt((slope @ slope) * n / max(n - 1, 1)) / curvature
    return float(max(between, 1 / np.sqrt(curvature)))


def _reduced(
    flight: Flight, drag: Float[np.ndarray, " 3"], noise: Float[np.ndarray, " 3"]
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Return gradient and curvature of the fit by the drag, and mean squared residuals."""
    time = flight.time - flight.time[0]
    sigma, rate = sigmas(drag, time), np.maximum(drag, 1e-9)
    _, velocity, _ = _straight(sigma, flight.pose)
    change = (time[:, None] * np.exp(-rate * time[:, None]) - sigma) / rate
    small = rate * time[-1] < 1e-4
    change = np.where(small, -(time[:, None] ** 2) / 2, change)
    found = np.empty((3, 3))
    for axis in range(3):
        basis, _ = np.linalg.qr(np.stack([np.ones_like(time), sigma[:, axis]], axis=1))
        centred = flight.pose[:, axis] - flight.pose[0, axis]
        residual = centred - basis @ (basis.T @ centred)
        column = change[:, axis] * velocity[axis]
        column = column - basis @ (basis.T @ column)
        scale = noise[axis] ** 2
        found[:, axis] = (
            column @ residual / scale,
            column @ column / scale,
            residual @ residual / scale / max(len(time) - 2, 1),
        )
    return found[0], found[1], found[2]


def _straight(
    sigma: Float[np.ndarray, "n 3"], pose: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Fit a straight path in σ: pose and velocity at σ = 0, and the spread Σ (σ - mean)²."""
    around = sigma - sigma.mean(axis=0)
    spread = (around**2).sum(axis=0)
    velocity = (around * (pose - pose[0])).sum(axis=0) / spread
    return pose.mean(axis=0) - velocity * sigma.mean(axis=0), velocity, spread


def _line(flight: Flight, drag: Float[np.ndarray, " 3"], noise: Float[np.ndarray, " 3"]) -> Line:
    """Fit one flight with given drags."""
    pose, velocity, spread = _straight(sigmas(drag, flight.time - flight.time[0]), flight.pose)
    times = float(flight.time[0]), float(flight.time[-1])
    return Line(*times, pose, velocity, drag, noise / np.sqrt(spread))
