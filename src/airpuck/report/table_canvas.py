"""What `packaged/table_canvas.js` is given: colours, the shape of a craft, goals and discs."""

from __future__ import annotations

from typing import Any

from matplotlib.colors import to_rgb

from airpuck.craft.table import AirHockey
from airpuck.craft.vehicle import Vehicle
from airpuck.report import animation_frames as moments
from airpuck.report import style

COLORS: dict[str, Any] = {
    "ink": style.BLACK,
    "grey": style.GREY,
    "asked": style.ASKED,
    "floor": style.FLOOR,
    "holes": style.HOLES,
    "grid": style.GRID,
    "rail": style.RAIL,
    "left": style.BLUE,
    "right": style.VERMILLION,
    "puck": style.BLACK,
    "inkRgb": [round(255 * part) for part in to_rgb(style.BLACK)],
    "floorRgb": [round(255 * part) for part in to_rgb(style.FLOOR)],
}


def craft_shape(vehicle: Vehicle) -> dict[str, Any]:
    """Return the shape of the craft and of its arrows, as JSON values."""
    return {
        "radius": vehicle.radius_m,
        "positions": vehicle.positions.tolist(),
        "directions": vehicle.directions.tolist(),
        "thrust": vehicle.nominal_thrust.tolist(),
        "names": moments.short_names(vehicle.propeller_names),
        "colors": style.propeller_colors(vehicle),
        "propeller": style.propeller_size(vehicle),
        "mark": moments.heading_mark(vehicle).tolist(),
        "key": moments.round_thrust(vehicle),
        "arrow": {
            "scale": moments.arrow_scale(vehicle),
            "shaft": moments.SHAFT,
            "headWidth": moments.HEAD_WIDTH,
            "headLength": moments.HEAD_LENGTH,
        },
    }


def hockey_shape(play: AirHockey) -> dict[str, float]:
    """Return the width of the goals and the radii of puck and mallet [m], as JSON values."""
    table = play.table
    return {
        "goal": min(table.goal_width_m, table.width_m),
        "puck": play.puck.radius_m,
        "mallet": play.mallet.radius_m,
    }
