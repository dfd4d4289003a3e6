"""Cosine and sine of many angles, computed once and fast.

Two habits of XLA on a CPU made sines of the same few yaws take two thirds of the time of a rollout
with sensitivities. First, it fuses a result into every place that uses it, and recomputes it in
each. It drops optimisation barriers, but never fuses a matrix product, so a product with the
identity keeps the values. Second, it calls the C library for each double-precision number; fdlibm's
polynomials on whole arrays take a tenth of that time.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

#: π/2 in parts of 33 bits, so that a part times a count below 2²⁰ is exact.
_QUARTER = (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624871116645580e-21)
#: (sin r - r) / r³ and (cos r - 1 + r²/2) / r⁴ by powers of r², for |r| ≤ π/4, to 2⁻⁵⁸: fdlibm,
#: k_sin.c and k_cos.c (Sun Microsystems, 1993).
_SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)


def cos_sin(xp: Any, angle: Any) -> tuple[Any, Any]:
    """Return the cosine and the sine of angles."""
    if xp is np or xp.ndim(angle) == 0:
        return xp.cos(angle), xp.sin(angle)
    return _kept()(angle if xp.issubdtype(angle.dtype, xp.floating) else angle.astype(float))


@cache
def _kept() -> Any:
    """Return the function under JAX, which on a CPU keeps its result in memory."""
    import jax
    import jax.numpy as jnp

    first = np.array([True, False])

    def plain(angle: Any) -> Any:
        return jnp.stack([jnp.cos(angle), jnp.sin(angle)])

    def kept(angle: Any) -> Any:
        if jax.dtypes.canonicalize_dtype(float) == np.float64:
            rows = polynomials(jnp, angle.astype(float)).astype(angle.dtype)
        else:
            # The parts stay separate: if they were joined, XLA would multiply each on its own and
            # fuse the products.
            rows = jnp.where(_rows(first, angle), jnp.cos(angle), jnp.sin(angle))
        return jnp.tensordot(np.eye(2, dtype=angle.dtype), rows, 1, precision="highest")

    @jax.custom_jvp
    def both(angle: Any) -> tuple[Any, Any]:
        cos, sin = jax.lax.platform_dependent(angle, cpu=kept, default=plain)
        return cos, sin

    @both.defjvp
    def _(primals: tuple[Any], tangents: tuple[Any]) -> tuple[tuple[Any, Any], tuple[Any, Any]]:
        cos, sin = both(*primals)
        return (cos, sin), (-sin * tangents[0], cos * tangents[0])

    return both


def polynomials(xp: Any, angle: Any) -> Any:
    """Compute cosine and sine with array operations alone, in double precision.

    An angle is a whole number of quarter turns and a remainder within ±π/4, where the polynomials
    are exact to rounding. The number of quarter turns selects polynomial and sign.
    """
    turns = xp.round(angle * (2 / np.pi))
    rest = angle
    for part in _QUARTER:
        rest = rest - turns * part
    # Only huge angles leave a larger remainder: their sine is unknown, but never above one.
    rest = xp.clip(rest, -1.0, 1.0)
    square = rest * rest
    sine = rest + rest * square * _horner(_SINE, square)
    cosine = 1 - square / 2 + square * square * _horner(_COSINE, square)
    # Use one array from the start, with cos(r) = sin(r + π/2): joining two arrays is not
    # vectorised. Neither are conversions to 64 bits on most processors.
    quadrant = turns.astype(np.int32) + _rows(np.array([1, 0], np.int32), angle)
    value = xp.where(quadrant & 1, cosine, sine)
    return xp.where(quadrant & 2, -value, value)


def _rows(values: np.ndarray, angle: Any) -> np.ndarray:
    """Shape values to broadcast over angles, one value for each row of the result."""
    return values.reshape(-1, *(1,) * angle.ndim)


def _horner(coefficients: tuple[float, ...], x: Any) -> Any:
    """Evaluate a polynomial, constant term first."""
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total
