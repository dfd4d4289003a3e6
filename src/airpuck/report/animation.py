"""Animations of recorded flights and games."""

from __future__ import annotations

import os
from pathlib import Path

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.outputs import replacing
from airpuck.craft.table import AirHockey
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.flight.loop import FlightLog
from airpuck.recording.stream import Recording
from airpuck.report.scene import TABLE, read_scene

#: Most frames of a GIF; more would take hundreds of megabytes.
_MOST_FRAMES = 10_000


def animate(
    recording: Recording,
    path: str | os.PathLike[str],
    *,
    vehicle: Vehicle | None = None,
    span: tuple[float, float] = (0.0, 1.0),
    speed: float = 1.0,
    frames_per_second: float = 25.0,
    table: tuple[float, float] | AirHockey = TABLE,
    log: FlightLog | None = None,
) -> Path:
    """Animate a flight from above: the craft on its table, its thrusts and its set point.

    Parameters
    ----------
    recording : Recording
        Poses and commands, and optionally set points.
    path : path-like
        File to write: ``.gif``, or ``.html`` for a page with play, pause and seek.
    vehicle : Vehicle, optional
        The craft; by default the paper's.
    span : (float, float), default (0, 1)
        Part of the flight, as fractions of its length.
    speed : float, default 1
        Seconds of the flight for each second of the animation; the initial speed of a page.
    frames_per_second : float, default 25
        Frame rate of a GIF [1/s], at most 50; a page follows the screen.
    table : (float, float) or AirHockey, default `AirHockey()`
        Length and width of the table around the origin [m], by default 2.2 and 1.1; for a game,
        also goals, puck and mallet. A table that the flight leaves is not drawn.
    log : FlightLog, optional
        Log of the same flight, to draw the plans of a predictive law.

    Returns
    -------
    Path
        The file. An existing file is replaced once the new one is complete.

    Raises
    ------
    InputError
        If the suffix is unknown, a number is out of range, the span is empty, the recording has no
        poses or commands or they cannot be used, the vehicle has other propellers, or the file
        cannot be written.

    Examples
    --------
    >>> airpuck.animate(recording, "flight.gif", span=(0.0, 0.02)).name
    'flight.gif'
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in (".gif", ".html"):
        raise InputError("is neither .gif nor .html; use one of these suffixes", file=path)
    numbers.SPEED.check(speed, "speed")
    numbers.FRAME_RATE.check(frames_per_second, "frames per second")
    play = table if isinstance(table, AirHockey) else _sized(*table)
    scene = read_scene(recording, vehicle or default_vehicle(), span, play, log)
    n_frames = (scene.stop - scene.start) / speed * frames_per_second
    if suffix == ".gif" and n_frames > _MOST_FRAMES:
        raise InputError(
            f"would have {n_frames:.0f} frames, more than {_MOST_FRAMES}; show a part of the "
            "flight, show it faster or with fewer frames per second, or write an .html",
            file=path,
        )
    with replacing(target) as temporary:
        if suffix == ".gif":
            from airpuck.report.animation_gif import write_animation_gif

            write_animation_gif(scene, temporary, speed=speed, frames_per_second=frames_per_second)
        else:
            from airpuck.report.table_canvas import write_animation_page

            write_animation_page(scene, temporary, speed=speed)
    return target


def _sized(length: float, width: float) -> AirHockey:
    """Return a table of the given length and width."""
    for side in (length, width):
        numbers.TABLE_SIDE.check(side, "table")
    table = TABLE.table.model_copy(update={"length_m": length, "width_m": width})
    return TABLE.model_copy(update={"table": table})
