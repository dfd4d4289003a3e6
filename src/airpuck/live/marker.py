"""The set point in the browser: a ring to drag, with a knob to turn; viser's part."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    import viser

_COLOR, _EDGE = (240, 200, 20), (150, 115, 0)
#: Radius of the ring and distance of its knob, in radii of the craft: both show around a craft
#: that has arrived.
_RING, _KNOB = 1.45, 1.95
#: Height of the ring, size of the knob [m].
_FLAT, _BALL = 0.004, 0.018


class SetPointMarker:
    """A ring where the craft should be; dragging it moves the set point, its knob turns it.

    It stays where it is until `show` moves it: what is wished and what is granted may differ.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        radius: float,
        wish: Callable[[float, float, float], Any],
    ) -> None:
        self._wish = wish
        self._place, self._yaw = np.zeros(2), 0.0
        #: From the place that is dragged to the middle of the ring.
        self._grip = np.zeros(2)
        self._frame = scene.add_frame("/setpoint", show_axes=False, visible=False)
        ring, knob = _RING * radius, _KNOB * radius
        disc = scene.add_cylinder(
            "/setpoint/disc", ring, _FLAT, _COLOR, position=(0, 0, _FLAT / 2), opacity=0.4
        )
        around = np.linspace(0, 2 * np.pi, 49)
        edge = np.column_stack(
            [ring * np.cos(around), ring * np.sin(around), np.full(len(around), _FLAT)]
        )
        scene.add_line_segments(
            "/setpoint/edge",
            np.stack([edge[:-1], edge[1:]], axis=1).astype(np.float32),
            _EDGE,
            thickness=2.0,
            thickness_units="screen",
        )
        scene.add_box(
            "/setpoint/stalk",
            _EDGE,
            (knob - ring, 0.006, _FLAT),
            position=((knob + ring) / 2, 0, _FLAT),
        )
        ball = scene.add_icosphere("/setpoint/knob", _BALL, _COLOR, position=(knob, 0, _BALL))
        disc.on_drag(self._move)
        ball.on_drag(self._turn)

    def show(self, pose: Float[np.ndarray, " k"]) -> None:
        """Put it somewhere."""
        self._place, self._yaw = np.array(pose[:2], dtype=float), float(pose[2])
        self._frame.position = (*self._place.tolist(), 0.0)
        self._frame.wxyz = turned(self._yaw)
        self._frame.visible = True

    # viser keeps the order of drag events for coroutines only.
    async def _move(self, event: Any) -> None:
        """Wish for the place that the ring is dragged to."""
        eye = event.client.camera.position
        if event.phase == "start":
            grabbed = on_table(eye, event.start_position)
            self._grip = np.zeros(2) if grabbed is None else self._place - grabbed
        point = on_table(eye, event.end_position)
        if point is not None:
            x, y = (point + self._grip).tolist()
            self._wish(x, y, self._yaw)

    async def _turn(self, event: Any) -> None:
        """Wish for the direction that the knob is dragged to."""
        point = on_table(event.client.camera.position, event.end_position)
        if point is not None:
            x, y = self._place.tolist()
            self._wish(x, y, math.atan2(point[1] - y, point[0] - x))


def turned(yaw: float) -> tuple[float, float, float, float]:
    """Return the quaternion of a turn about the vertical."""
    return math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)


def on_table(eye: Any, through: Any) -> Float[np.ndarray, " 2"] | None:
    """Return where somebody who looks through a point sees the table."""
    eye, through = np.asarray(eye, dtype=float), np.asarray(through, dtype=float)
    down = eye[2] - through[2]
    if down <= 1e-9 or eye[2] <= 0:
        return None
    return (eye + (through - eye) * eye[2] / down)[:2]
