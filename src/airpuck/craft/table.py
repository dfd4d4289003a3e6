"""The air-hockey table: its rails, and the frame of the motion capture on it."""

from __future__ import annotations

from airpuck.boundary.files import Fraction, NonNegative, Positive, Section


class Table(Section):
    """A rectangular table, centred at the origin of the world frame, x along its length.

    Attributes
    ----------
    length_m, width_m : float
        Distance between opposite rails along x and along y.
    restitution : float
        Share of the normal speed that a rail gives back, 1: elastic.
    friction : float
        Coulomb coefficient of friction at the rails.
    """

    length_m: Positive = 2.2
    width_m: Positive = 1.1
    restitution: Fraction = 0.7
    friction: NonNegative = 0.1

    def reach(self, radius: float) -> tuple[float, float]:
        """Return how far from the middle of the table the centre of a disc can get.

        Parameters
        ----------
        radius : float
            Radius of the disc [m].

        Returns
        -------
        x, y : float
            Half the free length and width [m].
        """
        return self.length_m / 2 - radius, self.width_m / 2 - radius
