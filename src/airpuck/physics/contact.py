"""The law of contact: the impulse between two bodies, or a body and a rail, that meet.

The normal points into the body that the impulse acts on; the tangent is the normal turned by 90°.
"""

from __future__ import annotations

from typing import Any


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
    lies on the cone. `mobilities` are sums over both bodies. Speeds are those of the body that the
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
