"""The contents of an animation of a flight or a game at any moment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError, about
from airpuck.control.law import Bound
from airpuck.craft.table import AirHockey
from airpuck.craft.vehicle import Vehicle, match_columns
from airpuck.flight.loop import FlightLog
from airpuck.physics.rigid_body import wrapped
from airpuck.physics.thrust import thrust
from airpuck.preprocessing.clock import align_clocks
from airpuck.preprocessing.quality import (
    COMMAND_GAP_PERIODS,
    check_commands,
    check_poses,
    drop_disorder,
    find_frozen,
)
from airpuck.recording.stream import Recording, Stream

#: The authors' air-hockey table; its centre is the origin.
TABLE = AirHockey()
#: Length of the arrow of the largest thrust, in radii of the craft.
_LONGEST_ARROW = 4.5
#: Half width of an arrow's shaft, half width and length of its head, in radii of the craft.
SHAFT, HEAD_WIDTH, HEAD_LENGTH = 0.07, 0.21, 0.42

#: A plan is shown for this time, or until the next one [s].
PLAN_LASTS = 0.15
#: Duration of the trail [s].
TRAIL = 2.5
#: Longest gap between connected poses [s], or in sample periods.
_LONGEST_PAUSE, _PAUSE_PERIODS = 0.05, 1.5
#: Distance that a flight on the table may reach beyond the rails, because the origin of motion
#: capture is only roughly the table's centre [m].
_BEYOND_RAILS = 0.05
#: Margin around a flight that is shown without its table [m].
_MARGIN = 0.15


class PlannedPath(NamedTuple):
    """A path planned by a predictive law."""

    #: Time of the plan [s].
    time: float
    #: Positions [m].
    points: Float[np.ndarray, "N 2"]
    #: Kind of limit that binds.
    bound: Bound


@dataclass(frozen=True, eq=False)
class FlightScene:
    """A span of a flight, prepared for an animation."""

    #: The craft.
    vehicle: Vehicle
    #: Name of the recording.
    name: str
    #: Span shown, on the time axis of `align_clocks` [s].
    start: float
    stop: float
    #: Times of the poses, strictly increasing [s].
    time: Float[np.ndarray, " N"]
    #: x, y [m], yaw (continuous) [rad].
    pose: Float[np.ndarray, "N 3"]
    #: Longest gap between connected poses [s].
    pause: float
    #: Times of the commands, strictly increasing [s].
    command_time: Float[np.ndarray, " K"]
    #: Motor commands in [0, 1], in the order of the vehicle's propellers.
    command: Float[np.ndarray, "K n"]
    #: Longest time that a command holds; after it the command is unknown [s].
    command_pause: float
    #: Times of the set points, strictly increasing; empty if none were recorded [s].
    reference_time: Float[np.ndarray, " R"]
    #: Set points: x, y [m], yaw [rad].
    reference: Float[np.ndarray, "R 3"]
    #: Length and width of the table around the origin [m]; None if the flight leaves it.
    table: tuple[float, float] | None
    #: Visible area: least and largest x, least and largest y [m].
    view: tuple[float, float, float, float]
    #: Ordered by time.
    plans: tuple[PlannedPath, ...] = ()
    #: Puck, opponent and score of a game.
    game: GameScene | None = None


@dataclass(frozen=True, eq=False)
class Frames:
    """A flight at given moments."""

    #: The moments [s].
    time: Float[np.ndarray, " F"]
    #: Pose of the craft, or its last known one: x, y [m], yaw (continuous) [rad].
    pose: Float[np.ndarray, "F 3"]
    #: Whether the pose is known.
    known: Bool[np.ndarray, " F"]
    #: The command in force, or NaN.
    command: Float[np.ndarray, "F n"]
    #: The set point, its yaw shifted to within half a turn of the craft's; NaN before the first.
    reference: Float[np.ndarray, "F 3"]


def read_scene(
    recording: Recording,
    vehicle: Vehicle,
    span: tuple[float, float] = (0.0, 1.0),
    play: AirHockey = TABLE,
    log: FlightLog | None = None,
) -> FlightScene:
    """Prepare a recording for an animation.

    Poses that are not finite, and frozen poses, become gaps.
    """
    if not 0 <= span[0] < span[1] <= 1:
        raise InputError(
            f"{span[0]:g} {span[1]:g} is not a span; use two fractions of the recording's length, "
            "0 <= A < B <= 1",
            field="span",
        )
    pose, command = recording["pose"], recording["command"]
    order = match_columns(vehicle, command.columns, source=recording.source)
    aligned = align_clocks(pose, command)
    actuation = vehicle.actuation
    lowest = np.where(actuation.two_way, -1.0, 0.0)[np.argsort(order)]
    with about(recording.source):
        time, poses = _poses(pose, aligned.pose_time)
        command_time, commands = _usable(command, aligned.command_time, "command")
        check_commands(commands, command_time, lowest)

    def on_axis(
        name: str, columns: int
    ) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N k"]]:
        stream = recording.streams.get(name)
        if not stream:
            return np.zeros(0), np.zeros((0, columns))
        times = align_clocks(pose, stream)
        since, usable = _usable(stream, times.command_time + (times.epoch - aligned.epoch), name)
        return since, usable.values[:, :columns]

    reference_time, reference = on_axis("reference", 3)
    start, stop = (float(time[0] + share * (time[-1] - time[0])) for share in span)
    shown = (time >= start) & (time <= stop)
    if shown.sum() < 2:
        raise InputError(f"{span[0]:g} {span[1]:g} leaves fewer than two poses", field="span")
    in_force = _in_force(command_time, start, stop)
    asked = _in_force(reference_time, start, stop)
    game = read_game(recording, play, on_axis, 1 if poses[0, 0] > 0 else -1, (start, stop))
    places = poses[shown, :2]
    if game is None:  # in a game, set points may lie off the table
        places = np.concatenate([places, reference[asked, :2]])
    rails, view = _surroundings(places, vehicle.radius_m, (play.table.length_m, play.table.width_m))
    return FlightScene(
        vehicle=vehicle,
        name=Path(recording.source).name,
        start=start,
        stop=stop,
        time=time[shown],
        pose=poses[shown],
        pause=_longest_pause(time),
        command_time=command_time[in_force],
        command=actuation.split(commands.values[in_force][:, order]),
        command_pause=COMMAND_GAP_PERIODS * _period(command_time),
        reference_time=reference_time[asked],
        reference=reference[asked],
        table=rails,
        view=view,
        plans=() if log is None else _plans(log, float(aligned.command_time[0]), start, stop),
        game=game,
    )


def _plans(log: FlightLog, begin: float, start: float, stop: float) -> tuple[PlannedPath, ...]:
    """Return the plans within a span; `begin` is the time of the first command [s]."""
    since = begin - float(log.time[0])
    found = [
        PlannedPath(float(log.time[k]) + since, plan.states[:, :2], plan.bound_by)
        for k, plan in log.predictions.items()
    ]
    return tuple(plan for plan in found if start <= plan.time <= stop)


def plan_at(scene: FlightScene, time: float) -> PlannedPath | None:
    """Return the newest plan at a moment [s], or None once it has expired."""
    made = [plan for plan in scene.plans if time - PLAN_LASTS < plan.time <= time]
    return made[-1] if made else None


def _poses(
    pose: Stream, time: Float[np.ndarray, " K"]
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N 3"]]:
    """Return times and valid poses, with continuous yaw and without frozen ones."""
    time, usable = _usable(pose, time, "pose")
    if len(time) < 2:
        raise InputError("has fewer than two finite poses, too few for an animation")
    check_poses(usable, time)
    fresh = np.ones(len(time), dtype=bool)
    for span in find_frozen(time, usable.values):
        if span.stop - span.start > _longest_pause(time):
            fresh[(time > span.start) & (time <= span.stop)] = False
    fresh[-1] = True  # keeps the duration of a flight whose end is frozen
    time, values = time[fresh], usable.values[fresh]
    values[:, 2] = np.unwrap(values[:, 2])
    return time, values


def _usable(
    stream: Stream, time: Float[np.ndarray, " N"], kind: str
) -> tuple[Float[np.ndarray, " M"], Stream]:
    """Return the finite samples in strictly increasing time, with dummy stamps."""
    finite = np.isfinite(stream.values).all(axis=1)
    cleaned = drop_disorder(time[finite], stream.values[finite], kind)
    stamps = np.zeros(len(cleaned.time), dtype=np.int64)
    return cleaned.time, Stream(stamps, stamps, cleaned.values, stream.columns)


def _in_force(time: Float[np.ndarray, " K"], start: float, stop: float) -> slice:
    """Return the samples in force within a span."""
    first = int(np.searchsorted(time, start, side="right")) - 1
    return slice(max(first, 0), int(np.searchsorted(time, stop, side="right")))


def _period(time: Float[np.ndarray, " K"]) -> float:
    """Return the median time between samples; infinite for fewer than two."""
    return float(np.median(np.diff(time))) if len(time) > 1 else np.inf


def _longest_pause(time: Float[np.ndarray, " N"]) -> float:
    """Return the longest gap between connected poses [s]."""
    return max(_LONGEST_PAUSE, _PAUSE_PERIODS * _period(time))


def _surroundings(
    points: Float[np.ndarray, "N 2"], radius: float, table: tuple[float, float]
) -> tuple[tuple[float, float] | None, tuple[float, float, float, float]]:
    """Return the table, if the craft stays on it, and the visible area."""
    half = np.array(table) / 2
    if np.all(np.abs(points) + radius <= half + _BEYOND_RAILS):
        return table, (-half[0], half[0], -half[1], half[1])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    reach = (high - low) / 2 + radius + _MARGIN
    reach = np.max(reach / half) * half  # in the proportions of the table
    x, y = middle[0], middle[1]
    return None, (x - reach[0], x + reach[0], y - reach[1], y + reach[1])


def frame_times(
    start: float, stop: float, speed: float, frames_per_second: float
) -> Float[np.ndarray, " F"]:
    """Return the times of the frames [s]."""
    step = speed / frames_per_second
    # The tolerance keeps the last frame despite rounding.
    return start + step * np.arange(int((stop - start) / step * (1 + 1e-9)) + 1)


def frames_at(scene: FlightScene, time: Float[np.ndarray, " F"]) -> Frames:
    """Return the state of a scene at given moments [s]."""
    pose, known = poses_at(scene.time, scene.pose, scene.pause, time)
    reference = _held(scene.reference_time, scene.reference, time, np.inf)
    # Yaw of the set point in the turn nearest to the craft.
    reference[:, 2] = pose[:, 2] - wrapped(np, pose[:, 2] - reference[:, 2])
    command = _held(scene.command_time, scene.command, time, scene.command_pause)
    return Frames(time, pose, known, command, reference)


def poses_at(
    times: Float[np.ndarray, " N"],
    poses: Float[np.ndarray, "N 3"],
    pause: float,
    at: Float[np.ndarray, " F"],
) -> tuple[Float[np.ndarray, "F 3"], Bool[np.ndarray, " F"]]:
    """Return the pose, or the last known pose, at given times; and whether it is known."""
    after = np.searchsorted(times, at, side="right").clip(1, len(times) - 1)
    before = after - 1
    apart = times[after] - times[before]
    share = np.clip((at - times[before]) / apart, 0.0, 1.0)
    known = (apart <= pause) | (share == 0) | (share == 1)
    share = np.where(known, share, 0.0)[:, None]
    return (1 - share) * poses[before] + share * poses[after], known


def _held(
    times: Float[np.ndarray, " K"],
    values: Float[np.ndarray, "K k"],
    at: Float[np.ndarray, " F"],
    longest: float,
) -> Float[np.ndarray, "F k"]:
    """Return the latest values at given moments; NaN before the first and after `longest`."""
    held = np.full((len(at), values.shape[1]), np.nan)
    latest = np.searchsorted(times, at, side="right") - 1
    some = latest >= 0
    some[some] = at[some] - times[latest[some]] <= longest
    held[some] = values[latest[some]]
    return held


def thinned(scene: FlightScene, rate: float = 120.0) -> FlightScene:
    """Return a scene with its poses thinned to a frame rate of screens [1/s]."""
    every = max(1, int(1 / (rate * _period(scene.time)) * (1 + 1e-6)))
    jump = np.diff(scene.time) > scene.pause
    first = np.flatnonzero(np.concatenate([[True], jump]))
    number = np.arange(len(scene.time)) - np.repeat(first, np.diff(first, append=len(scene.time)))
    kept = (number % every == 0) | np.concatenate([jump, [True]])
    return replace(scene, time=scene.time[kept], pose=scene.pose[kept])


def trail(
    scene: FlightScene, until: float, seconds: float
) -> tuple[Float[np.ndarray, "S 2 2"], Float[np.ndarray, " S"]]:
    """Return the last `seconds` of the path: line segments [m] and their ages, 0 to 1 (oldest)."""
    since = until - seconds
    inside = (scene.time > since) & (scene.time < until)
    # Both ends of the trail lie between poses.
    ends = np.array([max(since, scene.time[0]), min(until, scene.time[-1])])
    points = frames_at(scene, ends)
    time = np.concatenate([ends[:1], scene.time[inside], ends[1:]])
    position = np.concatenate([points.pose[:1, :2], scene.pose[inside, :2], points.pose[1:, :2]])
    joined = np.diff(time) <= scene.pause
    joined[0] &= points.known[0]
    joined[-1] &= points.known[1]
    lines = np.stack([position[:-1], position[1:]], axis=1)[joined]
    return lines, ((until - time[1:]) / seconds)[joined]


def arrow_scale(vehicle: Vehicle) -> float:
    """Return the scale of thrust arrows [m/N]."""
    full = _largest_thrust(vehicle)
    return _LONGEST_ARROW * vehicle.radius_m / full if full > 0 else 0.0


def _largest_thrust(vehicle: Vehicle) -> float:
    """Return the largest nominal thrust at full command [N]."""
    return float(np.abs(thrust(vehicle.nominal_thrust, np.ones(vehicle.n_propellers))).max())


def thrust_arrows(
    vehicle: Vehicle, pose: Float[np.ndarray, "F 3"], command: Float[np.ndarray, "F n"]
) -> Float[np.ndarray, "F n 2 2"]:
    """Compute where the arrows of the commanded thrusts start and end [m]."""
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    turn = np.moveaxis(np.array([[cos, -sin], [sin, cos]]), -1, 0)
    start = pose[:, None, :2] + np.einsum("fij,nj->fni", turn, vehicle.positions)
    force = thrust(vehicle.nominal_thrust, command.T).T[..., None]
    push = np.einsum("fij,nj->fni", turn, vehicle.directions)
    return np.stack([start, start + arrow_scale(vehicle) * force * push], axis=2)


def arrow_shapes(arrows: Float[np.ndarray, "n 2 2"], radius: float) -> Float[np.ndarray, "n 7 2"]:
    """Return the outlines of arrows from their starts and ends; `radius` is the craft's [m]."""
    along = arrows[:, 1] - arrows[:, 0]
    length = np.hypot(along[:, 0], along[:, 1])
    unit = along / np.where(length > 0, length, 1.0)[:, None]
    left = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    size = radius * np.minimum(1.0, length / (1.6 * HEAD_LENGTH * radius))
    neck = length - HEAD_LENGTH * size
    zero = np.zeros_like(length)
    shaft, head = SHAFT * size, HEAD_WIDTH * size
    forward = np.stack([zero, neck, neck, length, neck, neck, zero], axis=1)[..., None]
    aside = np.stack([shaft, shaft, head, zero, -head, -shaft, -shaft], axis=1)[..., None]
    return arrows[:, :1] + forward * unit[:, None] + aside * left[:, None]


