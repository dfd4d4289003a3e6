"""A puck on an air cushion: free motion, times of contact and bounces, in closed form.

With drag v' = -k v the puck is at p(t) = p(0) + v(0) σ(t), σ(t) = (1 - exp(-k t)) / k: its path is
a straight line in σ; without drag σ is time itself. Functions take plain numbers, which are several
times faster than arrays for a handful of discs.

The law of contact: the impulse between two bodies, or a body and a rail, that meet.

The normal points into the body that the impulse acts on; the tangent is the normal turned by 90°.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from airpuck.craft.table import AirHockey, Contact, Puck, Table

#: Bodies that approach more slowly than this count as separating [m/s]: friction and bounces leave
#: rounding errors.
STILL = 1e-12
#: Drag below this has no effect, and its reciprocal may overflow [1/s].
_NO_DRAG = 1e-12
#: Parts of the table that a puck can meet. It is in the goal once it is completely behind the line.
Boundary = Literal["rail", "post", "goal"]


class PlainNumbers:
    """The namespace for single numbers: NumPy's functions take ten times as long for one number."""

    abs = staticmethod(abs)

    @staticmethod
    def sign(value: float) -> float:
        """Return -1, 0 or 1."""
        return 1.0 if value > 0 else -1.0 if value < 0 else 0.0

    @staticmethod
    def where(condition: bool, first: float, second: float) -> float:
        """Return the first number if the condition holds, otherwise the second."""
        return first if condition else second


def mobility(mass: Any, inertia: Any, arm_n: Any, arm_t: Any) -> tuple[Any, Any, Any]:
    """Return a body's change of velocity per unit impulse at a contact: k_nn, k_tt, k_nt.

    The arms lead from the centre of mass to the contact.
    """
    k_nn = 1 / mass + arm_t**2 / inertia
    k_tt = 1 / mass + arm_n**2 / inertia
    k_nt = -arm_n * arm_t / inertia
    return k_nn, k_tt, k_nt


def contact_impulse(
    xp: Any,
    mobilities: tuple[Any, Any, Any],
    normal_speed: Any,
    slip: Any,
    restitution: Any,
    friction: Any,
    grip: Any = 1.0,
) -> tuple[Any, Any]:
    """Return the impulse of a contact along normal and tangent.

    Newton's law of restitution applies in the normal direction. In the tangential direction the
    impulse removes the fraction `grip` of the slip if the cone of friction allows it, and otherwise
    lies on the cone. `mobilities` are sums over both bodies. Speeds belong to the body that the
    impulse acts on, relative to the other.
    """
    k_nn, k_tt, k_nt = mobilities
    wanted_n, wanted_t = -(1 + restitution) * normal_speed, -grip * slip
    determinant = k_nn * k_tt - k_nt**2
    stick_n = (k_tt * wanted_n - k_nt * wanted_t) / determinant
    stick_t = (k_nn * wanted_t - k_nt * wanted_n) / determinant
    sign = xp.sign(wanted_t)
    slide_n = wanted_n / (k_nn + friction * sign * k_nt)
    sticks = xp.abs(stick_t) <= friction * stick_n
    impulse_n = xp.where(sticks, stick_n, slide_n)
    impulse_t = xp.where(sticks, stick_t, friction * sign * slide_n)
    # With friction and an offset centre of mass, Newton's law can add energy (Kane and Levinson
    # 1985). In that case the contact is treated as smooth.
    work = impulse_n * (normal_speed + (k_nn * impulse_n + k_nt * impulse_t) / 2) + impulse_t * (
        slip + (k_nt * impulse_n + k_tt * impulse_t) / 2
    )
    impulse_n = xp.where(work > 0, wanted_n / k_nn, impulse_n)
    impulse_t = xp.where(work > 0, 0.0, impulse_t)
    return impulse_n, impulse_t


