"""Table and craft in the browser, drawn with viser: thrusts, trail, set point to drag."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from airpuck.craft.table import Table
from airpuck.craft.vehicle import Vehicle
from airpuck.model.model_file import Model
from airpuck.physics.thrust import thrust

if TYPE_CHECKING:
    import viser

#: Takes the x, y [m] and yaw [rad] that the user wishes for.
Wish = Callable[[float, float, float], Any]
#: Colours that the colour-blind can tell apart (Okabe and Ito), one for each pair of propellers.
_PAIRS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0))
_TABLE, _RAIL = (236, 239, 241), (84, 98, 111)
_CRAFT, _NOSE, _TRAIL = (120, 130, 140), (40, 40, 40), (20, 110, 190)
_SET_POINT, _SET_POINT_EDGE = (240, 200, 20), (150, 115, 0)
#: Colours of a plan by what holds it back.
_BOUND = {"nothing": (0, 158, 115), "motor": (230, 159, 0), "motion": (213, 94, 0)}
#: The camera at first: where it is, what it looks at [m], and its vertical field of view [rad].
EYE, LOOKS_AT, FIELD_OF_VIEW = (0.0, -1.75, 2.25), (0.0, -0.03, 0.0), math.radians(40)
#: Thickness of table and craft, rails, and propellers [m].
_THICK, _RAIL_HEIGHT, _RAIL_WIDTH, _PROPELLER, _PROPELLER_HEIGHT = 0.02, 0.03, 0.03, 0.014, 0.012
#: Length of an arrow per newton of thrust [m/N].
_PER_NEWTON = 0.8
#: Points of the trail, the least distance between them, and their height [m].
_TRAIL_POINTS, _TRAIL_STEP, _TRAIL_HEIGHT = 200, 0.005, 0.004
#: Above the craft, which would hide it.
_PLAN_HEIGHT = 0.045
#: Radius of the set point's ring and distance of its knob, in radii of the craft: both show around
#: a craft that has arrived. Then the ring's height, and the knob's radius [m].
_RING, _KNOB, _RING_HEIGHT, _BALL = 1.45, 1.95, 0.004, 0.018


class Scene:
    """Table, craft, trail, thrusts and set point on a viser page.

    Where the user drags the set point, `wish` is called with x, y [m] and yaw [rad].

    Parameters
    ----------
    server : viser.ViserServer
        Serves the page.
    model : Model
        Of the craft: its shape, and its thrusts.
    table : Table
        The table.
    wish : callable
        Takes x, y [m], yaw [rad] that the user drags the set point to.
    """

    def __init__(self, server: viser.ViserServer, model: Model, table: Table, wish: Wish) -> None:
        self._model, scene, camera = model, server.scene, server.initial_camera
        camera.position, camera.look_at, camera.fov = EYE, LOOKS_AT, FIELD_OF_VIEW
        # viser's default surroundings would be fetched from elsewhere.
        scene.configure_environment_map(None)
        # Shadows would cost a browser without a graphics card most of its time.
        scene.configure_default_lights(cast_shadow=False)
        scene.add_light_hemisphere("/light", intensity=1.5)
        _draw_table(scene, table)
        self._craft, self._arrows = _draw_craft(scene, model.vehicle)
        self._trail: deque[np.ndarray] = deque(maxlen=_TRAIL_POINTS)
        # The trail fades into the table.
        fade = np.linspace(_TABLE, _TRAIL, _TRAIL_POINTS).astype(np.uint8)
        start = np.zeros((_TRAIL_POINTS, 3))
        self._line = _add_line(scene, "/trail", start, _segments(fade), thickness=3.0)
        self._plans = {
            bound: _add_line(scene, f"/plan/{bound}", start[:2], color, thickness=5.0)
            for bound, color in _BOUND.items()
        }
        self.show_plan(None, "")
        self._marker = _SetPointMarker(scene, model.vehicle.radius_m, wish)

    def add_pose(self, pose: Float[np.ndarray, " 3"]) -> None:
        """Lengthen the trail.

        Parameters
        ----------
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        """
        point = np.array([pose[0], pose[1], _TRAIL_HEIGHT])
        if not self._trail or np.hypot(*(point - self._trail[-1])[:2]) > _TRAIL_STEP:
            self._trail.append(point)

    def show(self, pose: Float[np.ndarray, " 3"], command: Float[np.ndarray, " n"] | None) -> None:
        """Move the craft, and draw its thrusts and its trail.

        Parameters
        ----------
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        command : array, shape (n,), optional
            Motor commands; None draws no thrusts.
        """
        _place(self._craft, pose)
        vehicle = self._model.vehicle
        forces = np.zeros(vehicle.n_propellers)
        if command is not None:
            forces = thrust(self._model.dynamics.thrust, np.clip(command, 0.0, 1.0))
        height = np.full(len(forces), _THICK + _PROPELLER_HEIGHT)
        begin = np.column_stack([vehicle.positions, height])
        # An arrow of no length has no direction.
        lengths = np.maximum(_PER_NEWTON * forces, 1e-3)[:, None]
        along = np.column_stack([vehicle.directions, np.zeros(len(forces))])
        self._arrows.points = np.stack([begin, begin + lengths * along], axis=1, dtype=np.float32)
        if len(self._trail) > 1:
            trail = np.array(self._trail)
            missing = np.repeat(trail[:1], _TRAIL_POINTS - len(trail), axis=0)
            self._line.points = _segments(np.vstack([missing, trail]))

    def show_plan(self, points: Float[np.ndarray, "N 2"] | None, bound: str) -> None:
        """Draw where the controller expects the craft to go.

        Parameters
        ----------
        points : array, shape (N, 2), optional
            x, y [m]; None draws nothing.
        bound : str
            What holds the plan back (`airpuck.control.law.Bound`), which gives its colour.
        """
        # Another controller's path comes without a reason.
        bound = bound if bound in self._plans else "nothing"
        for kind, line in self._plans.items():
            # All are moved: a slow browser shows a line before it has moved it.
            if points is not None:
                height = np.full(len(points), _PLAN_HEIGHT)
                line.points = _segments(np.column_stack([points, height])).astype(np.float32)
            line.visible = points is not None and kind == bound

    def show_set_point(self, pose: Float[np.ndarray, " k"]) -> None:
        """Move the set point.

        Parameters
        ----------
        pose : array, shape (3,) or longer
            x, y [m], yaw [rad]; what follows is ignored.
        """
        self._marker.show(pose)


class _SetPointMarker:
    """A ring where the craft should be: dragging it moves the set point, its knob turns it.

    It stays where it is until `show` moves it: the wish may not be granted.
    """

    def __init__(self, scene: viser.SceneApi, radius: float, wish: Wish) -> None:
        self._wish = wish
        self._pose = np.zeros(3)
        #: From the point that is dragged to the middle of the ring.
        self._grip = np.zeros(2)
        self._frame = scene.add_frame("/setpoint", show_axes=False, visible=False)
        ring, knob = _RING * radius, _KNOB * radius
        disc = scene.add_cylinder("/setpoint/disc", ring, _RING_HEIGHT, _SET_POINT, opacity=0.4)
        disc.position = (0, 0, _RING_HEIGHT / 2)
        angle = np.linspace(0, 2 * np.pi, 49)
        height = np.full(len(angle), _RING_HEIGHT)
        edge = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), height])
        _add_line(scene, "/setpoint/edge", edge, _SET_POINT_EDGE, thickness=2.0)
        size, middle = (knob - ring, 0.006, _RING_HEIGHT), ((knob + ring) / 2, 0, _RING_HEIGHT)
        scene.add_box("/setpoint/stalk", _SET_POINT_EDGE, size, position=middle)
        ball = scene.add_icosphere("/setpoint/knob", _BALL, _SET_POINT, position=(knob, 0, _BALL))
        disc.on_drag(self._move)
        ball.on_drag(self._turn)

    def show(self, pose: Float[np.ndarray, " k"]) -> None:
        """Move it to x, y, yaw."""
        self._pose = np.array(pose[:3], dtype=float)
        _place(self._frame, self._pose)

    # viser keeps the order of drag events for coroutines only.
    async def _move(self, event: Any) -> None:
        """Wish for the place that the ring is dragged to."""
        eye = event.client.camera.position
        if event.phase == "start":
            grabbed = on_table(eye, event.start_position)
            self._grip = np.zeros(2) if grabbed is None else self._pose[:2] - grabbed
        point = on_table(eye, event.end_position)
        if point is not None:
            x, y = (point + self._grip).tolist()
            self._wish(x, y, float(self._pose[2]))

    async def _turn(self, event: Any) -> None:
        """Wish for the direction that the knob is dragged to."""
        point = on_table(event.client.camera.position, event.end_position)
        if point is not None:
            x, y, _ = self._pose.tolist()
            self._wish(x, y, math.atan2(point[1] - y, point[0] - x))


def on_table(eye: Any, through: Any) -> Float[np.ndarray, " 2"] | None:
    """Return where the line of sight from an eye through a point meets the table, if it does."""
    eye, through = np.asarray(eye, dtype=float), np.asarray(through, dtype=float)
    down = eye[2] - through[2]
    if down <= 1e-9 or eye[2] <= 0:
        return None
    return (eye + (through - eye) * eye[2] / down)[:2]


def _place(frame: viser.FrameHandle, pose: Float[np.ndarray, " k"]) -> None:
    """Show a frame on the table, turned about the vertical."""
    x, y, yaw = map(float, pose[:3])
    frame.position = (x, y, 0.0)
    frame.wxyz = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    frame.visible = True


def _segments(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N-1 2 3"]:
    """Return the segments of a line through points."""
    return np.stack([points[:-1], points[1:]], axis=1)


def _add_line(
    scene: viser.SceneApi,
    name: str,
    points: Float[np.ndarray, "N 3"],
    colors: Any,
    thickness: float,
) -> viser.LineSegmentsHandle:
    """Draw a line through points, as thick on the screen from near and from far."""
    return scene.add_line_segments(
        name, _segments(points), colors, thickness=thickness, thickness_units="screen"
    )


def _draw_table(scene: viser.SceneApi, table: Table) -> None:
    """Draw table, rails and the origin's axes."""
    length, width = table.length_m, table.width_m
    scene.add_box("/table", _TABLE, (length, width, _THICK), position=(0, 0, -_THICK / 2))
    x, y = (length + _RAIL_WIDTH) / 2, (width + _RAIL_WIDTH) / 2
    short = (_RAIL_WIDTH, width, _RAIL_HEIGHT)
    long = (length + 2 * _RAIL_WIDTH, _RAIL_WIDTH, _RAIL_HEIGHT)
    for sign, beside, along in ((-1, "left", "near"), (1, "right", "far")):
        scene.add_box(f"/rails/{beside}", _RAIL, short, position=(sign * x, 0, _RAIL_HEIGHT / 2))
        scene.add_box(f"/rails/{along}", _RAIL, long, position=(0, sign * y, _RAIL_HEIGHT / 2))
    scene.add_frame("/origin", axes_length=0.1, axes_radius=0.003)
    for axis, at in (("x", (0.12, 0, 0)), ("y", (0, 0.12, 0))):
        scene.add_label(f"/origin/{axis}", axis, position=at, anchor="center-center")


