"""A matrix times the vectors of a batch."""

from __future__ import annotations

from typing import Any


def linear_map(matrix: Any, vector: Any) -> Any:
    """Apply a matrix, one for all or one for each of a batch."""
    if matrix.ndim == 2 and vector.ndim <= 2:
        return matrix @ vector
    if matrix.ndim == 2:
        matrix = matrix.reshape(matrix.shape + (1,) * (vector.ndim - 1))
    # A sum of arrays: a reduction over an axis, compiled for a CPU, takes several times as long.
    return sum(matrix[:, i] * vector[i] for i in range(matrix.shape[1]))