class PuckState(NamedTuple):
    """Position and motion of a puck.

    Examples
    --------
    >>> puck = airpuck.PuckState(0.2, 0.0, vx=-1.0)
    >>> puck.vx, puck.spin
    (-1.0, 0.0)
    """

    #: [m, m, rad].
    x: float
    y: float
    yaw: float = 0.0
    #: [m/s, m/s, rad/s].
    vx: float = 0.0
    vy: float = 0.0
    spin: float = 0.0


class Meeting(NamedTuple):
    """A puck's next contact with the table."""

    #: σ until then [s]; infinite if there is none.
    sigma: float
    boundary: Boundary
    #: Normal, towards the puck.
    nx: float
    ny: float


@dataclass(slots=True)
class Disc:
    """A disc that a puck can meet; a disc with infinite mass is not moved by the puck."""

    #: Centre [m], velocity [m/s], angular velocity [rad/s]; arrays for many discs at once.
    x: float
    y: float
    vx: Any = 0.0
    vy: Any = 0.0
    spin: Any = 0.0
    radius: float = 0.0
    mass: float = math.inf
    inertia: float = math.inf
    #: From the centre to the centre of mass, in the world frame [m].
    offset: tuple[float, float] = (0.0, 0.0)


def sigma_of(drag: float, duration: float) -> float:
    """Return σ after a time."""
    return -math.expm1(-drag * duration) / drag if drag > _NO_DRAG else duration


def time_of(drag: float, sigma: float) -> float:
    """Return the time at which σ reaches a value; infinite if it never does."""
    if drag <= _NO_DRAG:
        return sigma
    return -math.log1p(-drag * sigma) / drag if drag * sigma < 1 else math.inf


def coast(puck: Puck, state: PuckState, duration: float) -> PuckState:
    """Return where a puck is after a time without any contact."""
    sigma = sigma_of(puck.drag_1_s, duration)
    left = 1 - puck.drag_1_s * sigma
    turned = sigma_of(puck.spin_drag_1_s, duration)
    return PuckState(
        state.x + state.vx * sigma,
        state.y + state.vy * sigma,
        state.yaw + state.spin * turned,
        state.vx * left,
        state.vy * left,
        state.spin * (1 - puck.spin_drag_1_s * turned),
    )


def sigma_to_circle(x: float, y: float, vx: float, vy: float, radius: float) -> float:
    """Return σ until a point meets a circle about the origin; infinite if it never does.

    A point that touches the circle or is inside meets it now, if it moves inwards.
    """
    towards = -(x * vx + y * vy)
    if towards <= STILL * radius:
        return math.inf
    outside = x * x + y * y - radius * radius
    if outside <= 0:
        return 0.0
    discriminant = towards * towards - (vx * vx + vy * vy) * outside
    return outside / (towards + math.sqrt(discriminant)) if discriminant >= 0 else math.inf


