"""A model: vehicle, parameters, how they were learned and from which data; and its file."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from importlib import import_module, resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Bool, Float

from airpuck.boundary.arguments import checked_class
from airpuck.boundary.errors import InputError, check_known
from airpuck.boundary.extensions import with_code
from airpuck.boundary.files import checked, load_toml, write_toml
from airpuck.boundary.results import frame
from airpuck.compute.arrays import generator, namespace
from airpuck.craft.vehicle import Vehicle, default_vehicle
from airpuck.model.authors_params import of_authors, read_params_json, read_params_yaml
from airpuck.model.parameters import Parameters, nominal_parameters
from airpuck.model.rungs import RUNGS, Rung, rung_of
from airpuck.model.sections import (
    ModelFile,
    OfRecording,
    model_content,
    of_recording,
    read_fields,
    with_nominal_delay,
)
from airpuck.model.simulation import derivative, draw, simulate, statespace
from airpuck.model.uncertainty import (
    Cameras,
    DelayJitter,
    Uncertainty,
    parameter_rows,
    parameters_html,
)
from airpuck.physics.effects import Effect
from airpuck.physics.rigid_body import CenterOfMassFrame, Dynamics

if TYPE_CHECKING:
    import control

_FORMAT = "airpuck model 1"


@lru_cache(maxsize=256)
def _moved(model: Model, vector: bytes) -> Model:
    """Return the model with other parameters; every quantity's error needs the same few."""
    parameters = model.parameters.with_vector(np.frombuffer(vector))
    return replace(model, parameters=parameters, uncertainty=None)


