"""Animations of recorded flights and games."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyBboxPatch, Patch, Polygon, Rectangle
from matplotlib.text import Text
from PIL import GifImagePlugin, Image

from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.outputs import rendered, replacing
from airpuck.craft.table import AirHockey, Table
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.flight.loop import FlightLog
from airpuck.recording.stream import Recording
from airpuck.report import scene as moments
from airpuck.report import style
from airpuck.report.scene import PAUSE, TABLE, FlightScene, Frames, GameScene, read_scene

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


#: Width and height of a GIF [in]: video encoders need an even number of pixels.
_SIZE = 9.0, 7.2
#: Room for the rails around the table [m].
_RAIL = 0.035
#: Colours of the GIF; the next index marks an unchanged pixel.
_COLORS = 255
#: Marker of the pose and the set point over time.
_DOT: dict[str, Any] = {"marker": "o", "ms": 5, "mec": "white", "mew": 0.7, "clip_on": False}
#: Height of the line above the table, in the figure.
_HEADER = 0.97
#: Frames per second of a drawing that moves, and how long its last frame stays [s].
RATE, LASTS = 20.0, 1.5


def write_animation_gif(
    scene: FlightScene, path: Path, *, speed: float, frames_per_second: float
) -> None:
    """Write a GIF."""
    frames = moments.frames_at(
        scene, moments.frame_times(scene.start, scene.stop, speed, frames_per_second)
    )
    colors = [*style.propeller_colors(scene.vehicle), style.BLACK, style.GREY, style.ASKED]
    colors += style.BOUND_COLORS.values() if scene.plans else ()
    colors += (style.BLUE, style.VERMILLION) if scene.game is not None else ()
    shown = moments.thinned(scene)
    figure = _scenery(shown, speed)
    arrows = moments.thrust_arrows(scene.vehicle, frames.pose, frames.command)
    moving = [partial(_moving, figure, shown, frames, arrows, k) for k in range(len(frames.time))]
    write_gif(path, figure, moving, colors, frames_per_second)


def write_gif(
    path: Path,
    figure: Figure,
    moving: Sequence[Callable[[], Iterable[tuple[Axes, Artist]]]],
    colors: Sequence[str],
    frames_per_second: float,
    lasts: float = 0.0,
) -> None:
    """Write a GIF of a figure; each frame adds its own artists, from back to front.

    The last frame stays for `lasts` seconds.
    """
    canvas: Any = figure.canvas
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)

    def picture(k: int) -> Image.Image:
        canvas.restore_region(background)
        for axes, artist in moving[k]():
            axes.add_artist(artist)
            axes.draw_artist(artist)
            artist.remove()
        return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())

    count = len(moving)
    samples = [picture(count * k // 6) for k in range(6)]
    # A GIF counts hundredths of a second.
    ticks = np.diff(np.rint(100 * np.arange(count + 1) / frames_per_second)).astype(int)
    ticks[-1] = max(ticks[-1], round(100 * lasts))
    pictures = (picture(k) for k in range(count))
    _stream_gif(path, pictures, _palette(samples, colors), ticks.tolist())


def _palette(samples: Sequence[Image.Image], wanted: Sequence[str]) -> Image.Image:
    """Return a palette for all frames: the given colours, the most frequent ones, then others."""
    together = Image.fromarray(np.concatenate([np.asarray(sample) for sample in samples]))
    counted = together.getcolors(together.width * together.height) or []
    common = [color for _, color in sorted(counted, reverse=True)[:64]]
    others = np.reshape(together.quantize(_COLORS).getpalette() or [], (-1, 3))
    kept = np.rint(255 * np.array([to_rgb(color) for color in wanted]))
    for color in [*common, *others]:
        # Pillow's lookup is coarse: a colour close to white, say, would replace white.
        if np.abs(kept - color).max(axis=1).min() > 10 and len(kept) < _COLORS:
            kept = np.vstack([kept, color])
    palette = Image.new("P", (1, 1))
    palette.putpalette(kept.astype(np.uint8).tobytes())
    return palette


def _stream_gif(
    path: Path, pictures: Iterable[Image.Image], palette: Image.Image, ticks: Sequence[int]
) -> None:
    """Stream frames that hold only the changes; Pillow's `save` would hold all in memory."""
    before = None
    with path.open("wb") as file:
        for picture, lasts in zip(pictures, ticks, strict=True):
            now = picture.quantize(palette=palette, dither=Image.Dither.NONE)
            pixels, corner = np.asarray(now), (0, 0)
            about: dict[str, Any] = {"duration": 10 * lasts, "disposal": 1}
            if before is None:
                file.writelines(GifImagePlugin.getheader(now, info={"loop": 0})[0])
            else:
                changed = pixels != before
                box = Image.fromarray(changed).getbbox() or (0, 0, 1, 1)
                now = Image.fromarray(np.where(changed, pixels, np.uint8(_COLORS))).crop(box)
                corner = box[:2]
                about["transparency"] = _COLORS
            file.writelines(GifImagePlugin.getdata(now, corner, **about))
            before = pixels
        file.write(b";")


