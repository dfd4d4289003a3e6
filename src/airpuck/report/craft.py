"""The craft: propeller layout and frames."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Wedge

from airpuck.boundary.outputs import packaged_text
from airpuck.craft.vehicle import Vehicle
from airpuck.physics.rigid_body import wrapped
from airpuck.report import style
from airpuck.report.page import PageSection, Picture

#: Largest spread of radii or half-angles that share one annotation [m, rad].
_SAME_RADIUS, _SAME_ANGLE = 1e-4, 2e-3
#: Mass from which it is stated in kilograms [kg].
_GRAMS_BELOW_KG = 1.0
#: Largest half-angle between neighbouring partners [rad].
_WIDEST_HALF_ANGLE = 1.0


def actuator_words(vehicle: Vehicle) -> str:
    """Count the actuators: ``6 propellers``, ``8 on/off thrusters``, ``3 propellers, 1 wheel``."""
    actuation = vehicle.actuation
    noun = "on/off thruster" if "on_off" in actuation.kinds else "propeller"
    counts = (len(vehicle.propellers), noun), (len(actuation.wheels), "wheel")
    return ", ".join(f"{n} {noun}{'' if n == 1 else 's'}" for n, noun in counts if n)


def craft_section(vehicle: Vehicle) -> PageSection:
    """Show the craft and its frames."""
    layout = (
        "Propeller layout, to scale, seen from above. Arrows show the force of each propeller on "
        "the craft, ↺ and ↻ the direction of its moment. "
    )
    paired = 2 * len(vehicle.pairs)
    if paired:
        layout += "The two propellers of a pair share a colour and push in opposite directions. "
    if paired < vehicle.n_propellers:
        layout += "Each unpaired propeller has its own colour. "
    layout += "These values come from the vehicle file; they are measured, not learned."
    frames = (
        "Schematic, independent of the propeller layout. Left: position p and yaw γ of the body "
        "frame in the world frame. Right, exaggerated: rotation α of the layout relative to the "
        "measured yaw, and offset r of the centre of mass from the geometric centre."
    )
    pictures = (
        Picture("craft", craft_figure(vehicle), layout),
        Picture("frames", packaged_text("frames.svg"), frames),
    )
    return PageSection("craft", "The craft", pictures)


@style.styled
def craft_figure(vehicle: Vehicle) -> Figure:
    """Draw the propeller layout to scale.

    Shows the disc from above, the body frame, and the name, force and moment of each propeller;
    the two of a pair share a colour. A regular layout is annotated with its radius and half-angle.
    """
    figure = style.new_figure(5.4, 5.2)
    axes = figure.add_subplot()
    axes.grid(False)
    disc = 1e3 * vehicle.radius_m
    axes.add_patch(Circle((0, 0), disc, facecolor="#f5f5f5", edgecolor=style.GREY, lw=1.0))
    _draw_propellers(axes, vehicle)
    _draw_geometry(axes, vehicle)
    # The axes must fit between the centre and the innermost propeller.
    radii = 1e3 * np.hypot(*vehicle.positions.T)
    inside = radii.min() - 1e3 * style.propeller_size(vehicle)
    axis = min(0.3 * disc, 0.65 * max(inside, 0.2 * disc))
    for (x, y), name in (((axis, 0), "$x^b$"), ((0, axis), "$y^b$")):
        style.draw_arrow(axes, (0, 0), (x, y), lw=1.4, arrowstyle="-|>", mutation_scale=10.6)
        axes.text(1.28 * x, 1.25 * y, name, fontsize=10, ha="center", va="center")
    _draw_center_of_mass(axes, 0.05 * disc)
    reach = 1.5 * max(disc, float(radii.max()))
    axes.set(xlim=(-reach, reach), xlabel="$x^b$, forward [mm]")
    axes.set(ylim=(-reach, reach), ylabel="$y^b$, left [mm]", aspect="equal")
    mass = vehicle.mass_kg
    weight = f"{1e3 * mass:.4g} g" if mass < _GRAMS_BELOW_KG else f"{mass:.4g} kg"
    axes.set_title(f"{vehicle.name}: {actuator_words(vehicle)}, {weight}, seen from above")
    return figure


def _draw_propellers(axes: Axes, vehicle: Vehicle) -> None:
    """Draw each propeller with its name, force and direction of moment."""
    positions, colors = 1e3 * vehicle.positions, style.propeller_colors(vehicle)
    disc = 1e3 * vehicle.radius_m
    size = 1e3 * style.propeller_size(vehicle)
    # Arrows of opposing propellers must not meet.
    length = min(1.6 * size, 420 * style.closest_propellers(vehicle))
    for number, (name, (x, y), (dx, dy), color) in enumerate(
        zip(vehicle.propeller_names, positions, vehicle.directions, colors, strict=True), start=1
    ):
        axes.add_patch(Circle((x, y), size, facecolor=(color, 0.22), edgecolor=color, lw=1.0))
        tip = (x + length * dx, y + length * dy)
        look = {"arrowstyle": "-|>", "mutation_scale": 13}
        style.draw_arrow(axes, (x, y), tip, lw=2.0, color=color, **look)
        axes.plot(x, y, "o", color=color, ms=3.5)
        moment = x * dy - y * dx
        turn = "" if abs(moment) < 1e-3 * disc else (" ↺" if moment > 0 else " ↻")
        radius = max(np.hypot(x, y), 1e-9)
        out = (max(1.06 * disc, radius + 1.3 * size)) / radius
        ha = "left" if x > 0.1 * disc else "right" if x < -0.1 * disc else "center"
        va = "bottom" if y > 0.35 * disc else "top" if y < -0.35 * disc else "center"
        axes.text(x * out, y * out, f"{number} {name}{turn}", color=color, fontsize=9, ha=ha, va=va)


def _draw_center_of_mass(axes: Axes, size: float) -> None:
    """Draw the symbol of the centre of mass at the centre, its place in a vehicle file."""
    axes.add_patch(Circle((0, 0), size, facecolor="white", edgecolor=style.BLACK, lw=0.8))
    for first in (0, 180):
        axes.add_patch(Wedge((0, 0), size, first, first + 90, facecolor=style.BLACK, lw=0))


def _draw_geometry(axes: Axes, vehicle: Vehicle) -> None:
    """Annotate the radius of the propellers and the half-angle of the pairs, if regular."""
    radii = np.hypot(*vehicle.positions.T)
    notes = [f"solid: radius {1e3 * vehicle.radius_m:.4g} mm"]
    if np.ptp(radii) < _SAME_RADIUS and radii[0] > 0:
        radius = 1e3 * float(radii.mean())
        line = {"edgecolor": style.GREY, "lw": 0.7, "ls": (0, (4, 3))}
        axes.add_patch(Circle((0, 0), radius, fill=False, **line))
        notes.append(f"dashed: radius {radius:.2f} mm")
    pairs = np.array(vehicle.pair_indices, dtype=int).reshape(-1, 2)
    angles = np.arctan2(vehicle.positions[:, 1], vehicle.positions[:, 0])[pairs]
    half = np.abs(wrapped(np, angles[:, 1] - angles[:, 0])) / 2
    if len(half) and np.ptp(half) < _SAME_ANGLE and half[0] < _WIDEST_HALF_ANGLE:
        delta = float(half.mean())
        _draw_half_angle(axes, angles, delta, 1e3 * float(radii.min()))
        notes.append(f"δ = {np.degrees(delta):.1f}°")
    axes.text(0.02, 0.98, "\n".join(notes), transform=axes.transAxes, va="top", ha="left")
    words = "arrow: force on the craft; ↺ ↻: direction of moment;\nquartered disc: centre of mass"
    small = {"fontsize": 8, "color": style.GREY, "transform": axes.transAxes}
    axes.text(0.98, 0.02, words, va="bottom", ha="right", **small)


def _draw_half_angle(
    axes: Axes, angles: Float[np.ndarray, "pairs 2"], delta: float, near: float
) -> None:
    """Draw the half-angle δ of the pair farthest from the axes, out to `near` [mm]."""
    middles = np.angle(np.exp(1j * angles).sum(axis=1))
    from_axes = np.minimum(np.abs(middles), np.abs(middles - np.pi / 2))
    middle = float(middles[from_axes.argmax()])
    for angle in (middle - delta, middle, middle + delta):
        x, y = near * np.cos(angle), near * np.sin(angle)
        axes.plot([0, x], [0, y], color=style.GREY, lw=0.8, ls=(0, (1, 2)))
    for low in (middle - delta, middle):
        span = {"theta1": float(np.degrees(low)), "theta2": float(np.degrees(low + delta))}
        axes.add_patch(Arc((0, 0), 1.1 * near, 1.1 * near, **span, color=style.GREY))
        x, y = 0.66 * near * np.cos(low + delta / 2), 0.66 * near * np.sin(low + delta / 2)
        axes.text(x, y, "δ", ha="center", va="center")