@partial(checked_class, finite=False)
@dataclass(frozen=True, eq=False)
class Model:
    """A craft with known parameters: the result of identification, used by all other packages.

    Attributes
    ----------
    name : str
        The rung, e.g. ``M3``.
    vehicle : Vehicle
        Geometry and mass.
    parameters : Parameters
        The learned and the fixed parameters.
    free : array of bool, shape (P,)
        Which entries of ``parameters.to_vector()`` were learned.
    frame : {"body", "world"}
        The frame in which the offset of the centre of mass is constant.
    indexing : {"start", "end"}
        Convention of the encoder that the model was learned with (`PaperEncoder.indexing`).
    fit : mapping
        Details of the fit: loss, method, settings. Empty for a model that was not fitted here.
    data : mapping of str to str
        SHA-256 of the files it was learned from, by name.
    source : str
        Origin of the numbers.
    uncertainty : Uncertainty or None
        Uncertainty of the parameters, if they were learned here.
    delay_jitter : DelayJitter or None
        Spread of the transport delay between packets, if it was learned here.
    cameras : Cameras or None
        Rate, noise and stamp errors of the poses behind the fit; default tunings follow them.
    recordings : tuple of OfRecording
        What each recording says, if some parameters are each recording's own; the model takes its
        values from the last one.

    Raises
    ------
    InputError
        If a parameter is not finite or does not fit the vehicle.

    Examples
    --------
    >>> isinstance(model, airpuck.Model), model.name
    (True, 'M3')
    >>> rest = np.zeros(12)  # x, y, yaw, their rates, six motor speeds
    >>> flown = model.simulate(rest, np.full((10, 6), 0.5), period=0.01)
    >>> flown.shape
    (10, 12)
    """

    name: str
    vehicle: Vehicle
    parameters: Parameters
    free: Bool[np.ndarray, " P"]
    frame: CenterOfMassFrame = "body"
    indexing: Literal["start", "end"] = "start"
    fit: Mapping[str, Any] = field(default_factory=dict)
    data: Mapping[str, str] = field(default_factory=dict)
    source: str = ""
    uncertainty: Uncertainty | None = None
    delay_jitter: DelayJitter | None = None
    cameras: Cameras | None = None
    recordings: tuple[OfRecording, ...] = ()

    def __post_init__(self) -> None:
        self.parameters.check(self.vehicle.n_propellers)

    def __repr__(self) -> str:
        return (
            f"Model({self.name}, {self.vehicle.name!r}, {self.vehicle.n_propellers} propellers, "
            f"{self.free.sum()} of {len(self.free)} parameters learned, from {self.source!r})"
        )

    def _repr_html_(self) -> str:
        return self.html(repr(self))

    def html(self, title: str) -> str:
        """Return the parameters as a table for a notebook.

        Parameters
        ----------
        title : str
            Text above the table.

        Returns
        -------
        str
            HTML.
        """
        return parameters_html(title, self._rows())

    def _rows(self) -> dict[str, dict[str, Any]]:
        """Return a row for each parameter, by its label."""
        return parameter_rows(self.parameters, self.free, self.known, self.vehicle.propeller_names)

    @cached_property
    def dynamics(self) -> Dynamics:
        """Coefficients of the equations of motion; JAX arrays if the parameters are."""
        values = (getattr(self.parameters, q.name) for q in self.parameters.quantities)
        return self.parameters.dynamics(namespace(*values), self.vehicle, self.frame)

    @property
    def rung(self) -> Rung:
        """The rung of the model ladder."""
        return rung_of(self.name, self.parameters.own, self.frame)

    @property
    def radius_of_gyration(self) -> float:
        """√(I/m) [m]: the lever arm at which a force turns the craft as strongly as it pushes."""
        return math.sqrt(float(self.parameters.inertia) / self.vehicle.mass_kg)

    @property
    def propeller_effects(self) -> Float[np.ndarray, "3 n"]:
        """Accelerations per unit of thrust, the angular ones times the radius of gyration [1/kg].

        The optional effects are left out.
        """
        rows = np.array([1.0, 1.0, self.radius_of_gyration])
        return rows[:, None] * np.asarray(self.dynamics.configuration)

    @property
    def transport_delay(self) -> float:
        """Delay from a command's stamp to the motors [s]."""
        return float(self.parameters.transport_delay)

    @property
    def radio_delay(self) -> float:
        """The radio's part of the transport delay: without the actuators' dead time [s]."""
        return max(self.transport_delay - self.vehicle.actuators.dead_time_s, 0.0)

    @property
    def delay_learned(self) -> bool:
        """Whether the transport delay was learned, as a continuous parameter."""
        return learns(self, "transport_delay")

    def with_delay(self, transport_delay: float) -> Model:
        """Return the model with another transport delay.

        Parameters
        ----------
        transport_delay : float
            Delay from a command's stamp to the motors [s].

        Returns
        -------
        Model
            A copy.

        Raises
        ------
        InputError
            If the delay is negative or longer than 10 s.
        """
        return replace(self, parameters=replace(self.parameters, transport_delay=transport_delay))

    def derivative(self, state: Any, command: Any) -> Any:
        """Evaluate the equations of motion, z' = f(z, u) of eq. extended_model_dynamics.

        Works with NumPy, JAX (also under ``jit``, ``grad`` and ``vmap``) and CasADi (``SX`` or
        ``MX``): the result has the arguments' type.

        Parameters
        ----------
        state : array, shape (6 + n, ...)
            x, y [m], γ [rad], vx, vy [m/s], ω [rad/s] and the normalised motor speeds φ; without
            motor lag (τ = 0) the first six alone. A batch is the last axis.
        command : array, shape (n, ...)
            Commands that reach the motors now, in [0, 1].

        Returns
        -------
        array, shape (6 + n, ...) or (6, ...)
            The rate of each state.

        Raises
        ------
        InputError
            If an array has another length.
        """
        return derivative(self.dynamics, state, command)

    def simulate(self, state: Any, commands: Any, period: Any = 0.01) -> Any:
        """Simulate held commands: the craft by Runge-Kutta, motors of a constant lag exactly.

        The transport delay is left out: commands are those that reach the motors. Works with NumPy,
        JAX and CasADi, like `derivative`.

        Parameters
        ----------
        state : array, shape (6 + n, ...) or (6, ...)
            Initial state, as for `derivative`. Omitted motor speeds begin at the first command.
        commands : array, shape (T, n, ...)
            Commands, one for each period.
        period : float or array, shape (T, ...), default 0.01
            How long each command is held [s]; a step of the integrator.

        Returns
        -------
        array, shape (T, 6 + n, ...)
            The state at the end of each period.

        Raises
        ------
        InputError
            If an array has another length, or a period is not above 0.
        """
        return simulate(self.dynamics, self.vehicle, state, commands, period)

    def sample(self, count: int, key: Any = 0) -> list[Model]:
        """Draw models from the normal distribution that the uncertainty describes.

        Draws outside the parameters' bounds, or with a falling thrust curve, are redrawn.

        Parameters
        ----------
        count : int
            How many.
        key : int, numpy Generator or JAX key, default 0
            Seed of the draws.

        Returns
        -------
        list of Model
            Models without an uncertainty of their own.

        Raises
        ------
        InputError
            If the model has no uncertainty, or too few draws describe a possible craft.
        """
        field = f"model {self.name}"
        if self.known is None:
            raise InputError("has no uncertainty to draw from; identify it", field=field)
        drawn = draw(self.parameters, self.known.covariance, count, generator(key), field)
        return [replace(self, parameters=parameters, uncertainty=None) for parameters in drawn]

    @property
    def known(self) -> Uncertainty | None:
        """The uncertainty, unless it belongs to other parameters."""
        known = self.uncertainty
        if known is None or not np.array_equal(known.estimate, self.parameters.to_vector()):
            return None
        return known

    def standard_error(self, quantity: Callable[[Model], Any]) -> Float[np.ndarray, "*shape"]:
        """Compute the standard error of anything computed from the parameters (delta method).

        Parameters
        ----------
        quantity : callable
            ``model -> number or array``, for example ``lambda m: m.parameters.thrust.sum(axis=1)``.

        Returns
        -------
        array
            In the quantity's shape; nan if the model has no uncertainty for these parameters, or if
            the data do not determine the quantity.
        """
        if self.known is None:
            return np.full(np.shape(quantity(self)), np.nan)
        return self.known.propagate(lambda vector: quantity(_moved(self, vector.tobytes())))

    def table(self) -> Any:
        """Return every parameter with its standard error and 95 % interval.

        Returns
        -------
        pandas.DataFrame or dict
            A row for each parameter, by its label: ``value, unit, standard_error, lower_95,
            upper_95, learned``. A dictionary of such rows if pandas is not installed.
        """
        return frame(self._rows())

    def covariance(self) -> Any:
        """Return the covariance of the learned parameters with their labels.

        Returns
        -------
        pandas.DataFrame or dict
            A row and a column for each learned parameter; nan if the model has no uncertainty. A
            dictionary of rows if pandas is not installed.
        """
        nothing = np.full((len(self.free),) * 2, np.nan)
        covariance = nothing if self.known is None else self.known.covariance
        labels = self.parameters.labels(self.vehicle.propeller_names)
        learned = [(labels[entry], entry) for entry in np.flatnonzero(self.free).tolist()]
        return frame({row: {k: float(covariance[i, j]) for k, j in learned} for row, i in learned})

    def to_statespace(
        self,
        yaw: float = 0.0,
        command: Float[np.ndarray, " n"] | None = None,
        period: float | None = None,
    ) -> control.StateSpace:
        """Linearise at rest, for python-control.

        Parameters
        ----------
        yaw : float, default 0
            Orientation of the craft [rad].
        command : array, shape (n,), optional
            Motor commands to linearise about, which the motors have reached; by default near half
            speed, with thrusts that cancel.
        period : float, optional
            Sample time of a discrete-time model with commands held over it [s]; by default the
            model is in continuous time.

        Returns
        -------
        control.StateSpace
            Deviations from the operating point, without the transport delay. Inputs: the motor
            commands. States: x, y, yaw, vx, vy, yaw rate, and the motor speeds if the motors lag.
            Outputs: x, y, yaw.

        Raises
        ------
        InputError
            If python-control is not installed, the number of commands differs from the number of
            propellers, or a number is out of range.
        """
        names = self.vehicle.propeller_names
        return statespace(self.dynamics, self.name, names, yaw, command, period)

    def export(self, kind: str, folder: str | os.PathLike[str], **inputs: Any) -> Any:
        """Write the model, or its controller, for another tool; see `airpuck.export.write`."""
        # Exports build on this package, so nothing here may need them.
        return import_module("airpuck.export").write(self, kind, folder, **inputs)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model as TOML; `read_model` restores every number bit for bit.

        Parameters
        ----------
        path : path-like
            The file to write.
        """
        content = {"format": _FORMAT, **model_content(self)}
        write_toml(path, content, header="An airpuck model; see docs/usage.md for its fields.")


def learns(model: Model, name: str) -> bool:
    """Return whether a quantity of a model, or an entry of it, was learned."""
    return bool(model.free[model.parameters.mask(frozenset({name}))].any())


def read_model(name: str | os.PathLike[str], effects: Sequence[type[Effect]] = ()) -> Model:
    """Read a model.

    Parameters
    ----------
    name : str or path-like
        A model file, the authors' ``params.json``, the YAML of their ROS 2 controller, or
        ``paper:M0`` … ``paper:M4`` for the published parameters. A file with code of your own:
        ``model.toml+FILE.py:NAME``. A file with values of several recordings gives the last one's;
        ``model.toml#2`` gives the second one's.
    effects : sequence of type, optional
        The classes of such effects, if their modules have not been imported.

    Returns
    -------
    Model
        The model.

    Raises
    ------
    InputError
        If there is no such model, or a field is wrong.

    Examples
    --------
    >>> model = airpuck.read_model("paper:M3")
    >>> model.save("model.toml")
    >>> airpuck.read_model("model.toml").name
    'M3'
    """
    if isinstance(name, str) and name.startswith("paper:"):
        return published_model(name.removeprefix("paper:"))
    if cut := re.fullmatch(r"(.+\.toml)#(\d+)((?:\+.*)?)", str(name)):
        return of_recording(read_model(cut[1] + cut[3], effects), int(cut[2]), cut[1])
    name, named = with_code(name, "model")
    try:
        if Path(name).suffix == ".json":
            return Model(**read_params_json(Path(name)))
        if Path(name).suffix in {".yaml", ".yml"}:
            return Model(**read_params_yaml(Path(name)))
        content = load_toml(name)
        # Older files have the transport delay beside the parameters.
        if "transport_delay_s" in content and isinstance(content.get("parameters"), dict):
            content["parameters"].setdefault("transport_delay_s", content.pop("transport_delay_s"))
        return Model(**read_fields(checked(content, ModelFile, file=name), (*effects, *named)))
    except InputError as error:
        if str(name) in _published() and not Path(name).exists():
            problem = f"there is no such file; the published parameters are paper:{name}"
            raise InputError(problem, file=name) from None
        raise InputError(error.problem, file=error.file or name, field=error.field) from None


def _published() -> dict[str, Any]:
    """Return the parameters published with the paper, by model."""
    with resources.as_file(resources.files("airpuck") / "packaged" / "paper.toml") as path:
        return load_toml(path)


def published_model(name: str) -> Model:
    """Return a model with the parameters published with the paper; see `read_model`."""
    published = _published()
    there_are = ", ".join(f"paper:{key}" for key in published)
    problem = f"there is no published model {name!r}; choose one of {there_are}"
    check_known(name, published, problem, field="model")
    vehicle = default_vehicle()
    parameters = with_nominal_delay(published[name], vehicle)
    source = f"published parameters of {name}, doi:10.1016/j.ifacol.2024.08.543"
    return Model(**of_authors(name, vehicle, parameters, RUNGS[name].mask(parameters), source))


def nominal_model(vehicle: Vehicle) -> Model:
    """Return the model of a craft that has not flown: the nominal values of its vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        The craft.

    Returns
    -------
    Model
        Without learned parameters.

    Examples
    --------
    >>> guess = airpuck.nominal_model(airpuck.default_vehicle())
    >>> guess.name, int(guess.free.sum())
    ('nominal', 0)
    """
    parameters, source = nominal_parameters(vehicle), f"nominal values of {vehicle.name}"
    return Model("nominal", vehicle, parameters, parameters.mask(frozenset()), source=source)
