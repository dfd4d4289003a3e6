"""Thrust allocation of whole requests."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from airpuck.control.allocation import AllocationStatus, ThrustAllocator, problem


@dataclass(frozen=True)
class Allocated:
    """Result of an allocation."""

    #: Thrusts within their bounds [N].
    thrust: Float[np.ndarray, " n"]
    #: s1 and s2: fractions of the linear and angular acceleration that are met.
    linear_scale: float
    angular_scale: float
    #: Outcome of the request.
    outcome: AllocationStatus


class Allocator(ThrustAllocator):
    """Allocates thrusts for a requested acceleration."""

    def allocate(
        self,
        request: Float[np.ndarray, " 3"],
        matrix: Float[np.ndarray, "3 n"],
        offset: Float[np.ndarray, " 3"],
        lower: Float[np.ndarray, " n"],
        upper: Float[np.ndarray, " n"],
    ) -> Allocated:
        """Find the thrusts for v = M F + g, within finite bounds."""
        n = self._n
        x, outcome = self.solve(
            *problem(np, self.arm, self.slack_weight, request, matrix, offset, lower, upper)
        )
        if x is None:
            return Allocated(np.array(lower), 0.0, 0.0, outcome)
        linear, angular = (1 - x[n:] / self._root).tolist()
        # Solvers satisfy bounds to their tolerance; the result satisfies them exactly.
        return Allocated(np.minimum(np.maximum(x[:n], lower), upper), linear, angular, outcome)
