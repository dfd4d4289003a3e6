"""An animation as a GIF: the table from above, the state and the motors over time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyBboxPatch, Patch, Polygon, Rectangle
from matplotlib.transforms import Affine2D
from matplotlib.typing import RGBColorType

from airpuck.report.animation_frames import (
    TRAIL,
    Frames,
    Scene,
    frame_times,
    frames_at,
    thinned,
    trail,
)
from airpuck.report.animation_shapes import (
    ASKED,
    FLOOR,
    GRID,
    HOLES,
    RAIL,
    arrow_scale,
    arrow_shapes,
    heading_mark,
    propeller_size,
    round_thrust,
    short_names,
    thrust_arrows,
)
from airpuck.report.gif_file import write_gif
from airpuck.report.style import BLACK, GREY, RESOLUTION, propeller_colors, styled

#: Width of the picture, largest size of the table, and what is around it [in].
_WIDTH, _WIDEST, _TALLEST = 9.0, 8.32, 5.6
_LEFT, _HEADER, _TICKS, _LEGEND, _PANELS, _BOTTOM = 0.5, 0.46, 0.25, 0.34, 1.2, 0.5
_GAP = 0.42
#: Room for the rails around the table [m].
_RAIL = 0.035
#: How much of the future is hidden.
_COVER = 0.72


def write_animation_gif(
    scene: Scene, path: Path, *, speed: float, frames_per_second: float
) -> None:
    """Write a GIF."""
    frames = frames_at(scene, frame_times(scene.start, scene.stop, speed, frames_per_second))
    stage = _Stage(scene, speed)
    some = np.linspace(0, len(frames.time) - 1, 6).astype(int)
    write_gif(
        path,
        stage.pictures(frames, range(len(frames.time))),
        list(stage.pictures(frames, some.tolist())),
        [_rgb(color) for color in dict.fromkeys((*stage.colors, BLACK, GREY, ASKED))],
        frames_per_second,
    )


class _Stage:
    """A figure of which most stands still, and the artists that move in front of it."""

    def __init__(self, scene: Scene, speed: float) -> None:
        self.scene = thinned(scene)
        self.colors = propeller_colors(scene.vehicle)
        self.figure = _scenery(self.scene, speed)
        table, *panels, motors, _ = self.figure.axes
        self.trail = LineCollection([], capstyle="round", zorder=2)
        table.add_collection(self.trail)
        self.asked = _Craft(table, scene, asked=True)
        self.craft = _Craft(table, scene, asked=False)
        self.arrows = PolyCollection(
            [], facecolors=self.colors, edgecolors="white", linewidths=0.5, zorder=6
        )
        table.add_collection(self.arrows)
        self.clock = self.figure.text(
            1 - 0.18 / _WIDTH,
            _from_top(self.figure, 0.23),
            "",
            ha="right",
            va="center",
            fontsize=15,
            fontweight="bold",
        )
        self.panels = [_Cursor(axes, 1 + (len(scene.reference) > 0)) for axes in panels]
        self.motors = _Cursor(motors, 0)
        canvas = self.figure.canvas
        assert isinstance(canvas, FigureCanvasAgg)
        self.canvas = canvas
        for artist in self._moving():
            artist.set_animated(True)
        canvas.draw()
        self.background = canvas.copy_from_bbox(self.figure.bbox)

    def _moving(self) -> Iterator[Artist]:
        """Give what is drawn anew in every frame, from the back to the front."""
        yield from (self.trail, *self.asked.artists, *self.craft.artists, self.arrows)
        for cursor in (*self.panels, self.motors):
            yield from cursor.artists
        yield self.clock

    def pictures(
        self, frames: Frames, numbers: Sequence[int]
    ) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
        """Draw some frames, one at a time."""
        arrows = thrust_arrows(self.scene.vehicle, frames.pose, frames.command)
        for k in numbers:
            self.canvas.restore_region(self.background)  # pyright: ignore[reportAttributeAccessIssue]
            self._move(frames, k, arrows[k])
            for artist in self._moving():
                if artist.axes is not None:
                    artist.axes.draw_artist(artist)
                else:
                    self.figure.draw_artist(artist)
            yield np.asarray(self.canvas.buffer_rgba())[..., :3].copy()

    def _move(self, frames: Frames, k: int, arrows: Float[np.ndarray, "n 2 2"]) -> None:
        """Put everything where it is in frame k."""
        now = float(frames.time[k])
        lines, age = trail(self.scene, now, TRAIL)
        self.trail.set_segments(list(lines))
        self.trail.set_color(_blend(BLACK, FLOOR, 0.1 + 0.9 * age))
        self.trail.set_linewidth((2.4 - 1.4 * age).tolist())
        self.asked.move(frames.reference[k], seen=True)
        self.craft.move(frames.pose[k], seen=bool(frames.known[k]))
        # Where the craft is not seen, nobody knows where its propellers push.
        seen = arrows if frames.known[k] else arrows[:0]
        self.arrows.set_verts(list(arrow_shapes(seen, self.scene.vehicle.radius_m)))
        self.clock.set_text(f"{now:.2f} s")
        for i, cursor in enumerate(self.panels):
            seen = frames.pose[k, i] if frames.known[k] else np.nan
            cursor.move(now, (seen, frames.reference[k, i]))
        self.motors.move(now, ())


class _Craft:
    """The craft, or the outline of where it was asked to be, drawn once and then moved."""

    def __init__(self, axes: Axes, scene: Scene, *, asked: bool) -> None:
        vehicle = scene.vehicle
        self.asked = asked
        self.axes = axes
        color = ASKED if asked else BLACK
        self.body = Circle(
            (0, 0), vehicle.radius_m, facecolor="none" if asked else "white", edgecolor=color
        )
        self.body.set(lw=1.5, ls=(0, (3, 1.6)) if asked else "-")
        mark = Polygon(heading_mark(vehicle), facecolor=color, edgecolor="none")
        self.parts: list[Patch] = [self.body, mark]
        if not asked:
            size = propeller_size(vehicle)
            for (x, y), tint in zip(vehicle.positions, propeller_colors(vehicle), strict=True):
                face = (*to_rgb(tint), 0.25)
                self.parts.append(Circle((x, y), size, facecolor=face, edgecolor=tint, lw=0.8))
        for part in self.parts:
            part.set_zorder(3 if asked else 4)
            axes.add_patch(part)
        self.note = axes.text(
            0, 0, "no pose", color=GREY, fontsize=8, ha="center", va="bottom", visible=False
        )
        self.radius = vehicle.radius_m
        self.artists: list[Artist] = [*self.parts, self.note]

    def move(self, pose: Float[np.ndarray, " 3"], *, seen: bool) -> None:
        """Put it at a pose; out of sight where that is not known."""
        x, y, yaw = pose.tolist()
        known = bool(np.isfinite(pose).all())
        for part in self.parts:
            part.set_visible(known)
        self.note.set_visible(not seen)
        if known:
            at = Affine2D().rotate(yaw).translate(x, y) + self.axes.transData
            for part in self.parts:
                part.set_transform(at)
            self.note.set_position((x, y + 1.15 * self.radius))
        if not self.asked:
            self.body.set(edgecolor=BLACK if seen else GREY, ls="-" if seen else (0, (2, 2)))


class _Cursor:
    """Where in time a panel is: what is to come is pale."""

    def __init__(self, axes: Axes, n_dots: int) -> None:
        self.start, self.stop = axes.get_xlim()
        low, high = axes.get_ylim()
        self.cover = Rectangle((0, low), 1, high - low, color="white", alpha=_COVER, lw=0, zorder=4)
        axes.add_patch(self.cover)
        self.line = Line2D([0, 0], [low, high], color=BLACK, lw=0.9, zorder=5)
        axes.add_line(self.line)
        self.dots = [
            Line2D([0], [0], ls="", marker="o", ms=5, mec="white", mew=0.7, color=color, zorder=6)
            for color in (BLACK, ASKED)[:n_dots]
        ]
        for dot in self.dots:
            axes.add_line(dot)
        self.artists: list[Artist] = [self.cover, self.line, *reversed(self.dots)]

    def move(self, now: float, values: Sequence[float]) -> None:
        """Put the cursor at a moment and the dots at their values."""
        self.cover.set_x(now)
        self.cover.set_width(max(self.stop - now, 0.0))
        self.line.set_xdata([now, now])
        for dot, value in zip(self.dots, values, strict=False):
            dot.set_data([now], [value])


@styled
def _scenery(scene: Scene, speed: float) -> Figure:
    """Draw what stands still: table, then panels for x, y, yaw and the motors."""
    x0, x1, y0, y1 = scene.view
    width, height = x1 - x0 + 2 * _RAIL, y1 - y0 + 2 * _RAIL
    scale = min(_WIDEST / width, _TALLEST / height)
    below = _TICKS + _LEGEND + _PANELS + _BOTTOM + 0.2
    total = _HEADER + scale * height + below
    # An even number of pixels, for those who turn the GIF into a video.
    figure = Figure(
        figsize=(_WIDTH, round(total * RESOLUTION / 2) * 2 / RESOLUTION), dpi=RESOLUTION
    )
    FigureCanvasAgg(figure)
    left = _LEFT + (_WIDEST - scale * width) / 2
    bottom = 1 - (_HEADER + scale * height) / total
    table = figure.add_axes((left / _WIDTH, bottom, scale * width / _WIDTH, scale * height / total))
    _draw_table(table, scene)
    _draw_header(figure, scene, speed)
    _draw_panels(figure, scene)
    _draw_legend(figure, scene, table)
    return figure


def _draw_header(figure: Figure, scene: Scene, speed: float) -> None:
    """Name the craft and the recording."""
    y = _from_top(figure, 0.23)
    name = figure.text(
        _LEFT / _WIDTH, y, scene.vehicle.name, fontsize=13, fontweight="bold", va="center"
    )
    after = name.get_window_extent().x1 / (_WIDTH * RESOLUTION)
    pace = "" if speed == 1 else f"  ·  at {speed:g} × its speed"
    figure.text(after + 0.012, y - 0.0015, scene.name + pace, fontsize=10, color=GREY, va="center")


def _from_top(figure: Figure, inches: float) -> float:
    """Return a height in the figure, measured from its top."""
    return 1 - inches / figure.get_figheight()


def _draw_table(axes: Axes, scene: Scene) -> None:
    """Draw the floor, the rails and a grid."""
    x0, x1, y0, y1 = scene.view
    axes.set(xlim=(x0 - _RAIL, x1 + _RAIL), ylim=(y0 - _RAIL, y1 + _RAIL))
    axes.set_aspect("equal")
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.tick_params(length=0, pad=2)
    step = _nice_step(max(x1 - x0, y1 - y0) / 5)
    axes.set_xticks(_multiples(x0, x1, step))
    axes.set_yticks(_multiples(y0, y1, step))
    axes.grid(False)
    axes.vlines(axes.get_xticks(), y0, y1, color=GRID, lw=0.8, zorder=0.5)
    axes.hlines(axes.get_yticks(), x0, x1, color=GRID, lw=0.8, zorder=0.5)
    # Names of the axes stand between the last two numbers.
    for axis, low, high in ((axes.xaxis, x0, x1), (axes.yaxis, y0, y1)):
        share = (axis.get_majorticklocs()[-1] - step / 2 - low + _RAIL) / (high - low + 2 * _RAIL)
        sideways = axis is axes.xaxis
        axis.set_label_text(f"{'x' if sideways else 'y'} [m]")
        axis.set_label_coords(*((share, -0.008) if sideways else (-0.016, share)))
        axis.label.set_fontsize(8)
    axes.xaxis.label.set_verticalalignment("top")
    dots = np.meshgrid(_multiples(x0, x1, step / 5), _multiples(y0, y1, step / 5))
    axes.plot(*(dot.ravel() for dot in dots), ".", color=HOLES, ms=2.6, mew=0, zorder=0.6)
    if scene.table is None:
        axes.set_facecolor(FLOOR)
        return
    length, width = scene.table
    axes.add_patch(
        FancyBboxPatch(
            (-length / 2, -width / 2),
            length,
            width,
            boxstyle=f"round,pad={0.6 * _RAIL},rounding_size={1.4 * _RAIL}",
            facecolor=FLOOR,
            edgecolor=RAIL,
            lw=4.5,
            zorder=0.1,
        )
    )
    axes.plot(0, 0, "+", color=RAIL, ms=9, mew=1.2, zorder=0.7)


def _nice_step(least: float) -> float:
    """Return 1, 2 or 5 times a power of ten, not below a number."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(next(k * power for k in (1, 2, 5, 10) if k * power >= least * (1 - 1e-9)))


