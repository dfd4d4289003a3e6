"""Data for `packaged/table_canvas.js`, and an animation as one self-contained page."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from airpuck.boundary.outputs import packaged_text, rendered
from airpuck.craft.table import AirHockey
from airpuck.craft.vehicle import Vehicle
from airpuck.report import scene as moments
from airpuck.report import style
from airpuck.report.scene import PAUSE, DiscPath, FlightScene, GameScene, PlannedPath

#: Colours of the canvas on light and on dark pages; there the craft stays white and the puck is
#: yellow.
_COLORS: dict[str, tuple[str, str]] = {
    "ink": (style.BLACK, "#e8ecf0"),
    "grey": (style.GREY, "#a3adb7"),
    "asked": (style.ASKED, "#ea9ccb"),
    "floor": (style.FLOOR, "#1c2329"),
    "holes": (style.HOLES, "#36414b"),
    "grid": (style.GRID, "#2c353e"),
    "rail": (style.RAIL, "#5d6a76"),
    "left": (style.BLUE, "#2b8fd6"),
    "right": (style.VERMILLION, "#e8722a"),
    "puck": (style.BLACK, "#f0e442"),
    "mark": ("#ffffff", "#12161b"),
    "craft": (style.BLACK, "#84919d"),
}


def color_scheme(name: Literal["light", "dark"]) -> dict[str, Any]:
    """Return the colours of a scheme; ink and floor also as red, green and blue, from 0 to 255."""
    colors = {key: dark if name == "dark" else light for key, (light, dark) in _COLORS.items()}
    return colors | {f"{key}Rgb": [*bytes.fromhex(colors[key][1:])] for key in ("ink", "floor")}


def craft_shape(vehicle: Vehicle) -> dict[str, Any]:
    """Return the shape of the craft and its arrows for the script."""
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
    """Return the width of the goals and the radii of puck and mallet [m] for the script."""
    table = play.table
    return {
        "goal": min(table.goal_width_m, table.width_m),
        "puck": play.puck.radius_m,
        "mallet": play.mallet.radius_m,
    }


#: Resolution of stored numbers, finer than a pixel [s, m, rad, –].
_UNITS = {"time": 1e-4, "length": 1e-4, "angle": 1e-4, "command": 1e-3}
#: Playback speeds on offer.
_PACES = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


def write_animation_page(scene: FlightScene, path: Path, *, speed: float) -> None:
    """Write a self-contained HTML page."""
    import markupsafe

    x0, x1, y0, y1 = scene.view
    flight = json.dumps(flight_data(scene), separators=(",", ":"), allow_nan=False)
    page = rendered(
        "animation.html.jinja",
        craft=scene.vehicle.name,
        recording=scene.name,
        colors=color_scheme("light"),
        aspect=f"{(x1 - x0 + (0.14 if scene.game is None else 0.26)) / (y1 - y0 + 0.13):.4f}",
        motors_height=f"{2.4 + max(5.4, 1.1 * scene.vehicle.n_propellers):.2f}",
        paces=sorted({*_PACES, float(speed)}),
        speed=float(speed),
        trail=moments.TRAIL,
        key=moments.round_thrust(scene.vehicle),
        has_reference=len(scene.reference) > 0,
        is_game=scene.game is not None and len(scene.game.score_time) > 0,
        plans={style.BOUND_WORDS[k]: style.BOUND_COLORS[k] for k in style.BOUND_WORDS}
        if scene.plans
        else {},
        states=style.POSE,
        table_canvas=markupsafe.Markup(packaged_text("table_canvas.js")),
        # Only "<" could end the script element; the escape means the same in a JSON string.
        flight=markupsafe.Markup(flight.replace("<", "\\u003c")),
    )
    path.write_text(page, encoding="utf-8")


def flight_data(scene: FlightScene) -> dict[str, Any]:
    """Return a flight in the form that the page's script expects."""
    shown = moments.thinned(scene)
    return {
        "start": round(scene.start, 6),
        "stop": round(scene.stop, 6),
        "units": _UNITS,
        "pose": _poses(shown.time, shown.pose),
        "pause": scene.pause + _UNITS["time"],
        "command": {
            "time": _changes(scene.command_time, "time"),
            "motors": [_changes(motor, "command") for motor in scene.command.T],
        },
        "commandPause": scene.command_pause if math.isfinite(scene.command_pause) else None,
        "reference": _poses(scene.reference_time, scene.reference),
        "plans": [_plan(plan) for plan in scene.plans],
        "planLasts": moments.PLAN_LASTS,
        "table": scene.table,
        "view": scene.view,
        "trail": moments.TRAIL,
        "craft": craft_shape(scene.vehicle),
        "colors": color_scheme("light"),
        "hockey": scene.game and hockey_shape(scene.game.play),
        "game": scene.game and _game(scene.game),
    }


def _game(game: GameScene) -> dict[str, Any]:
    """Return a game in the form that the page's script expects."""
    other = game.other
    return {
        "puck": _poses(*_sparse(game.puck)),
        "pause": PAUSE,
        "other": other and _poses(*_sparse(other)),
        "otherFlies": game.other_flies,
        "side": game.side,
        "score": {
            "time": game.score_time.round(3).tolist(),
            "goals": game.score.astype(int).tolist(),
        },
    }


def _sparse(way: DiscPath) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, "M 3"]]:
    """Return every second pose, and all poses next to a gap."""
    gap = np.diff(way.time) > PAUSE
    kept = np.arange(len(way.time)) % 2 == 0
    kept |= np.append(gap, True) | np.insert(gap, 0, True)
    return way.time[kept], way.pose[kept]


def _poses(time: Float[np.ndarray, " N"], pose: Float[np.ndarray, "N 3"]) -> dict[str, list[int]]:
    """Encode times and poses as differences."""
    return {
        "time": _changes(time, "time"),
        "x": _changes(pose[:, 0], "length"),
        "y": _changes(pose[:, 1], "length"),
        "yaw": _changes(pose[:, 2], "angle"),
    }


def _plan(plan: PlannedPath) -> dict[str, Any]:
    """Encode the time, positions and colour of a plan."""
    x, y = plan.points.T
    ways = {"x": _changes(x, "length"), "y": _changes(y, "length")}
    return {"time": round(plan.time, 4), **ways, "color": style.BOUND_COLORS[plan.bound]}


def _changes(values: Float[np.ndarray, " N"], unit: str) -> list[int]:
    """Encode numbers as differences of rounded multiples, so rounding errors do not add up."""
    return np.diff(np.rint(values / _UNITS[unit]).astype(np.int64), prepend=0).tolist()
