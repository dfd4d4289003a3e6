"""Pictures of a craft: the layout of its propellers, and the frames that its motion is told in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Circle, FancyArrowPatch, Rectangle

from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle
from airpuck.physics.angle import wrapped
from airpuck.report.style import (
    BLACK,
    GREY,
    VERMILLION,
    new_figure,
    no_axes,
    propeller_colors,
    styled,
)

#: Propellers whose radii or half-angles agree this well get one common annotation [m, rad].
_SAME_RADIUS, _SAME_ANGLE = 1e-4, 2e-3
#: Propellers farther apart than twice this are partners, but no pair side by side [rad].
_WIDEST_HALF_ANGLE = 1.0


@styled
def craft_figure(vehicle: Vehicle) -> Figure:
    """Draw the propeller layout to scale.

    Shows the disc from above, each propeller with its name, where its thrust pushes the craft and
    which way that turns it, pairs in one colour, and the body frame. Where the layout is regular,
    the common radius and half-angle are given.
    """
    figure = new_figure(5.4, 5.2)
    axes = figure.add_subplot()
    axes.set_aspect("equal")
    axes.grid(False)
    disc = 1e3 * vehicle.radius_m
    axes.add_patch(Circle((0, 0), disc, facecolor="#f5f5f5", edgecolor=GREY, lw=1.0))
    _draw_propellers(axes, vehicle)
    _draw_geometry(axes, vehicle)
    # The frame must fit between the centre and the innermost propeller.
    axis = min(
        0.3 * disc, 0.65 * max(1e3 * _radii(vehicle).min() - _disc_size(vehicle), 0.2 * disc)
    )
    for (x, y), name in (((1, 0), "$x^b$"), ((0, 1), "$y^b$")):
        _arrow(axes, (0, 0), (axis * x, axis * y), BLACK, 1.4)
        _note(axes, (1.28 * axis * x, 1.25 * axis * y), name, fontsize=10)
    axes.plot(0, 0, "o", color=BLACK, ms=3)
    reach = 1.5 * max(disc, 1e3 * float(_radii(vehicle).max()))
    axes.set(
        xlim=(-reach, reach),
        ylim=(-reach, reach),
        xlabel="$x^b$, forward [mm]",
        ylabel="$y^b$, left [mm]",
        title=f"{vehicle.name}: {vehicle.n_propellers} propellers, "
        f"{1e3 * vehicle.mass_kg:.4g} g, seen from above",
    )
    return figure


def _draw_propellers(axes: Axes, vehicle: Vehicle) -> None:
    """Draw each propeller with its name, its thrust and the sense of its moment."""
    positions, colors = 1e3 * vehicle.positions, propeller_colors(vehicle)
    disc = 1e3 * vehicle.radius_m
    size = _disc_size(vehicle)
    length = min(
        1.6 * size, 0.42 * _closest(positions)
    )  # arrows of opposing propellers must not meet
    for name, (x, y), (dx, dy), color in zip(
        vehicle.propeller_names, positions, vehicle.directions, colors, strict=True
    ):
        axes.add_patch(Circle((x, y), size, facecolor=color, alpha=0.22, edgecolor="none"))
        axes.add_patch(Circle((x, y), size, fill=False, edgecolor=color, lw=1.0))
        _arrow(axes, (x, y), (x + length * dx, y + length * dy), color, 2.0)
        axes.plot(x, y, "o", color=color, ms=3.5)
        moment = x * dy - y * dx
        turn = "" if abs(moment) < 1e-3 * disc else (" ↺" if moment > 0 else " ↻")
        radius = max(np.hypot(x, y), 1e-9)
        out = (max(1.06 * disc, radius + 1.3 * size)) / radius
        axes.text(
            x * out,
            y * out,
            name + turn,
            color=color,
            fontsize=9,
            ha="left" if x > 0.1 * disc else "right" if x < -0.1 * disc else "center",
            va="bottom" if y > 0.35 * disc else "top" if y < -0.35 * disc else "center",
        )


def _draw_geometry(axes: Axes, vehicle: Vehicle) -> None:
    """Annotate the radius of the propellers and the half-angle of the pairs, where regular."""
    radii = _radii(vehicle)
    notes = []
    if np.ptp(radii) < _SAME_RADIUS and radii[0] > 0:
        d = 1e3 * float(radii.mean())
        axes.add_patch(Circle((0, 0), d, fill=False, edgecolor=GREY, lw=0.7, ls=(0, (4, 3))))
        notes.append(f"$d$ = {d:.2f} mm")
    half = _half_angles(vehicle)
    if len(half) and np.ptp(half) < _SAME_ANGLE and half[0] < _WIDEST_HALF_ANGLE:
        delta = float(half.mean())
        _draw_half_angle(axes, vehicle, delta)
        notes.append(f"δ = {np.degrees(delta):.1f}°")
    if notes:
        axes.text(0.02, 0.98, "\n".join(notes), transform=axes.transAxes, va="top", ha="left")
    axes.text(
        0.98,
        0.02,
        "arrow: force on the craft; ↺ ↻: which way it turns it",
        transform=axes.transAxes,
        va="bottom",
        ha="right",
        fontsize=8,
        color=GREY,
    )


def _draw_half_angle(axes: Axes, vehicle: Vehicle, delta: float) -> None:
    """Draw the half-angle δ of the pair that lies farthest from the drawn axes."""
    angles = np.arctan2(vehicle.positions[:, 1], vehicle.positions[:, 0])
    pairs = np.array(vehicle.pair_indices)
    middles = np.angle(np.exp(1j * angles[pairs]).sum(axis=1))
    from_axes = np.minimum(np.abs(middles), np.abs(middles - np.pi / 2))
    middle = float(middles[from_axes.argmax()])
    near = 1e3 * float(_radii(vehicle).min())
    for angle in (middle - delta, middle, middle + delta):
        x, y = near * np.cos(angle), near * np.sin(angle)
        axes.plot([0, x], [0, y], color=GREY, lw=0.8, ls=(0, (1, 2)))
    for low in (middle - delta, middle):
        span = {"theta1": float(np.degrees(low)), "theta2": float(np.degrees(low + delta))}
        axes.add_patch(Arc((0, 0), 1.1 * near, 1.1 * near, **span, color=GREY))
        x, y = 0.66 * near * np.cos(low + delta / 2), 0.66 * near * np.sin(low + delta / 2)
        axes.text(x, y, "δ", ha="center", va="center")


def _half_angles(vehicle: Vehicle) -> Float[np.ndarray, " pairs"]:
    """Return half the angle between the two propellers of each pair, seen from the centre [rad]."""
    angles = np.arctan2(vehicle.positions[:, 1], vehicle.positions[:, 0])
    pairs = np.array(vehicle.pair_indices, dtype=int).reshape(-1, 2)
    apart = angles[pairs[:, 1]] - angles[pairs[:, 0]]
    return np.abs(wrapped(np, apart)) / 2


def _closest(positions: Float[np.ndarray, "n 2"]) -> float:
    """Return the smallest distance between two propellers; infinite for one."""
    apart = np.hypot(*(positions[:, None] - positions[None]).T)
    return float((apart + np.diag(np.full(len(positions), np.inf))).min())


def _radii(vehicle: Vehicle) -> Float[np.ndarray, " n"]:
    """Return how far each propeller is from the centre [m]."""
    return np.hypot(*vehicle.positions.T)


def _disc_size(vehicle: Vehicle) -> float:
    """Return the radius that propellers are drawn with: they must not overlap [mm]."""
    return min(160 * vehicle.radius_m, 0.42 * _closest(1e3 * vehicle.positions))


@styled
def frames_figure(
    vehicle: Vehicle,
    *,
    yaw: float = 0.6,
    angle_offset: float = 0.22,
    table: Table | None = None,
) -> Figure:
    """Draw the frames and the parameters that connect them; angles and offsets exaggerated.

    Shows the table with the world frame, the craft at a position p with its yaw γ, and, enlarged,
    how the propeller layout is turned by α against the body frame and where the centre of mass
    lies, at r from the geometric centre.
    """
    figure = new_figure(8.6, 3.5)
    left, right = figure.subplots(1, 2, width_ratios=(1.75, 1))
    _draw_table(left, vehicle, yaw, table or Table())
    _draw_offsets(right, vehicle, angle_offset)
    return figure


def _draw_table(axes: Axes, vehicle: Vehicle, yaw: float, table: Table) -> None:
    """Draw the table, the world frame and the craft in it, enlarged."""
    no_axes(axes)
    length, width = table.length_m, table.width_m
    axes.add_patch(
        Rectangle((-length / 2, -width / 2), length, width, facecolor="#fafafa", edgecolor=GREY)
    )
    axes.text(
        length / 2,
        -0.53 * width,
        "craft not to scale",
        ha="right",
        va="top",
        color=GREY,
        fontsize=8,
    )
    origin = np.array([-0.32 * length, -0.3 * width])
    axis = 0.28 * width
    for unit, name in (((1.0, 0.0), "$x^w$"), ((0.0, 1.0), "$y^w$")):
        tip = axis * np.array(unit)
        _arrow(axes, origin, origin + tip, BLACK, 1.6)
        _note(axes, origin + 1.2 * tip, name, fontsize=11)
    _note(axes, origin - 0.03 * width, "world", ha="right", va="top")
    p = np.array([0.16 * length, 0.02 * width])
    _arrow(axes, origin, p, GREY, 1.0)
    middle = origin + 0.4 * (p - origin)
    axes.text(middle[0], middle[1] + 0.03, "$(p_x, p_y)$", ha="right", va="bottom", color=GREY)
    radius = 0.24 * width
    scale = radius / vehicle.radius_m
    axes.add_patch(Circle(tuple(p), radius, facecolor="#eef4f8", edgecolor=GREY))
    turned = _rotation(yaw)
    colors = propeller_colors(vehicle)
    axes.scatter(*(p + scale * vehicle.positions @ turned.T).T, s=26, c=colors, zorder=4)
    for unit, name in (((1.0, 0.0), "$x^b$"), ((0.0, 1.0), "$y^b$")):
        tip = turned @ np.array(unit) * 0.42 * width
        _arrow(axes, p, p + tip, VERMILLION, 1.6)
        _note(axes, p + 1.14 * tip, name, color=VERMILLION, fontsize=11)
    reach = 0.5 * width
    axes.plot([p[0], p[0] + reach], [p[1], p[1]], color=GREY, lw=0.8, ls=(0, (4, 3)))
    span = {"theta1": 0.0, "theta2": float(np.degrees(yaw))}
    axes.add_patch(Arc(tuple(p), 0.68 * width, 0.68 * width, **span, color=BLACK))
    half = 0.385 * width * np.array([np.cos(yaw / 2), np.sin(yaw / 2)])
    _note(axes, p + half, "γ", fontsize=11)
    axes.set(xlim=(-0.51 * length, 0.51 * length), ylim=(-0.62 * width, 0.53 * width))
    axes.set_title("World and body frame")


def _draw_offsets(axes: Axes, vehicle: Vehicle, angle_offset: float) -> None:
    """Draw the layout turned by α, and the centre of mass beside the geometric centre."""
    no_axes(axes)
    r = vehicle.radius_m
    axes.add_patch(Circle((0, 0), r, facecolor="#f5f5f5", edgecolor=GREY))
    nominal, turned = vehicle.positions, vehicle.positions @ _rotation(angle_offset).T
    colors = propeller_colors(vehicle)
    axes.scatter(*nominal.T, s=38, facecolors="white", edgecolors=GREY, lw=1.0, zorder=3)
    axes.scatter(*turned.T, s=38, c=colors, zorder=4)
    for tip, name, color in (((1, 0), "$x^b$", BLACK), ((0, 1), "$y^b$", BLACK)):
        _arrow(axes, (0, 0), (1.3 * r * tip[0], 1.3 * r * tip[1]), color, 1.4)
        axes.text(1.42 * r * tip[0], 1.42 * r * tip[1], name, fontsize=11)
    layout = _rotation(angle_offset) @ np.array([1.25 * r, 0.0])
    axes.plot([0, layout[0]], [0, layout[1]], color=GREY, lw=0.9, ls=(0, (4, 3)))
    axes.add_patch(
        Arc((0, 0), 2.3 * r, 2.3 * r, theta1=0, theta2=float(np.degrees(angle_offset)), color=BLACK)
    )
    half = 1.24 * r * np.array([np.cos(angle_offset / 2), np.sin(angle_offset / 2)])
    _note(axes, half, "α", fontsize=11)
    mass = np.array([-0.22, -0.16]) * r
    _arrow(axes, (0, 0), (float(mass[0]), float(mass[1])), VERMILLION, 1.6)
    axes.text(
        mass[0] - 0.08 * r, mass[1] - 0.08 * r, "$r^{CoM}$", color=VERMILLION, ha="right", va="top"
    )
    axes.plot(0, 0, "o", color=BLACK, ms=4)
    axes.set(xlim=(-1.25 * r, 1.6 * r), ylim=(-1.45 * r, 1.6 * r))
    axes.set_title("Offsets that are learned (exaggerated)")
    handles = [
        Line2D([], [], marker="o", ls="", color=BLACK, label="propellers, turned by α"),
        Line2D([], [], marker="o", ls="", mfc="white", mec=GREY, label="as in the vehicle file"),
    ]
    axes.legend(handles=handles, loc="lower center", ncols=2, handletextpad=0.2)


def _rotation(angle: float) -> Float[np.ndarray, "2 2"]:
    """Return the matrix that turns vectors counter-clockwise."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])


def _note(axes: Axes, at: Sequence[float] | np.ndarray, text: str, **style: Any) -> None:
    """Write a text at a point, centred unless the style says otherwise."""
    placed: dict[str, Any] = {"ha": "center", "va": "center"} | style
    axes.text(float(at[0]), float(at[1]), text, **placed)


def _arrow(
    axes: Axes,
    start: Sequence[float] | np.ndarray,
    end: Sequence[float] | np.ndarray,
    color: str,
    width: float,
) -> None:
    """Draw an arrow from one point to another."""
    axes.add_patch(
        FancyArrowPatch(
            (float(start[0]), float(start[1])),
            (float(end[0]), float(end[1])),
            arrowstyle="-|>",
            mutation_scale=5 + 4 * width,
            shrinkA=0,
            shrinkB=0,
            color=color,
            lw=width,
            zorder=5,
        )
    )
