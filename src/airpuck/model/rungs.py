"""The rungs of the model ladder: which parameters are free (table:models)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary import numbers
from airpuck.boundary.arguments import chosen
from airpuck.boundary.errors import InputError
from airpuck.boundary.kinds import nearest
from airpuck.craft.vehicle import Vehicle
from airpuck.model.parameters import Parameters, change_degree, nominal_parameters
from airpuck.model.quantities import EFFECTS, QUANTITIES
from airpuck.physics.rigid_body import CenterOfMassFrame


@dataclass(frozen=True)
class Rung:
    """A named choice of free parameters."""

    #: ``M0``, ….
    name: str
    #: What it models, in a few words.
    summary: str
    #: Names of the free quantities.
    free: frozenset[str]
    #: Whether the motors lag behind their commands.
    lag: bool = True
    #: Whether the configuration matrix is learned directly.
    direct: bool = False
    #: Powers of φ in the thrust curve, whatever the degree; None: all up to the degree.
    powers: tuple[int, ...] | None = None
    #: Names of the optional effects that it models.
    effects: tuple[str, ...] = ()
    #: Degree of the thrust curves; None: as in the vehicle's nominal thrust.
    degree: int | None = None
    #: The frame in which the offset of the centre of mass is constant; "world" is the paper's eq.
    #: acc_dyn.
    frame: CenterOfMassFrame = "body"

    def initial(self, vehicle: Vehicle) -> Parameters:
        """Return the initial parameters of a fit of this rung."""
        parameters = nominal_parameters(vehicle, self.degree)
        if self.powers is not None:
            curves = _only(parameters.thrust, self.powers)
            wheels = change_degree(vehicle.nominal_thrust, max(self.powers))
            curves = np.where(vehicle.is_wheel[:, None], wheels, curves)
            parameters = replace(parameters, thrust=curves)
        try:
            vehicle.actuators.check_thrust(parameters.thrust.shape[1])
        except ValueError as error:
            raise InputError(str(error), field="model") from error
        if not self.lag:
            parameters = replace(parameters, motor_time_constant=0.0)
        if self.direct:
            matrix = parameters.dynamics(np, vehicle).configuration
            parameters = replace(parameters, configuration_matrix=matrix)
        starts = {name: EFFECTS[name].start for name in self.effects}
        return replace(
            parameters,
            **{k: np.array(v) if isinstance(v, tuple) else v for k, v in starts.items()},
        )

    def mask(
        self, parameters: Parameters, vehicle: Vehicle | None = None
    ) -> Bool[np.ndarray, " P"]:
        """Mark the free entries; a craft with wheels needs its vehicle."""
        mask = parameters.mask(self.free.union(self.effects))
        n, degree = np.shape(parameters.thrust)
        # The thrust coefficients come first in the vector.
        curves = mask[: n * degree].reshape(n, degree)
        if self.powers is not None:
            curves &= np.isin(np.arange(1, degree + 1), self.powers)
        if vehicle is not None and vehicle.wheels:
            wheels = vehicle.is_wheel
            # A wheel's torque is proportional to its drive, and only turns the craft.
            curves[wheels] = np.arange(degree) == 0
            entries = np.flatnonzero(parameters.mask(frozenset({"configuration_matrix"})))
            mask[entries.reshape(3, -1)[:, wheels[: entries.size // 3]]] = False
            if not vehicle.propellers_turn:
                # Recordings then determine only the ratio of the wheels' torque to the inertia.
                mask &= ~parameters.mask(frozenset({"inertia"}))
        return mask


def _only(
    coefficients: Float[np.ndarray, "n degree"], powers: tuple[int, ...]
) -> Float[np.ndarray, "n new_degree"]:
    """Fit the given powers of φ to the curves, by least squares at 101 points of [0, 1]."""
    degree = max(powers)
    speed = np.linspace(0, 1, 101)[:, None]
    curves = speed ** np.arange(1, coefficients.shape[1] + 1) @ coefficients.T
    fitted = np.linalg.lstsq(speed ** np.array(powers), curves, rcond=None)[0]
    result = np.zeros((len(coefficients), degree))
    result[:, np.array(powers) - 1] = fitted.T
    return result


def _of_paper(name: str, summary: str, **more: Any) -> Rung:
    """Return a rung of table:models."""
    return Rung(name, summary, frozenset(q.name for q in QUANTITIES if name in q.rungs), **more)


_M3 = _of_paper("M3", "full first-principles model")

RUNGS: dict[str, Rung] = {
    rung.name: rung
    for rung in (
        _of_paper("M0", "thrust curves only; no motor lag", lag=False),
        _of_paper("M1", "and the inertia; no motor lag", lag=False),
        _of_paper("M2", "thrust curves and motor lag, inertia of a disc"),
        _M3,
        _of_paper("M4", "thrust curves, motor lag and a free configuration matrix", direct=True),
        replace(
            _M3,
            name="M5",
            summary="M3, inflow and pair interaction",
            effects=("inflow", "pair_interaction"),
        ),
        replace(_M3, name="quadratic", summary="M3 with the classical thrust κφ²", powers=(2,)),
    )
}

#: Optional terms of a rung's name, and their effects.
TERMS: dict[str, str] = {quantity.term: name for name, quantity in EFFECTS.items()}


def named_rung(name: str, *, degree: int | None = None, frame: CenterOfMassFrame = "body") -> Rung:
    """Return a rung by name.

    Parameters
    ----------
    name : str
        A rung in `RUNGS`, and optional terms in `TERMS`, for example ``M3+inflow+pair``.
    degree : int, optional
        Degree of the thrust polynomials; by default as in the vehicle's nominal thrust.
    frame : {"body", "world"}, default "body"
        The frame in which the offset of the centre of mass is constant; "world" is the paper's eq.
        acc_dyn.

    Returns
    -------
    Rung
        The rung.

    Raises
    ------
    InputError
        If a rung, term or frame is unknown, or the degree is out of range.

    Examples
    --------
    >>> rung = airpuck.named_rung("M3+drag", degree=2)
    >>> rung.name
    'M3+drag'
    """
    if degree is not None:
        numbers.DEGREE.check(degree, "degree")
    chosen(frame, dict.fromkeys(get_args(CenterOfMassFrame)), "frame")
    base, *terms = name.split("+")
    if base not in RUNGS:
        raise InputError(
            f"there is no model {base!r}; choose one of {', '.join(RUNGS)}{nearest(base, RUNGS)}",
            field="model",
        )
    rung = replace(RUNGS[base], degree=degree, frame=frame)
    for term in terms:
        if term not in TERMS:
            raise InputError(
                f"there is no term {term!r}; choose from {', '.join(TERMS)}{nearest(term, TERMS)}",
                field="model",
            )
        if TERMS[term] in rung.effects:
            raise InputError(f"{name!r} has the term {term!r} twice", field="model")
        rung = replace(
            rung,
            name=f"{rung.name}+{term}",
            summary=f"{rung.summary}, {term}",
            effects=(*rung.effects, TERMS[term]),
        )
    return rung
