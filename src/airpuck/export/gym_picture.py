"""Pictures of the environments: the table from above, drawn with NumPy alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from airpuck.boundary.errors import InputError
from airpuck.boundary.kinds import unknown
from airpuck.craft.table import Table
from airpuck.twin.settings import TwinSettings

#: Pixels per metre, and room for the rails around the table [m].
_SCALE, _RAIL = 300, 0.03
#: Width of an outline, and half the length and width of the mark that shows the yaw, in radii.
_OUTLINE, _MARK = 0.12, (0.45, 0.08)
_FLOOR, _RAILS, _LINE = (250, 250, 247), (70, 70, 70), (214, 214, 208)
WHITE, BLACK, GREEN, BLUE, RED = (
    (255, 255, 255),
    (30, 30, 30),
    (0, 158, 115),
    (0, 114, 178),
    (213, 94, 0),
)


class DrawnDisc(NamedTuple):
    """A body or a goal to draw."""

    #: x, y [m], and the yaw [rad] if a mark shows it.
    pose: Any
    #: Radius [m].
    radius: float
    edge: tuple[int, int, int]
    #: None: an outline only.
    face: tuple[int, int, int] | None


def picture(table: Table, discs: Iterable[DrawnDisc]) -> UInt8[np.ndarray, "height width 3"]:
    """Draw discs on a table, from back to front; y points up."""
    half = np.array([table.length_m, table.width_m]) / 2
    across, up = np.rint(2 * _SCALE * (half + _RAIL)).astype(int)
    x = (np.arange(across) + 0.5) / _SCALE - half[0] - _RAIL
    y = (half[1] + _RAIL - (np.arange(up) + 0.5) / _SCALE)[:, None]
    image = np.full((up, across, 3), _RAILS, dtype=np.uint8)
    image[(np.abs(x) < half[0]) & (np.abs(y) < half[1])] = _FLOOR
    image[(np.abs(x) < 1 / _SCALE) & (np.abs(y) < half[1])] = _LINE
    for disc in discs:
        _draw(image, x - disc.pose[0], y - disc.pose[1], disc)
    return image


def drawn_puck(puck: Any, settings: TwinSettings) -> list[DrawnDisc]:
    """Return the puck as a disc, if there is one."""
    return (
        [] if puck is None else [DrawnDisc((puck.x, puck.y), settings.puck.radius_m, BLACK, BLACK)]
    )


def check_render_mode(mode: str | None, metadata: Mapping[str, Any]) -> None:
    """Raise InputError for an unknown render mode."""
    if mode is not None and mode not in metadata["render_modes"]:
        raise InputError(unknown(mode, metadata["render_modes"]), field="render_mode")


def _draw(
    image: UInt8[np.ndarray, "height width 3"],
    x: Float[np.ndarray, " width"],
    y: Float[np.ndarray, "height 1"],
    disc: DrawnDisc,
) -> None:
    """Draw a disc at the origin of x and y."""
    away = np.hypot(x, y) / disc.radius
    if disc.face is not None:
        image[away < 1] = disc.face
    image[np.abs(away - 1 + _OUTLINE / 2) < _OUTLINE / 2] = disc.edge
    if len(disc.pose) > 2:
        cos, sin = np.cos(disc.pose[2]), np.sin(disc.pose[2])
        ahead, aside = (cos * x + sin * y) / disc.radius, (cos * y - sin * x) / disc.radius
        image[(np.abs(ahead - _MARK[0]) < _MARK[0]) & (np.abs(aside) < _MARK[1])] = disc.edge
