"""The rungs of the model ladder: which parameters are free (table:models)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError
from airpuck.craft.vehicle import Vehicle
from airpuck.model.parameters import EFFECTS, Parameters, nominal_parameters
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
    #: Powers of φ in the thrust curve, whatever the degree; None: all up to it.
    powers: tuple[int, ...] | None = None
    #: Names of the optional effects that it models, in `airpuck.model.parameters.EFFECTS`.
    effects: tuple[str, ...] = ()
    #: Degree of the thrust curves; None: that of the vehicle's nominal thrust.
    degree: int | None = None
    #: Where the offset of the centre of mass is constant; "world" is the paper's eq. acc_dyn.
    frame: CenterOfMassFrame = "body"

    def initial(self, vehicle: Vehicle) -> Parameters:
        """Return where a fit of this rung starts."""
        parameters = nominal_parameters(vehicle, self.degree)
        if self.powers is not None:
            parameters = replace(parameters, thrust=_only(parameters.thrust, self.powers))
        if not self.lag:
            parameters = replace(parameters, motor_time_constant=0.0)
        if self.direct:
            matrix = parameters.dynamics(np, vehicle).configuration
            parameters = replace(parameters, configuration_matrix=matrix)
        starts = {name: EFFECTS[name] for name in self.effects}
        return replace(
            parameters,
            **{k: np.array(v) if isinstance(v, tuple) else v for k, v in starts.items()},
        )

    def mask(self, parameters: Parameters) -> Bool[np.ndarray, " P"]:
        """Mark the free entries."""
        mask = parameters.mask(self.free.union(self.effects))
        if self.powers is not None:
            n, degree = np.shape(parameters.thrust)
            # The thrust coefficients come first in the vector.
            of_power = np.isin(np.arange(1, degree + 1), self.powers)
            mask[: n * degree] &= np.tile(of_power, n)
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


#: What M3 learns.
_FIRST_PRINCIPLES = frozenset(
    {"thrust", "inertia", "motor_time_constant", "angle_offset", "center_of_mass"}
)

RUNGS: dict[str, Rung] = {
    rung.name: rung
    for rung in (
        Rung("M0", "thrust curves only; no motor lag", frozenset({"thrust"}), lag=False),
        Rung("M1", "and the inertia; no motor lag", frozenset({"thrust", "inertia"}), lag=False),
        Rung(
            "M2",
            "thrust curves and motor lag, inertia of a disc",
            frozenset({"thrust", "motor_time_constant"}),
        ),
        Rung(
            "M3",
            "full first-principles model",
            _FIRST_PRINCIPLES,
        ),
        Rung(
            "M4",
            "thrust curves, motor lag and a free configuration matrix",
            frozenset({"thrust", "motor_time_constant", "configuration_matrix"}),
            direct=True,
        ),
        Rung(
            "M5",
            "M3, inflow and pair interaction",
            _FIRST_PRINCIPLES,
            effects=("inflow", "pair_interaction"),
        ),
        Rung(
            "quadratic",
            "M3 with the classical thrust κφ²",
            _FIRST_PRINCIPLES,
            powers=(2,),
        ),
    )
}


#: Optional terms of a rung's name, and the effects that they stand for.
TERMS: dict[str, str] = {
    "drag": "drag",
    "inflow": "inflow",
    "pair": "pair_interaction",
    "sag": "voltage_sag",
    "tilt": "tilt",
}


def named_rung(name: str, *, degree: int | None = None, frame: CenterOfMassFrame = "body") -> Rung:
    """Return a rung by name.

    Parameters
    ----------
    name : str
        A rung in `RUNGS`, and optional terms in `TERMS`, for example ``M3+inflow+pair``.
    degree : int, optional
        Degree of the thrust polynomials; by default that of the vehicle's nominal thrust.
    frame : {"body", "world"}, default "body"
        Where the offset of the centre of mass is constant; "world" is the paper's eq. acc_dyn.

    Returns
    -------
    Rung
        The rung.

    Raises
    ------
    InputError
        If there is no rung or no term of that name.
    """
    base, *terms = name.split("+")
    if base not in RUNGS:
        raise InputError(
            f"there is no model {base!r}; choose one of {', '.join(RUNGS)}", field="model"
        )
    rung = replace(RUNGS[base], degree=degree, frame=frame)
    for term in terms:
        if term not in TERMS:
            raise InputError(
                f"there is no term {term!r}; choose from {', '.join(TERMS)}", field="model"
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