def _moving(
    figure: Figure, scene: FlightScene, frames: Frames, arrows: Float[np.ndarray, "F n 2 2"], k: int
) -> Iterator[tuple[Axes, Artist]]:
    """Yield the moving artists of frame k."""
    table, *panels, motors = figure.axes
    now = float(frames.time[k])
    for artist in _moving_on_table(scene, frames, arrows[k], k):
        yield table, artist
    for i, axes in enumerate([*panels, motors]):
        high: dict[str, Any] = {"transform": axes.get_xaxis_transform()}
        rest = max(scene.stop - now, 0.0)
        yield axes, Rectangle((now, 0), rest, 1, color="white", alpha=0.72, lw=0, **high)
        yield axes, Line2D([now, now], [0, 1], color=style.BLACK, lw=0.9, **high)
        if axes is not motors:
            seen = frames.pose[k, i] if frames.known[k] else np.nan
            for value, color in ((frames.reference[k, i], style.ASKED), (seen, style.BLACK)):
                yield axes, Line2D([now], [value], color=color, **_DOT)
    score = None if scene.game is None else scene.game.score_at(now)
    shown = [(0.98, "right", f"{now:.2f} s")]
    shown += [] if score is None else [(0.5, "center", f"{score[0]} : {score[1]}")]
    for x, side, words in shown:
        text = Text(x, _HEADER, words, ha=side, va="center", fontsize=15, fontweight="bold")
        text.set(transform=figure.transFigure, clip_on=False)
        yield table, text


def _moving_on_table(
    scene: FlightScene, frames: Frames, arrows: Float[np.ndarray, "n 2 2"], k: int
) -> Iterator[Artist]:
    """Yield the moving artists on the table, from back to front."""
    vehicle, pose = scene.vehicle, frames.pose[k]
    lines, age = moments.trail(scene, float(frames.time[k]), moments.TRAIL)
    colors, widths = _faded(0.1 + 0.9 * age), 2.4 - 1.4 * age
    yield LineCollection(list(lines), colors=colors, linewidths=widths, capstyle="round")
    if np.isfinite(frames.reference[k]).all():
        yield from _craft(vehicle, frames.reference[k], style.ASKED, ls=(0, (3, 1.6)))
    plan = moments.plan_at(scene, float(frames.time[k]))
    if plan is not None:
        color = style.BOUND_COLORS[plan.bound]
        yield LineCollection([plan.points], colors=color, linewidths=2.2, capstyle="round")
        yield Circle(tuple(plan.points[-1]), 0.1 * vehicle.radius_m, fc=color, ec="none")
    if scene.game is not None:
        yield from _beside(scene.game, vehicle, frames.time[k : k + 1])
    if not frames.known[k]:  # the directions of its thrusts are unknown
        yield from _craft(vehicle, pose, style.GREY, ls=(0, (2, 2)))
        above = pose[1] + 1.15 * vehicle.radius_m
        yield Text(pose[0], above, "no pose", color=style.GREY, fontsize=8, ha="center")
        return
    yield from _craft(vehicle, pose, style.BLACK if scene.game is None else _tint(scene.game.side))
    shapes = list(moments.arrow_shapes(arrows, vehicle.radius_m))
    tints = style.propeller_colors(vehicle)
    yield PolyCollection(shapes, facecolors=tints, edgecolors="white", linewidths=0.5)