def _multiples(low: float, high: float, step: float) -> Float[np.ndarray, " ticks"]:
    """Return the multiples of a step between two numbers."""
    return step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)


def _draw_panels(figure: Figure, scene: Scene) -> None:
    """Draw the state beside the set point, and the commands, over time."""
    known = np.diff(scene.time, append=np.inf) <= scene.pause
    # A NaN after each stretch breaks the line there.
    rows = np.flatnonzero(~known) + 1
    time = np.insert(scene.time, rows, np.nan)
    pose = np.insert(scene.pose, rows, np.nan, axis=0)
    asked = frames_at(scene, scene.time).reference
    for i, label in enumerate(("x [m]", "y [m]", "yaw [rad]")):
        axes = _panel(figure, scene, i, label)
        axes.plot(time, pose[:, i], color=BLACK, lw=1.4)
        if len(scene.reference):
            axes.plot(scene.time, asked[:, i], color=ASKED, lw=1.3, ls=(0, (4, 1.5)), zorder=1.5)
        axes.set_ylim(axes.get_ylim())
    _draw_motors(_panel(figure, scene, 3, "motor commands [0 … 1]"), scene)


def _panel(figure: Figure, scene: Scene, number: int, label: str) -> Axes:
    """Make one of four panels in a row."""
    total = figure.get_figheight()
    room = (_WIDEST - 3 * _GAP) / 4
    axes = figure.add_axes(
        (
            (_LEFT + number * (room + _GAP)) / _WIDTH,
            _BOTTOM / total,
            room / _WIDTH,
            _PANELS / total,
        )
    )
    axes.set_xlim(scene.start, scene.stop)
    axes.set_xlabel("time [s]", labelpad=1)
    axes.set_title(label, loc="left", fontsize=9, fontweight="normal", pad=4)
    axes.tick_params(length=2, pad=2)
    axes.locator_params(axis="both", nbins=5, steps=[1, 2, 5, 10])
    return axes