def heading_mark(vehicle: Vehicle) -> Float[np.ndarray, "3 2"]:
    """Return the triangle that marks the front, in the body frame [m]."""
    return vehicle.radius_m * np.array([[1.3, 0.0], [1.0, 0.24], [1.0, -0.24]])


def round_thrust(vehicle: Vehicle) -> float:
    """Return a round value of thrust for the legend [N]."""
    full = _largest_thrust(vehicle) / 2
    power = 10.0 ** np.floor(np.log10(full)) if full > 0 else 1.0
    return float(max(k * power for k in (1, 2, 5) if k == 1 or k * power <= full))


def short_names(names: tuple[str, ...]) -> list[str]:
    """Strip the leading words that all names share."""
    words = [name.split("_") for name in names]
    # The last word of a name always stays.
    most = min(map(len, words)) - 1 if len(names) > 1 else 0
    alike = [len({word[k] for word in words}) == 1 for k in range(most)]
    cut = alike.index(False) if False in alike else most
    return [" ".join(word[cut:]) for word in words]


#: Longest gap between connected poses of puck or opponent; longer ones follow a goal [s].
PAUSE = 0.1


@dataclass(frozen=True, eq=False)
class DiscPath:
    """Poses of a disc over time."""

    #: Strictly increasing [s].
    time: Float[np.ndarray, " N"]
    #: x, y [m], yaw (continuous) [rad].
    pose: Float[np.ndarray, "N 3"]


