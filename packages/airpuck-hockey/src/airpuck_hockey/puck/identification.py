"""Identification of a puck from recordings: drag, and bounces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
from jaxtyping import Float

from airpuck import AirHockey, InputError, Recording, Vehicle, default_vehicle
from airpuck.extend import Contact, Disc, Puck, Result, strike
from airpuck_hockey.puck.flights import Flight, Line, find_flights, fit_flights, noise_of

#: At a contact, the paths before and after meet this near to a rail or a body [m].
_NEAR = 0.012
#: Longest time between two flights separated by a contact [s].
_BETWEEN = 0.1
#: Time around a contact from which poses give a body's velocity [s].
_AROUND = 0.03
#: Slower bounces carry little information [m/s].
_SLOWEST = 0.1
#: Scatter of velocities after a bounce, relative to the speed, apart from other errors.
_SCATTER = 0.005
#: Fewest bounces from which a number is identified.
_FEWEST = 3
#: Bounces that deviate by more robust standard deviations than this are excluded.
_OUTLIER = 4.0
#: Restitutions that agree to within this are not outliers.
_LEAST_SCATTER = 0.02
#: Errors of a rail's position below this are not mentioned [m].
_RAIL_OFF = 3e-3
#: Median distances from the origin above this are no metres [m].
_FAR = 50.0
_TOO_LITTLE = "the puck barely moves; record a few seconds of shots and bounces"
#: Kind of bounces that determines each number.
_TELL = {"grip": "grip", "friction": "slide along the rail", "restitution": "were found"}
#: Largest standard errors with which a number counts as identified.
_WORST = {"grip": 0.2, "friction": 0.15, "drag": 0.2}


@dataclass(frozen=True, eq=False)
class Bounce:
    """One bounce off a rail: normal and tangential velocities [m/s], angular velocities [rad/s]."""

    before: Float[np.ndarray, " 3"]
    after: Float[np.ndarray, " 3"]
    #: Standard deviation of the velocities after it [m/s].
    deviation: float
    #: Distance of the bounce beyond the expected rail position [m].
    beyond: float


@dataclass(frozen=True, eq=False)
class PuckFit(Result):
    """An identified puck.

    Attributes
    ----------
    play : AirHockey
        Table and puck, with standard errors of the identified numbers.
    flights, seconds : int, float
        Number of flights used, and their total time [s].
    bounces : dict of str to int
        Number of bounces used, off rails, mallet and craft.
    noise_m : float
        Standard deviation of a measured position [m].
    rail_speed_m_s, rail_ratio : array, shape (B,)
        Normal speed before each bounce off a rail, and the fraction of it that remained.
    notes : tuple of str
        Numbers that were not identified, and anomalies.
    """

    JSON = (
        "kept_along_rail=play.puck.kept_along_rail flights flights_s=seconds bounces noise_m "
        "rail_scatter notes"
    )

    play: AirHockey
    flights: int
    seconds: float
    bounces: dict[str, int]
    noise_m: float
    rail_speed_m_s: Float[np.ndarray, " B"]
    rail_ratio: Float[np.ndarray, " B"]
    notes: tuple[str, ...]

    @property
    def rail_scatter(self) -> float:
        """Robust standard deviation of the restitution of single bounces; NaN without bounces."""
        if not len(self.rail_ratio):
            return float("nan")
        return 1.4826 * float(np.median(np.abs(self.rail_ratio - np.median(self.rail_ratio))))

    def to_json(self) -> dict[str, Any]:
        """Return the fields for ``--json``.

        Also ``puck``: ``value`` and ``standard_error`` of each number; None: assumed.

        Returns
        -------
        dict
            The puck's numbers with standard errors (None: assumed), and their basis.
        """
        puck, errors = self.play.puck, self.play.puck.standard_error
        numbers = {
            name: {"value": value_of(puck, name), "standard_error": errors.get(name)}
            for name in (*errors, *puck.assumed)
        }
        return {"puck": numbers} | super().to_json()


def value_of(puck: Puck, name: str) -> float:
    """Return a number of a puck by its name, such as ``rail.restitution``."""
    section, _, key = name.rpartition(".")
    if name == "inertia_kg_m2":
        return puck.inertia
    return getattr(getattr(puck, section) if section else puck, key)


def identify_puck(
    recordings: Recording | Sequence[Recording],
    play: AirHockey | None = None,
    vehicle: Vehicle | None = None,
) -> PuckFit:
    """Identify drag and bounces of a puck from recordings.

    Flights between contacts are fitted together with one drag, and bounces with the twin's law of
    contact. If craft (``pose``) or mallet were recorded, their restitution is identified, too.

    Parameters
    ----------
    recordings : Recording or sequence of Recording
        Recordings with a stream ``puck``.
    play : AirHockey, optional
        Dimensions of table and puck, and values that cannot be identified; by default the usual
        ones.
    vehicle : Vehicle, optional
        The craft, if it was recorded; by default the paper's.

    Returns
    -------
    PuckFit
        The puck, with standard errors.

    Raises
    ------
    InputError
        If a recording has no puck, the puck barely moves, or positions cannot be in metres.

    Examples
    --------
    >>> def slide(seed):
    ...     t = np.arange(0.0, 1.5, 1 / 240)
    ...     x = 4.0 * (1 - np.exp(-0.2 * t)) - 0.5  # from 0.8 m/s, with a drag of 0.2 1/s
    ...     noise = np.random.default_rng(seed).normal(0.0, 5e-5, (len(t), 3))
    ...     stamp = (1e9 * t).astype(np.int64)
    ...     poses = np.column_stack([x, 0 * t, 0 * t]) + noise
    ...     puck = airpuck.Stream(stamp, stamp, poses, ("x_m", "y_m", "yaw_rad"))
    ...     return airpuck.Recording({"puck": puck}, f"slide {seed}")
    ...
    >>> fit = airpuck_hockey.identify_puck([slide(1), slide(2)])
    >>> 0.15 < fit.play.puck.drag_1_s < 0.25
    True
    """
    play = play or AirHockey()
    listed = [recordings] if isinstance(recordings, Recording) else list(recordings)
    rates = np.array([play.puck.drag_1_s, play.puck.drag_1_s, play.puck.spin_drag_1_s])
    flights, parts, noise, turns = _flights(listed, max(float(rates[0]), 0.01))
    lines, drag, error, used = fit_flights(flights, noise, rates)
    # Results of an earlier identification are kept.
    puck, errors, notes = play.puck, dict(play.puck.standard_error), list[str]()
    for name, axis, little in (("drag_1_s", 0, "moves"), ("spin_drag_1_s", 2, "spins")):
        if axis == 2 and not turns:
            notes.append(
                "no angle was recorded: spin_drag_1_s, rail.grip, rail.friction are assumed"
            )
        elif error[axis] < _WORST["drag"]:
            puck = puck.model_copy(update={name: float(drag[axis])})
            errors[name] = float(error[axis])
        else:
            notes.append(f"the puck barely {little}: {name} is assumed")
    pairs = _pairs(lines, used, parts)
    bounces = [b for b in (_rail_bounce(play, *pair) for pair, _ in pairs) if b is not None]
    rail, rail_errors, n_rail, said = (_fit_rail if turns else _fit_restitution)(puck, bounces)
    if not bounces:
        said = [_where(flights, play), *said]
    puck = puck.model_copy(update={"rail": rail})
    errors |= {f"rail.{name}": value for name, value in rail_errors.items()}
    notes += said
    counts = {"rail": n_rail, "mallet": 0, "craft": 0}
    craft = (vehicle or default_vehicle()).radius_m
    bodies = (("mallet", "mallet", play.mallet.radius_m), ("craft", "pose", craft))
    for name, stream, radius in bodies:
        closing = [
            both
            for (pair, part) in pairs
            if (both := _closing(listed[part], stream, pair, radius + puck.radius_m)) is not None
        ]
        counts[name] = len(closing)
        if len(closing) >= _FEWEST:
            restitution, off = _ratio(np.array(closing))
            law = getattr(puck, name).model_copy(update={"restitution": restitution})
            puck = puck.model_copy(update={name: law})
            errors[f"{name}.restitution"] = off
    puck = puck.model_copy(update={"standard_error": errors})
    seconds = sum(line.end - line.start for line, good in zip(lines, used, strict=True) if good)
    left_out = int((~used).sum())
    if left_out:
        notes.append(f"{left_out} of {len(lines)} flights are bent by more than drag: left out")
    found = play.model_copy(update={"puck": puck})
    before, after = _normal_speeds(bounces).T
    seen = float(noise[0]), -before, -after / before
    return PuckFit(found, int(used.sum()), seconds, counts, *seen, tuple(notes))


def _flights(
    recordings: Sequence[Recording], drag: float
) -> tuple[list[Flight], list[int], Float[np.ndarray, " 3"], bool]:
    """Return all flights, their numbers by recording, the noise, and whether angles are known."""
    flights, parts, noises, turns = [], [], [], True
    for recording in recordings:
        time, pose = seen_poses(recording, "puck")
        turns = turns and bool(np.isfinite(pose[:, 2]).all())
        pose[:, 2] = np.nan_to_num(pose[:, 2])
        reach = float(np.median(np.abs(pose[:, :2]).max(axis=1))) if len(pose) else 0.0
        if reach > _FAR:
            known = 'for millimetres, use a mapping: puck = {units = ["mm"]}'
            problem = f"a puck at {reach:.0f} m is on no table; {known}"
            raise InputError(problem, file=recording.source, field="puck.position")
        noise = np.maximum(noise_of(time, pose), 1e-9)
        if np.isnan(noise).any():
            raise InputError(_TOO_LITTLE, file=recording.source)
        found = find_flights(time, pose, noise, drag)
        moving = [f for f in found if np.ptp(f.pose[:, :2], axis=0).max() > 20 * noise[0]]
        parts.append(len(moving))
        flights += moving
        noises.append(noise)
    if len(flights) < 2:
        raise InputError(_TOO_LITTLE, file=recordings[0].source)
    return flights, parts, np.median(noises, axis=0), turns


def seen_poses(
    recording: Recording, stream: str
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N 3"]]:
    """Return times [s] and poses in order, with continuous yaw; NaN without angles.

    Repeated frames are dropped: a camera sends them while it has no new one, or while the puck is
    hidden.
    """
    logged = recording[stream]
    time = (logged.stamp_ns - recording["puck"].stamp_ns[0]) * 1e-9
    columns = slice(2) if np.isnan(logged.values[:, 2]).all() else slice(3)
    kept = np.isfinite(logged.values[:, columns]).all(axis=1)
    time, index = np.unique(time[kept], return_index=True)
    pose = logged.values[kept][index].copy()
    new = np.ones(len(time), dtype=bool)
    new[1:] = (pose[1:, columns] != pose[:-1, columns]).any(axis=1)
    time, pose = time[new], pose[new]
    pose[:, 2] = np.unwrap(pose[:, 2])
    return time, pose


def _pairs(
    lines: list[Line], used: np.ndarray, parts: list[int]
) -> list[tuple[tuple[Line, Line], int]]:
    """Return consecutive flights, and the index of their recording."""
    part = np.repeat(np.arange(len(parts)), parts)
    return [
        ((lines[i], lines[j]), int(part[i]))
        for i, j in pairwise(range(len(lines)))
        if part[i] == part[j]
        and used[i]
        and used[j]
        and 0 <= lines[j].start - lines[i].end < _BETWEEN
    ]


def _meeting(before: Line, after: Line, axis: Float[np.ndarray, " 2"]) -> float | None:
    """Return when the paths before and after a contact meet along an axis [s]."""
    time = (before.end + after.start) / 2
    for _ in range(3):
        (here, speed), (there, other) = before.at(time), after.at(time)
        closing = axis @ (speed - other)[:2]
        if abs(closing) < _SLOWEST:
            return None
        time += float(axis @ (there - here)[:2] / closing)
    slack = 0.01
    return time if before.end - slack < time < after.start + slack else None


def _rail_bounce(play: AirHockey, before: Line, after: Line) -> Bounce | None:
    """Return the bounce between two flights if it was off a single rail."""
    for axis, reach in enumerate(play.table.reach(play.puck.radius_m)):
        normal = np.eye(2)[axis]
        time = _meeting(before, after, normal)
        if time is None:
            continue
        (pose, old), (_, new) = before.at(time), after.at(time)
        side = np.sign(pose[axis])
        beyond = float(abs(pose[axis]) - reach)
        other = pose[1 - axis]
        mouth = axis == 0 and abs(other) < play.table.goal_width_m / 2 + play.puck.radius_m
        if abs(beyond) > _NEAR or mouth or side * old[axis] < _SLOWEST or side * new[axis] > 0:
            continue
        # The normal points into the table; the tangent is the normal turned by 90°.
        nx, ny = -side * normal
        turn = np.array([[nx, ny, 0], [-ny, nx, 0], [0, 0, 1]])
        deviation = float(np.hypot(before.deviation[0], after.deviation[0]))
        return Bounce(turn @ old, turn @ new, deviation, beyond)
    return None


def _where(flights: list[Flight], play: AirHockey) -> str:
    """Describe where the puck moved, and where the table's rails should have been."""
    places = np.concatenate([flight.pose[:, :2] for flight in flights])
    (left, low), (right, high) = np.quantile(places, (0.001, 0.999), axis=0)
    x, y = play.table.reach(play.puck.radius_m)
    length, width = right - left + 2 * play.puck.radius_m, high - low + 2 * play.puck.radius_m
    centre = f"[{(left + right) / 2:.3f}, {(low + high) / 2:.3f}]"
    return (
        f"no bounce is near a rail: the puck moved within x = {left:.2f} to {right:.2f}, y = "
        f"{low:.2f} to {high:.2f} m, and rails stop it at ±{x:.2f}, ±{y:.2f} m. If this table is "
        f"about {length:.2f} by {width:.2f} m, state its size (--table), and its centre in a file "
        f"for --mapping: puck = {{origin_m = {centre}}}"
    )


