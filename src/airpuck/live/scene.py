"""The table in the browser: what is drawn, and the handle of the set point; viser's part."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from airpuck.craft.table import Table
from airpuck.live.marker import SetPointMarker, turned
from airpuck.model.model_file import Model
from airpuck.physics.thrust import thrust

if TYPE_CHECKING:
    import viser

#: Colours that the colour-blind can tell apart (Okabe and Ito), one for each pair of propellers.
_PAIRS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0))
_TABLE, _RAIL, _CRAFT, _NOSE, _TRAIL = (
    (236, 239, 241),
    (84, 98, 111),
    (120, 130, 140),
    (40, 40, 40),
    (20, 110, 190),
)
#: Where the page's camera is at first, what it looks at [m], and its vertical field of view [rad].
EYE, LOOKS_AT, FIELD_OF_VIEW = (0.0, -1.75, 2.25), (0.0, -0.03, 0.0), math.radians(40)
#: Sizes [m]; an arrow's length for a newton of thrust [m/N].
_THICK, _RAIL_HEIGHT, _RAIL_WIDTH, _PROPELLER, _PER_NEWTON = 0.02, 0.03, 0.03, 0.014, 0.8
#: Points of the trail, and the least distance between them [m].
_TRAIL_POINTS, _TRAIL_STEP = 200, 0.005


class Scene:
    """Table, craft, trail, thrusts and set point on a viser page."""

    def __init__(
        self,
        server: viser.ViserServer,
        model: Model,
        table: Table,
        wish: Callable[[float, float, float], Any],
    ) -> None:
        self._model, self._scene = model, server.scene
        self._trail: deque[np.ndarray] = deque(maxlen=_TRAIL_POINTS)
        server.initial_camera.position = EYE
        server.initial_camera.look_at = LOOKS_AT
        server.initial_camera.fov = FIELD_OF_VIEW
        # viser's default surroundings would be fetched from elsewhere.
        self._scene.configure_environment_map(None)
        # Shadows would cost a browser without a graphics card most of its time.
        self._scene.configure_default_lights(cast_shadow=False)
        self._scene.add_light_hemisphere("/light", intensity=1.5)
        self._draw_table(table)
        self._craft = self._scene.add_frame("/craft", show_axes=False, visible=False)
        self._draw_craft()
        n = model.vehicle.n_propellers
        self._colors = np.array([_PAIRS[k % len(_PAIRS)] for k in self._pair_of()], np.uint8)
        self._arrows = self._scene.add_arrows(
            "/craft/thrusts",
            np.zeros((n, 2, 3)),
            self._colors,
            shaft_radius=0.006,
            head_radius=0.014,
            head_length=0.024,
        )
        points = np.zeros((_TRAIL_POINTS - 1, 2, 3))
        # The trail fades into the table.
        fade = np.linspace(_TABLE, _TRAIL, _TRAIL_POINTS)
        self._line = self._scene.add_line_segments(
            "/trail",
            points,
            np.stack([fade[:-1], fade[1:]], axis=1).astype(np.uint8),
            thickness=3.0,
            thickness_units="screen",
        )
        self._marker = SetPointMarker(self._scene, model.vehicle.radius_m, wish)

    def add_pose(self, pose: Float[np.ndarray, " 3"]) -> None:
        """Lengthen the trail."""
        point = np.array([pose[0], pose[1], 0.004])
        if not self._trail or np.hypot(*(point - self._trail[-1])[:2]) > _TRAIL_STEP:
            self._trail.append(point)

    def show(
        self,
        pose: Float[np.ndarray, " 3"],
        command: Float[np.ndarray, " n"] | None,
    ) -> None:
        """Move the craft."""
        self._craft.position = (float(pose[0]), float(pose[1]), 0.0)
        self._craft.wxyz = turned(float(pose[2]))
        self._craft.visible = True
        vehicle = self._model.vehicle
        forces = np.zeros(vehicle.n_propellers)
        if command is not None:
            forces = thrust(self._model.dynamics.thrust, np.clip(command, 0.0, 1.0))
        begin = np.column_stack([vehicle.positions, np.full(len(forces), _THICK + 0.012)])
        # An arrow of no length has no direction.
        lengths = np.maximum(_PER_NEWTON * forces, 1e-3)[:, None]
        along = np.column_stack([vehicle.directions, np.zeros(len(forces))])
        self._arrows.points = np.stack([begin, begin + lengths * along], axis=1).astype(np.float32)
        if len(self._trail) > 1:
            trail = np.array(self._trail)
            filled = np.vstack([np.repeat(trail[:1], _TRAIL_POINTS - len(trail), axis=0), trail])
            self._line.points = np.stack([filled[:-1], filled[1:]], axis=1).astype(np.float32)

    def show_set_point(self, pose: Float[np.ndarray, " k"]) -> None:
        """Move the set point."""
        self._marker.show(pose)

    def _draw_table(self, table: Table) -> None:
        """Draw table and rails."""
        length, width = table.length_m, table.width_m
        self._scene.add_box("/table", _TABLE, (length, width, _THICK), position=(0, 0, -_THICK / 2))
        long, short = length + 2 * _RAIL_WIDTH, width
        x, y, z = (length + _RAIL_WIDTH) / 2, (width + _RAIL_WIDTH) / 2, _RAIL_HEIGHT / 2
        for name, size, at in (
            ("left", (_RAIL_WIDTH, short, _RAIL_HEIGHT), (-x, 0, z)),
            ("right", (_RAIL_WIDTH, short, _RAIL_HEIGHT), (x, 0, z)),
            ("near", (long, _RAIL_WIDTH, _RAIL_HEIGHT), (0, -y, z)),
            ("far", (long, _RAIL_WIDTH, _RAIL_HEIGHT), (0, y, z)),
        ):
            self._scene.add_box(f"/rails/{name}", _RAIL, size, position=at)
        self._scene.add_frame("/origin", axes_length=0.1, axes_radius=0.003)
        for axis, at in (("x", (0.12, 0, 0)), ("y", (0, 0.12, 0))):
            self._scene.add_label(f"/origin/{axis}", axis, position=at, anchor="center-center")

    def _draw_craft(self) -> None:
        """Draw a disc with its propellers and its nose."""
        vehicle = self._model.vehicle
        self._scene.add_cylinder(
            "/craft/disc", vehicle.radius_m, _THICK, _CRAFT, position=(0, 0, _THICK / 2)
        )
        self._scene.add_box(
            "/craft/nose",
            _NOSE,
            (0.4 * vehicle.radius_m, 0.008, 0.006),
            position=(0.8 * vehicle.radius_m, 0, _THICK + 0.003),
        )
        for name, at, pair in zip(
            vehicle.propeller_names, vehicle.positions, self._pair_of(), strict=True
        ):
            self._scene.add_cylinder(
                f"/craft/{name}",
                _PROPELLER,
                0.012,
                _PAIRS[pair % len(_PAIRS)],
                position=(float(at[0]), float(at[1]), _THICK + 0.006),
            )

    def _pair_of(self) -> list[int]:
        """Return the pair of each propeller; those without one have a number of their own."""
        vehicle = self._model.vehicle
        pairs = {i: k for k, pair in enumerate(vehicle.pair_indices) for i in pair}
        return [pairs.get(i, len(vehicle.pair_indices) + i) for i in range(vehicle.n_propellers)]