class Walls:
    """Bounds of the puck's centre: rails, posts and the sides of the goals."""

    def __init__(self, table: Table, radius: float) -> None:
        self._radius = radius
        self._line = table.length_m / 2
        self._half_goal = min(table.goal_width_m, table.width_m) / 2
        self._reach = table.reach(radius)

    def first(self, state: PuckState) -> Meeting:
        """Return the first contact of a puck that coasts."""
        x, y, _, vx, vy, _ = state
        found = Meeting(math.inf, "rail", 0.0, 0.0)
        x_reach, y_reach = self._reach
        line, half = self._line, self._half_goal
        if abs(vy) > STILL:
            side = math.copysign(1.0, vy)
            sigma = max((side * y_reach - y) / vy, 0.0)
            found = Meeting(sigma, "rail", 0.0, -side)
            # The sides of both goals, behind the line.
            sigma = max((side * (half - self._radius) - y) / vy, 0.0)
            if sigma < found.sigma and abs(x + vx * sigma) >= line:
                found = Meeting(sigma, "post", 0.0, -side)
        if abs(vx) > STILL:
            side = math.copysign(1.0, vx)
            sigma = (side * x_reach - x) / vx
            # A puck already between the posts has not crossed the rail.
            if abs(y + vy * max(sigma, 0.0)) >= half and max(sigma, 0.0) < found.sigma:
                found = Meeting(max(sigma, 0.0), "rail", -side, 0.0)
            sigma = (side * (line + self._radius) - x) / vx
            if 0 <= sigma < found.sigma:
                found = Meeting(sigma, "goal", 0.0, 0.0)
        for post_x in (-line, line):
            for post_y in (-half, half):
                dx, dy = x - post_x, y - post_y
                sigma = sigma_to_circle(dx, dy, vx, vy, self._radius)
                if sigma < found.sigma:
                    dx, dy = dx + vx * sigma, dy + vy * sigma
                    distance = math.hypot(dx, dy)
                    found = Meeting(sigma, "post", dx / distance, dy / distance)
        return found

    def nearest(self, x: float, y: float) -> tuple[float, float]:
        """Return the nearest place where the centre of a puck can be, ignoring corners."""
        x_reach, y_reach = self._reach
        y = max(-y_reach, min(y, y_reach))
        half, beside = self._half_goal, abs(y)
        if abs(x) <= x_reach or beside <= half - self._radius:
            return x, y
        if beside >= half:
            return math.copysign(x_reach, x), y
        if abs(x) >= self._line:
            return x, math.copysign(half - self._radius, y)
        dx, dy = abs(x) - self._line, beside - half
        share = self._radius / max(math.hypot(dx, dy), 1e-12)
        if share <= 1:
            return x, y
        return math.copysign(self._line + dx * share, x), math.copysign(half + dy * share, y)


def walls_of(play: AirHockey) -> Walls:
    """Return the bounds of the puck's centre on a table."""
    return Walls(play.table, play.puck.radius_m)


def strike(
    first: Disc, second: Disc, nx: Any, ny: Any, law: Contact, xp: Any = PlainNumbers
) -> Any:
    """Let two discs that meet bounce; return the normal impulse [N s].

    The normal points from the second to the first. A disc of zero radius represents a rail or a
    post. With NumPy as namespace, motions and normals may be arrays.
    """
    mobilities = [0.0, 0.0, 0.0]
    for disc, side in ((first, -1.0), (second, 1.0)):
        if disc.mass < math.inf:
            rx, ry = disc.offset
            arm_n = side * disc.radius - (rx * nx + ry * ny)
            arm_t = -(ry * nx - rx * ny)
            own = mobility(disc.mass, disc.inertia, arm_n, arm_t)
            mobilities = [a + b for a, b in zip(mobilities, own, strict=True)]
    vx, vy = first.vx - second.vx, first.vy - second.vy
    slip = vy * nx - vx * ny - first.radius * first.spin - second.radius * second.spin
    k_nn, k_tt, k_nt = mobilities
    impulse_n, impulse_t = contact_impulse(
        xp, (k_nn, k_tt, k_nt), vx * nx + vy * ny, slip, law.restitution, law.friction, law.grip
    )
    push(first, impulse_n, impulse_t, nx, ny, -first.radius)
    push(second, -impulse_n, -impulse_t, nx, ny, second.radius)
    return impulse_n


def push(disc: Disc, impulse_n: Any, impulse_t: Any, nx: Any, ny: Any, arm: float) -> None:
    """Change a disc's motion by an impulse at its edge, `arm` along the normal from its centre."""
    if math.isinf(disc.mass):
        return
    rx, ry = disc.offset
    arm_n = arm - (rx * nx + ry * ny)
    arm_t = -(ry * nx - rx * ny)
    turned = (arm_n * impulse_t - arm_t * impulse_n) / disc.inertia
    # Velocity of the centre of mass, then of the centre, which turns about it.
    disc.vx = disc.vx + ((impulse_n * nx - impulse_t * ny) / disc.mass + turned * ry)
    disc.vy = disc.vy + ((impulse_n * ny + impulse_t * nx) / disc.mass - turned * rx)
    disc.spin = disc.spin + turned