def _normal_speeds(bounces: Sequence[Bounce]) -> Float[np.ndarray, "B 2"]:
    """Return the speeds along the normal before and after bounces."""
    return np.array([(b.before[0], b.after[0]) for b in bounces]).reshape(-1, 2)


def _fit_restitution(
    puck: Puck, bounces: list[Bounce]
) -> tuple[Contact, dict[str, float], int, list[str]]:
    """Fit the restitution alone, for a puck whose spin is unknown."""
    if len(bounces) < _FEWEST:
        return _fit_rail(puck, bounces)
    speeds = _normal_speeds(bounces)
    ratio = -speeds[:, 1] / speeds[:, 0]
    off = np.abs(ratio - np.median(ratio))
    used = off <= max(_OUTLIER * 1.4826 * float(np.median(off)), _LEAST_SCATTER)
    restitution, error = _ratio(speeds[used])
    law = puck.rail.model_copy(update={"restitution": restitution})
    among = [bounce for bounce, kept in zip(bounces, used, strict=True) if kept]
    return law, {"restitution": error}, int(used.sum()), _rails_elsewhere(among)


def _fit_rail(
    puck: Puck, bounces: list[Bounce]
) -> tuple[Contact, dict[str, float], int, list[str]]:
    """Fit restitution, grip and friction to bounces, using the law of contact."""
    from scipy.optimize import least_squares

    law, notes = puck.rail, list[str]()
    if len(bounces) < _FEWEST:
        notes.append(f"only {len(bounces)} bounces off rails: their parameters are assumed")
        return law, {}, len(bounces), notes

    def residuals(values: Float[np.ndarray, " 3"], among: list[Bounce]) -> Float[np.ndarray, " n"]:
        restitution, grip, friction = values.tolist()
        rail = Contact.model_construct(restitution=restitution, grip=grip, friction=friction)
        return np.concatenate([_off(puck, rail, bounce) for bounce in among])

    bounds = ([0.0, 0.0, 0.0], [1.0, 1.0, 5.0])
    options: dict[str, Any] = {"bounds": bounds, "diff_step": 1e-4}
    robustly = {**options, "loss": "soft_l1"}
    # Cone and grip each create local minima; the assumed values are tried first.
    starts = [(law.grip, law.friction), *product((0.3, 0.8), (0.05, 0.15, 0.5))]
    begins = [np.clip([law.restitution, *start], 1e-3, 0.999) for start in starts]
    tried = [least_squares(residuals, begin, args=(bounces,), **robustly) for begin in begins]
    robust = min(tried, key=lambda fit: fit.cost).x
    size = np.abs(residuals(robust, bounces).reshape(-1, 2)).max(axis=1)
    limit = _OUTLIER * max(1.5 * float(np.median(size)), 1.0)
    used = [b for b, s in zip(bounces, size, strict=True) if s <= limit]
    fit = least_squares(residuals, robust, args=(used,), **options)
    error = _clustered_errors(fit.jac, fit.fun)
    values, errors = law.model_dump(), {}
    for name, value, off in zip(("restitution", "grip", "friction"), fit.x, error, strict=True):
        values[name] = float(value)
        if off < _WORST.get(name, np.inf):
            errors[name] = float(off)
        else:
            notes.append(f"too few bounces {_TELL[name]}: rail.{name} is assumed")
    return Contact(**values), errors, len(used), notes + _rails_elsewhere(used)