def _beside(game: GameScene, vehicle: Vehicle, now: Float[np.ndarray, " 1"]) -> Iterator[Patch]:
    """Yield the opponent and the puck."""
    sizes, color = game.play, _tint(-game.side)
    if game.other is not None:
        ((pose,), _) = moments.poses_at(game.other.time, game.other.pose, np.inf, now)
        if game.other_flies:
            yield from _craft(vehicle, pose, color)
        else:
            yield Circle(tuple(pose[:2]), sizes.mallet.radius_m, fc=color, ec="none")
            ring = 0.42 * sizes.mallet.radius_m
            yield Circle(tuple(pose[:2]), ring, fc="none", ec="white", lw=1.2)
    ((pose,), (known,)) = moments.poses_at(game.puck.time, game.puck.pose, PAUSE, now)
    if known:
        yield Circle(tuple(pose[:2]), sizes.puck.radius_m, fc=style.BLACK, ec="none")
        mark = pose[:2] + 0.45 * sizes.puck.radius_m * np.array([np.cos(pose[2]), np.sin(pose[2])])
        yield Circle(tuple(mark), 0.2 * sizes.puck.radius_m, fc="white", ec="none")


def _tint(side: int) -> str:
    """Return the colour of a side, given by its sign of x."""
    return style.BLUE if side < 0 else style.VERMILLION


def _craft(
    vehicle: Vehicle, pose: Float[np.ndarray, " 3"], color: str, **outline: Any
) -> Iterator[Patch]:
    """Yield the shapes of the craft at a pose; at a set point the outline only."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, sin], [-sin, cos]])
    face, mark = ("none", color) if color == style.ASKED else ("white", style.BLACK)
    yield Circle(tuple(pose[:2]), vehicle.radius_m, fc=face, ec=color, lw=1.5, **outline)
    yield Polygon(moments.heading_mark(vehicle) @ turn + pose[:2], facecolor=mark, edgecolor="none")
    if color == style.ASKED:
        return
    places = vehicle.positions @ turn + pose[:2]
    for place, tint in zip(places, style.propeller_colors(vehicle), strict=True):
        size = style.propeller_size(vehicle)
        yield Circle(tuple(place), size, fc=(tint, 0.25), ec=tint, lw=0.8)


def _faded(share: Float[np.ndarray, " S"]) -> Float[np.ndarray, "S 3"]:
    """Mix black with the floor's colour; opaque, so overlapping line ends stay invisible."""
    share = np.clip(share, 0, 1)[:, None]
    return (1 - share) * np.array(to_rgb(style.BLACK)) + share * np.array(to_rgb(style.FLOOR))


@style.styled
def _scenery(scene: FlightScene, speed: float) -> Figure:
    """Draw the static parts: table, panels for x, y, yaw and the motors, legend."""
    figure = Figure(figsize=_SIZE, dpi=style.RESOLUTION)
    FigureCanvasAgg(figure)
    room = {"left": 0.06, "right": 0.98, "bottom": 0.07, "top": 0.94}
    grid = figure.add_gridspec(2, 4, height_ratios=(3.7, 1), **room, wspace=0.24, hspace=0.34)
    table = figure.add_subplot(grid[0, :])
    _draw_table(table, scene)
    _draw_panels([figure.add_subplot(grid[1, k]) for k in range(4)], scene)
    thrust = f"commanded thrust, {moments.arrow_scale(scene.vehicle):.2g} m long for 1 N"
    keys = [
        style.key(f"path of the last {moments.TRAIL:g} s", lw=2.4),
        style.key(thrust, style.GREY, marker=">", markevery=[-1], lw=2.0),
    ]
    if len(scene.reference):
        keys.append(style.key("set point", style.ASKED, marker="o", mfc="none", ms=9, ls=""))
    if scene.plans:
        bounds = style.BOUND_WORDS.items()
        keys += [style.key(words, style.BOUND_COLORS[bound], lw=2.2) for bound, words in bounds]
    below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.08)}
    table.legend(handles=keys, ncols=min(len(keys), 3), **below)
    pace = "" if speed == 1 else f"  ·  {speed:g} × real time"
    name = f"{scene.vehicle.name}  ·  {scene.name}{pace}"
    figure.text(0.06, _HEADER, name, va="center", size=11, color=style.GREY)
    return figure