def _draw_craft(
    scene: viser.SceneApi, vehicle: Vehicle
) -> tuple[viser.FrameHandle, viser.ArrowsHandle]:
    """Draw a disc with nose, propellers and arrows of thrust; return its frame and its arrows."""
    frame, radius = scene.add_frame("/craft", show_axes=False, visible=False), vehicle.radius_m
    scene.add_cylinder("/craft/disc", radius, _THICK, _CRAFT, position=(0, 0, _THICK / 2))
    size, middle = (0.4 * radius, 0.008, 0.006), (0.8 * radius, 0, _THICK + 0.003)
    scene.add_box("/craft/nose", _NOSE, size, position=middle)
    pairs = {i: k for k, pair in enumerate(vehicle.pair_indices) for i in pair}
    # Propellers without a partner have colours of their own.
    numbers = [pairs.get(i, len(vehicle.pair_indices) + i) for i in range(vehicle.n_propellers)]
    colors = [_PAIRS[k % len(_PAIRS)] for k in numbers]
    height = _THICK + _PROPELLER_HEIGHT / 2
    drawn = zip(vehicle.propeller_names, vehicle.positions.tolist(), colors, strict=True)
    for name, (x, y), color in drawn:
        place = (x, y, height)
        scene.add_cylinder(f"/craft/{name}", _PROPELLER, _PROPELLER_HEIGHT, color, position=place)
    points, shades = np.zeros((len(colors), 2, 3)), np.array(colors, np.uint8)
    arrows = scene.add_arrows(
        "/craft/thrusts", points, shades, shaft_radius=0.006, head_radius=0.014, head_length=0.024
    )
    return frame, arrows