def _rails_elsewhere(bounces: Sequence[Bounce]) -> list[str]:
    """Describe where the rails are, if not where they are expected."""
    beyond = float(np.median([bounce.beyond for bounce in bounces]))
    if abs(beyond) <= _RAIL_OFF:
        return []
    where = "farther out" if beyond > 0 else "nearer"
    return [f"rails are {1e3 * abs(beyond):.0f} mm {where} than the table file says"]


def _clustered_errors(
    jacobian: Float[np.ndarray, "n 3"], residual: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " 3"]:
    """Return standard errors; each bounce is a cluster, since its scatter is arbitrary."""
    normal = jacobian.T @ jacobian
    # A number that affects no bounce has no error.
    known = np.diag(normal) > 1e-9
    error = np.full(3, np.inf)
    if not known.any():
        return error
    scores = (jacobian * residual[:, None])[:, known].reshape(-1, 2, known.sum()).sum(axis=1)
    n, free = len(scores), int(known.sum())
    inverse = np.linalg.pinv(normal[np.ix_(known, known)])
    covariance = inverse @ (scores.T @ scores) @ inverse * n / max(n - free, 1)
    error[known] = np.sqrt(np.diag(covariance))
    return error


def _off(puck: Puck, law: Contact, bounce: Bounce) -> Float[np.ndarray, " 2"]:
    """Return the deviation of velocities after a bounce from the law, in standard deviations."""
    normal, along, spin = bounce.before.tolist()
    # The normal is x here: a rail on the left.
    disc = Disc(0.0, 0.0, normal, along, spin, puck.radius_m, puck.mass_kg, puck.inertia)
    strike(disc, Disc(0.0, 0.0), 1.0, 0.0, law)
    speed = float(np.hypot(normal, along))
    deviation = np.hypot(bounce.deviation, _SCATTER * speed)
    return (bounce.after[:2] - np.array([disc.vx, disc.vy])) / deviation


