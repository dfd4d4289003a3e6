"""The rungs of the model ladder: which parameters are free (table:models)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary import numbers
from airpuck.boundary.arguments import chosen
from airpuck.boundary.errors import InputError, check_known, explained
from airpuck.boundary.extensions import added, loaded, users_class
from airpuck.craft.vehicle import Vehicle
from airpuck.model.parameters import Parameters, change_degree, nominal_parameters, with_own
from airpuck.model.quantities import EFFECTS, QUANTITIES, Quantity, quantity_of
from airpuck.physics.effects import BodyMotion, Effect
from airpuck.physics.rigid_body import CenterOfMassFrame

#: Name of the neural term.
NEURAL = "residual"


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
    #: Coefficients of the user's own effects.
    own: tuple[Quantity, ...] = ()
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
        with explained(ValueError, "{error}", field="model"):
            vehicle.actuators.check_thrust(parameters.thrust.shape[1])
        if not self.lag:
            parameters = replace(parameters, motor_time_constant=0.0)
        if self.direct:
            matrix = parameters.dynamics(np, vehicle).configuration
            parameters = replace(parameters, configuration_matrix=matrix)
        starts = {name: EFFECTS[name].start for name in self.effects}
        if NEURAL in starts:
            weights = EFFECTS[NEURAL].entries(vehicle.propeller_names, 0)
            starts[NEURAL] = (0.0,) * len(weights)
        parameters = replace(
            parameters, **{k: np.array(v) if isinstance(v, tuple) else v for k, v in starts.items()}
        )
        if self.own:
            parameters = with_own(parameters, {q: q.start for q in self.own})
            _try(parameters, vehicle)
        return parameters

    def with_effect(
        self,
        effect: type[Effect],
        *,
        start: Mapping[str, float] | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        term: str = "",
    ) -> Rung:
        """Return a rung that learns the coefficients of an effect of your own, too.

        Parameters
        ----------
        effect : type of Effect
            A dataclass; fields that have a number as default are its coefficients.
        start : mapping, optional
            Where a fit starts, by coefficient; otherwise at the defaults.
        bounds : mapping, optional
            Lowest and highest value, by coefficient; otherwise the class's.
        term : str, optional
            The term in the rung's name: FILE.py:NAME, or by default MODULE:NAME.

        Returns
        -------
        Rung
            A copy. Its parameters have an attribute with the name of the class in lower case.

        Raises
        ------
        InputError
            If the class is no effect with coefficients, or a name or number is impossible.
        """
        quantity = quantity_of(effect, term, start, bounds)
        if quantity.name in {one.name for one in self.own} or hasattr(Parameters, quantity.name):
            problem = f"{self.name!r} has {quantity.name} already; rename the class"
            raise InputError(problem, field="model")
        more: dict[str, Any] = {"summary": f"{self.summary}, {quantity.meaning}"}
        return replace(self, name=f"{self.name}+{quantity.term}", own=(*self.own, quantity), **more)

    def with_term(self, term: str) -> Rung:
        """Return a rung with an optional term, or an effect of the user's own by its name."""
        if ":" in term or term in added("airpuck.effects"):
            return self.with_effect(effect_named(term), term=term)
        problem = f"there is no term {term!r}; choose from {', '.join(TERMS)}, FILE.py:NAME"
        check_known(term, TERMS, problem, field="model")
        if TERMS[term] in self.effects:
            raise InputError(f"{self.name!r} has the term {term!r} twice", field="model")
        name, summary = f"{self.name}+{term}", f"{self.summary}, {term}"
        return replace(self, name=name, summary=summary, effects=(*self.effects, TERMS[term]))

    @property
    def physics(self) -> Rung:
        """The rung without the neural term, which is trained after a fit."""
        effects = tuple(name for name in self.effects if name != NEURAL)
        name = "+".join(term for term in self.name.split("+") if term != NEURAL)
        return replace(self, name=name, effects=effects)

    def mask(
        self, parameters: Parameters, vehicle: Vehicle | None = None
    ) -> Bool[np.ndarray, " P"]:
        """Mark the free entries; a craft with wheels needs its vehicle."""
        mask = parameters.mask(self.free.union(self.effects, (q.name for q in self.own)))
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
        _of_paper("M1", "thrust curves and inertia; no motor lag", lag=False),
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
        A rung in `RUNGS`, and optional terms in `TERMS`, for example ``M3+inflow+pair``. The term
        ``FILE.py:NAME`` or ``MODULE:NAME`` is an effect of your own (`Rung.with_effect`).
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
    problem = f"there is no model {base!r}; choose one of {', '.join(RUNGS)}, or auto, to fit"
    check_known(base, RUNGS, problem, field="model")
    rung = replace(RUNGS[base], degree=degree, frame=frame)
    for term in terms:
        rung = rung.with_term(term)
    return rung


def rung_of(name: str, own: tuple[Quantity, ...], frame: CenterOfMassFrame) -> Rung:
    """Return the rung of a model with the user's effects `own`, whatever their code is now."""
    terms = {quantity.term for quantity in own}
    rung = named_rung("+".join(p for p in name.split("+") if p not in terms), frame=frame)
    summary = ", ".join([rung.summary, *(quantity.meaning for quantity in own)])
    return replace(rung, name=name, summary=summary, own=own)


def effect_named(name: str) -> type[Effect]:
    """Return the user's effect FILE.py:NAME, MODULE:NAME, or of an entry point."""
    return users_class(name, "--model") if ":" in name else loaded("airpuck.effects", name)


def _try(parameters: Parameters, vehicle: Vehicle) -> None:
    """Evaluate the user's effects once, at rest; raise InputError if one fails."""
    rest = BodyMotion(*np.zeros((3, 1)), *np.ones((2, 1)), *np.zeros((2, 1)))
    layout, thrust = parameters.layout(np, vehicle), np.ones((vehicle.n_propellers, 1))
    for quantity in parameters.own:
        assert quantity.effect is not None
        try:
            effect = quantity.effect.of(layout, getattr(parameters, quantity.name))
            sizes = [np.shape(part) for part in effect.acceleration(np, rest)]
            changed = np.shape(effect.thrust(np, thrust, rest))
        except Exception as error:  # of the user's code
            problem = f"fails at rest: {type(error).__name__}: {error}"
            raise InputError(problem, file=quantity.term, field="model") from error
        if not set(sizes) <= {(), (1,)} or len(sizes) != 3 or changed != thrust.shape:
            problem = "must return three accelerations, and thrusts in the shape that it is given"
            raise InputError(problem, file=quantity.term, field="model")