def _draw_motors(axes: Axes, scene: Scene) -> None:
    """Draw the commands as rows, the first on top."""
    n = scene.vehicle.n_propellers
    edges = np.append(scene.command_time, scene.stop)
    for i, color in enumerate(propeller_colors(scene.vehicle)):
        row = n - 1 - i
        values = 0.86 * np.append(scene.command[:, i], 0.0)
        axes.fill_between(edges, row, row + values, step="post", color=color, lw=0)
    axes.set_ylim(-0.1, n)
    axes.grid(False)
    names = short_names(scene.vehicle.propeller_names)
    axes.set_yticks(np.arange(n)[::-1] + 0.4, names)
    # Many rows and long names take small letters.
    size = max(min(8.0, 50.0 / n, 48.0 / max(map(len, names))), 4.0)
    axes.tick_params(axis="y", length=0, labelsize=size)
    for text, color in zip(axes.get_yticklabels(), propeller_colors(scene.vehicle), strict=True):
        text.set_color(color)


def _draw_legend(figure: Figure, scene: Scene, table: Axes) -> None:
    """Say what is what, at the scale of the table."""
    box, total = table.get_position(), figure.get_figheight()
    low, high = table.get_xlim()
    height = _LEGEND / total
    axes = figure.add_axes((box.x0, box.y0 - _TICKS / total - height, box.width, height))
    axes.set_axis_off()
    per_inch = (high - low) / (box.width * _WIDTH)
    axes.set(xlim=(0, high - low), ylim=(-_LEGEND / 2 * per_inch, _LEGEND / 2 * per_inch))
    x = _RAIL
    share = np.linspace(0, 1, 13)
    sample = np.stack([x + 0.3 * per_inch * share, np.zeros(13)], axis=1)
    lines = LineCollection(list(np.stack([sample[:-1], sample[1:]], axis=1)), capstyle="round")
    lines.set(color=_blend(BLACK, "white", 1 - 0.75 * share[1:]), linewidth=1 + 1.4 * share[1:])
    axes.add_collection(lines)
    x = _key(axes, x + 0.36 * per_inch, f"path of the last {TRAIL:g} s", per_inch)
    if len(scene.reference):
        ring = Circle((x + 0.1 * per_inch, 0), 0.1 * per_inch, fill=False, edgecolor=ASKED)
        ring.set(lw=1.5, ls=(0, (3, 1.6)))
        axes.add_patch(ring)
        x = _key(axes, x + 0.27 * per_inch, "set point", per_inch)
    key = round_thrust(scene.vehicle)
    length = key * arrow_scale(scene.vehicle)
    arrow = np.array([[[x, 0.0], [x + length, 0.0]]])
    axes.add_patch(Polygon(arrow_shapes(arrow, scene.vehicle.radius_m)[0], color=GREY, lw=0))
    _key(axes, x + length + 0.06 * per_inch, f"commanded thrust of {key:g} N", per_inch)


def _key(axes: Axes, x: float, words: str, per_inch: float) -> float:
    """Write an entry of the legend; return where the next may begin."""
    text = axes.text(x, 0, words, fontsize=8.5, va="center_baseline")
    return x + (text.get_window_extent().width / RESOLUTION + 0.3) * per_inch


def _rgb(color: str) -> tuple[int, int, int]:
    """Return red, green, blue in 0 … 255."""
    red, green, blue = (round(255 * part) for part in to_rgb(color))
    return red, green, blue


def _blend(color: str, ground: str, share: Float[np.ndarray, " S"]) -> list[RGBColorType]:
    """Mix a colour with what is behind it; opaque, so that overlapping ends do not show."""
    share = np.clip(share, 0, 1)[:, None]
    mixed = (1 - share) * np.array(to_rgb(color)) + share * np.array(to_rgb(ground))
    return [(red, green, blue) for red, green, blue in mixed.tolist()]