def _closing(
    recording: Recording, stream: str, pair: tuple[Line, Line], apart: float
) -> tuple[float, float] | None:
    """Return the normal speeds before and after a puck's contact with a body, if there was one."""
    if stream not in recording.streams or not len(recording[stream]):
        return None
    before, after = pair
    change = (after.velocity - before.velocity)[:2]
    if np.hypot(*change) < _SLOWEST:
        return None
    when = _meeting(before, after, change / np.hypot(*change))
    if when is None:
        return None
    time, pose = seen_poses(recording, stream)
    # The puck does not change the velocity of a hand, but the hand may change it after the contact.
    sides = (-1, -1) if stream == "mallet" else (-1, 1)
    old, new = (_local(time, pose, when, side) for side in sides)
    if old is None or new is None:
        return None
    (here, speed), (_, later) = before.at(when), after.at(when)
    gap = here[:2] - old[0]
    distance = float(np.hypot(*gap))
    if abs(distance - apart) > _NEAR:
        return None
    normal = gap / distance
    speeds = float(normal @ (speed[:2] - old[1])), float(normal @ (later[:2] - new[1]))
    return speeds if speeds[0] < -_SLOWEST else None


def _local(
    time: Float[np.ndarray, " N"], pose: Float[np.ndarray, "N 3"], when: float, side: int
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]] | None:
    """Return position and velocity of a body just before (-1) or after (1) a time."""
    near = (side * (time - when) > 0) & (np.abs(time - when) < _AROUND)
    if near.sum() < 5:
        return None
    _, slope, level = np.polyfit(time[near] - when, pose[near, :2], 2)
    return level, slope


def _ratio(speeds: Float[np.ndarray, "n 2"]) -> tuple[float, float]:
    """Return the restitution, and its standard error, from speeds before and after."""
    before, after = -speeds[:, 0], speeds[:, 1]
    weight = 1 / np.maximum(before, 0.2) ** 2
    square = (weight * before**2).sum()
    found = float((weight * before * after).sum() / square)
    off = after - found * before
    error = np.sqrt((weight * off**2).sum() / max(len(before) - 1, 1) / square)
    return min(max(found, 0.0), 1.0), float(error)