def _draw_table(axes: Axes, scene: FlightScene) -> None:
    """Draw the floor and the rails, and the marks of a game."""
    x0, x1, y0, y1 = scene.view
    axes.set(xlim=(x0 - _RAIL, x1 + _RAIL), ylim=(y0 - _RAIL, y1 + _RAIL), aspect="equal")
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    axes.grid(color=style.GRID)
    axes.set(xlabel="x [m]", ylabel="y [m]")
    if scene.table is None:
        axes.set_facecolor(style.FLOOR)
        return
    length, width = scene.table
    shape = f"round,pad={0.6 * _RAIL},rounding_size={1.4 * _RAIL}"
    rails = FancyBboxPatch((-length / 2, -width / 2), length, width, boxstyle=shape)
    rails.set(facecolor=style.FLOOR, edgecolor=style.RAIL, lw=4.5, zorder=0.1)
    axes.add_patch(rails)
    if scene.game is None:
        return
    half = scene.game.play.table.goal_width_m / 2
    axes.vlines(0, -width / 2, width / 2, color=style.RAIL, lw=1.5, zorder=0.7)
    axes.add_patch(Circle((0, 0), 0.16, fill=False, ec=style.RAIL, lw=1.5, zorder=0.7))
    for side in (-1, 1):
        x = side * (length / 2 + 0.6 * _RAIL)
        axes.vlines(x, -half, half, color="white", lw=5, zorder=0.8)
        axes.vlines(x, -half, half, color=_tint(side), lw=5, alpha=0.4, zorder=0.9)
        axes.plot([x, x], [-half, half], "o", color=_tint(side), ms=5, zorder=1)


def _draw_panels(panels: list[Axes], scene: FlightScene) -> None:
    """Draw poses, set points and commands over time."""
    known = np.diff(scene.time, append=np.inf) <= scene.pause
    # A NaN after each stretch breaks the line.
    rows = np.flatnonzero(~known) + 1
    time = np.insert(scene.time, rows, np.nan)
    pose = np.insert(scene.pose, rows, np.nan, axis=0)
    asked = moments.frames_at(scene, scene.time).reference
    titles = ("x [m]", "y [m]", "yaw [rad]", "motor commands [0 … 1]")
    for i, (axes, title) in enumerate(zip(panels, titles, strict=True)):
        axes.set_xlim(scene.start, scene.stop)
        axes.set_xlabel("time [s]", labelpad=1)
        axes.set_title(title, loc="left", fontsize=9, fontweight="normal", pad=4)
        axes.tick_params(length=2, pad=2)
        axes.locator_params(axis="both", nbins=5, steps=[1, 2, 5, 10])
        if i < 3:
            axes.plot(time, pose[:, i], color=style.BLACK, lw=1.4)
            axes.plot(
                scene.time, asked[:, i], color=style.ASKED, lw=1.3, ls=(0, (4, 1.5)), zorder=1.5
            )
    _draw_motors(panels[-1], scene)


def _draw_motors(axes: Axes, scene: FlightScene) -> None:
    """Draw the commands as rows, the first on top."""
    n, colors = scene.vehicle.n_propellers, style.propeller_colors(scene.vehicle)
    edges = np.append(scene.command_time, scene.stop)
    for i, color in enumerate(colors):
        row = n - 1 - i
        values = 0.86 * np.append(scene.command[:, i], 0.0)
        axes.fill_between(edges, row, row + values, step="post", color=color, lw=0)
    axes.set_ylim(-0.1, n)
    axes.grid(False)
    names = moments.short_names(scene.vehicle.propeller_names)
    axes.set_yticks(np.arange(n)[::-1] + 0.4, names)
    # Many rows or long names need small type.
    size = max(min(8.0, 50.0 / n, 48.0 / max(map(len, names))), 4.0)
    axes.tick_params(axis="y", length=0, labelsize=size)
    for text, color in zip(axes.get_yticklabels(), colors, strict=True):
        text.set_color(color)


@dataclass(frozen=True, eq=False)
class Mover:
    """A craft of a drawing, or a goal, which has no name."""

    name: str
    color: str
    #: [m].
    radius: float
    #: [s].
    time: Float[np.ndarray, " N"]
    #: x, y [m], yaw [rad].
    poses: Float[np.ndarray, "N 3"]


def moving_drawing(
    table: Table, moving: Sequence[Mover], discs: Sequence[tuple[float, float, float]] = ()
) -> str:
    """Return an animated SVG, which repeats; readers who prefer no motion see the paths."""
    end = max(one.time[-1] for one in moving)
    times = np.append(np.arange(0.0, end, 1 / RATE), np.full(round(LASTS * RATE), end))
    drawn = []
    for one in moving:
        # y points down in an SVG, and angles are in degrees, clockwise.
        x, y, yaw = one.poses[(one.time.searchsorted(times, side="right") - 1).clip(0)].T
        places = [f"{x:.3f} {-y:.3f}" for x, y in zip(x, y, strict=True)]
        drawn.append((one, places, [f"{-a:.0f}" for a in np.degrees(yaw)]))
    shown = {"moving": drawn, "discs": discs, "seconds": len(times) / RATE}
    return rendered("moving.svg.jinja", table=table, floor=style.FLOOR, rail=style.RAIL, **shown)