@dataclass(frozen=True, eq=False)
class GameScene:
    """Puck, opponent and score within a span of a game."""

    #: Sizes of table, puck and mallet.
    play: AirHockey
    puck: DiscPath
    #: The opponent, if recorded.
    other: DiscPath | None
    #: Whether the opponent is a craft instead of a mallet.
    other_flies: bool
    #: Sign of x in the craft's half.
    side: int
    #: Times of goals [s], and the score of left and right from then on.
    score_time: Float[np.ndarray, " G"]
    score: Float[np.ndarray, "G 2"]

    def score_at(self, time: float) -> tuple[int, int] | None:
        """Return the score of left and right at a moment [s]; None without a referee."""
        k = int(np.searchsorted(self.score_time, time, side="right")) - 1
        if k < 0:
            return (0, 0) if len(self.score_time) else None
        left, right = self.score[k].astype(int).tolist()
        return left, right


def read_game(
    recording: Recording,
    play: AirHockey,
    usable: Callable[[str, int], tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N k"]]],
    side: int,
    span: tuple[float, float],
) -> GameScene | None:
    """Return puck, opponent and score of a recording; None without a puck.

    `usable` returns times on the scene's axis and the first columns of a stream's valid samples.
    """

    def disc_path(name: str) -> DiscPath | None:
        time, pose = usable(name, 3)
        inside = (time >= span[0]) & (time <= span[1])
        if not inside.any():
            return None
        yaw = np.unwrap(pose[inside, 2])
        return DiscPath(time[inside], np.column_stack([pose[inside, :2], yaw]))

    puck = disc_path("puck")
    if puck is None:
        return None
    flies = "opponent_command" in recording.streams
    return GameScene(play, puck, disc_path("mallet"), flies, side, *usable("game", 2))
