"""Items of campaigns, each fully described by its fields.

A worker imports this module; what only one kind needs is imported when it runs.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
import pydantic
from jaxtyping import Float

import airpuck
from airpuck.boundary import numbers
from airpuck.boundary.errors import InputError
from airpuck.boundary.files import Fraction, Section, checked, laid_over
from airpuck.campaigns.fingerprints import of_file, of_recording, program
from airpuck.control.laws import check_law
from airpuck.control.settings import DWELL, ControllerKind, Dwell, ExcitationPlan
from airpuck.control.tuning import Tuning, default_tuning, tuning_for
from airpuck.craft.vehicle import default_vehicle, read_vehicle
from airpuck.identification.settings import ComFrame, Degree, Loss, Stride
from airpuck.model.model_file import Model, read_model
from airpuck.model.parameters import Parameters
from airpuck.model.rungs import named_rung
from airpuck.physics.thrust import thrust
from airpuck.twin.settings import TwinSettings

if TYPE_CHECKING:
    from airpuck.data.trajectory import Trajectory
    from airpuck.identification.fit_result import Fit
    from airpuck.identification.structure import ModelStructure

#: A number; null in JSON stands for NaN.
Figure = Annotated[float, pydantic.BeforeValidator(lambda v: math.nan if v is None else v)]
#: Results of an item, by name.
Row = dict[str, Figure]


def _known_rung(name: str) -> str:
    """Check that a rung exists."""
    try:
        named_rung("M3" if name == "auto" else name)
    except InputError as error:
        raise ValueError(error.problem) from None
    return name


def _tuning(table: dict[str, Any], usual: Tuning) -> Tuning:
    """Complete a table that lists only differences from the model's usual tuning."""
    return checked(laid_over(usual.model_dump(mode="json"), table), Tuning)


_VALID = pydantic.AfterValidator(lambda table: _tuning(table, default_tuning()) and table)
TuningTable = Annotated[dict[str, Any], _VALID]
RungName = Annotated[str, pydantic.AfterValidator(_known_rung)]
Natural = Annotated[int, pydantic.Field(ge=0)]
Count = Annotated[int, pydantic.Field(ge=1)]
_CLASS = re.compile(r"(?<=\.py):[^:/]*$")
Fingerprint = Callable[[str], str]


class Item(Section):
    """Base of all kinds of items."""

    #: Fields that name models, recordings or tactics, each with the function that hashes its
    #: content for the key.
    SOURCES: ClassVar[Mapping[str, Fingerprint]] = {}
    #: Names that are no files, such as paper:M3.
    PACKAGED: ClassVar[tuple[str, ...]] = ("paper",)

    #: Seed of all random numbers.
    seed: Natural = 0

    @abstractmethod
    def run(self) -> list[Row]:
        """Compute the item's figures."""

    def reporting(self, tell: Callable[[float], None]) -> Item:
        """Return an item that may report its progress through `tell` (0 to 1)."""
        return self

    def written(self) -> str | None:
        """Hash the files that the item wrote; None if it writes none."""
        return None

    def key(self, known: dict[tuple[Fingerprint, str], str] | None = None) -> str:
        """Hash the fields, the files they name (cached in `known`) and our code."""
        content, known = self.model_dump(mode="json"), {} if known is None else known
        for field, fingerprint in self.SOURCES.items():
            names = content[field] if isinstance(content[field], list) else [content[field]]
            content[field] = [self._identity(name, fingerprint, known) for name in names]
        own = type(self)
        text = json.dumps([own.__name__, program(own.__module__), content], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:20]

    @classmethod
    def is_file(cls, name: str | None) -> bool:
        """Return whether a name is a file."""
        return name is not None and name.partition(":")[0] not in cls.PACKAGED

    @classmethod
    def _identity(
        cls, name: str | None, fingerprint: Fingerprint, known: dict[tuple[Fingerprint, str], str]
    ) -> str | None:
        """Return the identity of a name for keys: the hash of a file, and the class in it."""
        if name is None or not cls.is_file(name):
            return name
        attribute, file = _CLASS.search(name), _CLASS.sub("", name)
        if (fingerprint, file) not in known:
            known[fingerprint, file] = fingerprint(file)
        return known[fingerprint, file] + (attribute.group() if attribute else "")


class TwinItem(Item):
    """Base of items that fly a twin."""

    SOURCES: ClassVar = {"truth": of_file}

    #: Model of the twin.
    truth: str = "paper:M3"
    #: Random spread of the truth: e^(spread · N), with N normal, multiplies each thrust curve, the
    #: inertia and the motor lag.
    truth_spread: Fraction = 0.0
    #: Settings of the twin, which override the paper's.
    twin: TwinSettings = TwinSettings()

    def craft(self) -> Model:
        """Return the model of the twin."""
        from airpuck.twin.plant import varied

        return varied(read_model(self.truth), self.truth_spread, self.seed)


class Identification(Item):
    """Base of items that identify a model."""

    #: Rung to identify; by default M3 with the terms that the recordings clearly show.
    model: RungName | None = None
    #: Samples from one window to the next; by default 7/240 s.
    stride: Stride = None
    #: Whether poorly predicted windows get less weight.
    robust: bool = Loss.robust

    def loss(self, data: Trajectory) -> Loss:
        """Return the loss of the fit."""
        spacing = Loss.spacing if self.stride is None else self.stride * data.sample_period
        return Loss(spacing=spacing, robust=self.robust)


class Tracking(TwinItem):
    """One flight of the twin through the paper's set points, in closed loop."""

    SOURCES: ClassVar = {"model": of_file, "truth": of_file}
    MOVED: ClassVar = {"regulator": "law"}

    truth: str = "paper:M4"
    #: Model of the controller.
    model: str = "paper:M4"
    #: Time at each set point.
    dwell_s: Dwell = DWELL
    #: ``paper``, or ``full``, which also compensates the delay and rejects disturbances: the
    #: default of ``mpc``.
    controller: ControllerKind = None
    #: Tuning, which overrides the tuning for the model.
    tuning: TuningTable = pydantic.Field(default_factory=dict)
    #: By default the law of the tuning file.
    law: Annotated[str, pydantic.AfterValidator(check_law)] | None = None

    def run(self) -> list[Row]:
        """Fly; see `Item.run`."""
        model = read_model(self.model)
        (flown,) = airpuck.tracking_study(
            [model],
            self.craft(),
            dwell=self.dwell_s,
            seed=self.seed,
            controller=self.controller,
            laws=() if self.law is None else (self.law,),
            settings=self.twin,
            tuning=_tuning(self.tuning, tuning_for(model)),
        )
        return [{**flown.figures(), "clearance_m": float(flown.clearance.min())}]


class Recovery(TwinItem, Identification, ExcitationPlan):  # pyright: ignore[reportGeneralTypeIssues]
    """One excitation flight of the twin, with a fit that is compared with the truth."""

    @pydantic.model_validator(mode="after")
    def _excites(self) -> Recovery:
        if not np.any(self.amplitude):
            raise InputError("must be above 0 for at least one signal", field="amplitude")
        return self

    def run(self) -> list[Row]:
        """Fly, identify, compare; see `Item.run`."""
        from airpuck.twin.radio import as_received

        # As in the fitted model, the offset of the centre of mass is fixed in the body.
        truth = replace(self.craft(), frame="body", indexing="start")
        recording = airpuck.excite(
            truth,
            self.duration_s,
            self.seed,
            amplitude=self.amplitude,
            hold=self.hold_s,
            margin=self.margin_m,
            settings=self.twin,
        )
        data = airpuck.preprocess(recording, truth.vehicle)
        fit = airpuck.identify(data, self.model or "M3", loss=self.loss(data))
        delay = as_received(truth, self.twin, tuning_for(truth).period_s).transport_delay
        delay_error = {"delay_s": fit.model.transport_delay - delay}
        return [{**recovery_errors(fit.model, truth), **delay_error, **_progress(fit)}]


class Fitting(Identification):
    """One fit to recordings, or `resamplings` fits to data drawn with replacement."""

    SOURCES: ClassVar = {"recordings": of_recording, "validation": of_recording, "vehicle": of_file}

    #: Recordings to learn from.
    recordings: Annotated[tuple[str, ...], pydantic.Field(min_length=1)]
    #: Recording for validation by the paper's protocol.
    validation: str | None = None
    #: Vehicle file; by default the paper's craft.
    vehicle: str | None = None
    #: Part of each recording to learn from, as fractions of its length.
    span: tuple[float, float] | None = None
    #: Relative random spread of the start around nominal values; see `moved`.
    start_spread: Fraction = 0.0
    #: Number of fits to blocks of time drawn with replacement; each starts at the fit to all data.
    resamplings: Annotated[Natural, pydantic.Field(le=numbers.REPLICATES.high)] = 0
    #: Degree of the thrust polynomials.
    degree: Degree = None
    #: Frame in which the offset of the centre of mass is constant.
    frame: ComFrame = "body"

    @pydantic.model_validator(mode="after")
    def _resamples_plain_fits(self) -> Fitting:
        if self.resamplings == 1:
            raise ValueError("resamplings must be 0 or at least 2")
        if self.resamplings and (self.robust or self.start_spread):
            raise ValueError("resamplings cannot be combined with robust or start_spread")
        return self

    def run(self) -> list[Row]:
        """Fit; see `Item.run`."""
        from airpuck.evaluation.evaluate import by_channel
        from airpuck.judgement.study import judged

        if self.resamplings:
            return self._resampled()
        fit, structure = self.fit()
        said = judged(fit, structure, self._parts()).verdict
        row = _progress(fit) | {"windows": float(fit.windows)} | _labelled(fit.model)
        row |= {key: float(said.outcome == key) for key in ("trusted", "suspect_recording")}
        if self.validation is not None:
            rmse = airpuck.evaluate(fit.model, self._load(self.validation)).rmse
            row |= {f"rmse_{name}": error for name, error in by_channel(rmse).items()}
        return [row]

    def _load(self, name: str) -> Trajectory:
        vehicle = self.vehicle
        return _trajectory(name, vehicle, of_recording(name), vehicle and of_file(vehicle))

    def _parts(self) -> list[Trajectory]:
        """Return the parts of the recordings to learn from."""
        trajectories = [self._load(name) for name in self.recordings]
        return [one.slice(*self.span) if self.span else one for one in trajectories]

    def fit(self) -> tuple[Fit, ModelStructure]:
        """Identify a model; `start_spread` and the seed set the start."""
        from airpuck.identification.problem import mean_delay
        from airpuck.identification.structure import structured
        from airpuck.twin.plant import moved

        craft = default_vehicle() if self.vehicle is None else read_vehicle(self.vehicle)
        trajectories = self._parts()
        structure: dict[str, Any] = {"degree": self.degree, "frame": self.frame}
        name = self.model or ("M3" if self.start_spread else None)
        start = None
        if self.start_spread:
            delay = mean_delay(trajectories, craft)
            rung = named_rung(name or "M3", **structure)
            nominal = replace(rung.initial(craft), transport_delay=delay)
            elsewhere = moved(nominal, self.start_spread, self.seed).to_vector()
            learned = rung.mask(nominal, craft)
            start = nominal.with_vector(np.where(learned, elsewhere, nominal.to_vector()))
        given: Any = {"vehicle": craft, "initial": start, "loss": self.loss(trajectories[0])}
        return structured(trajectories, name, **structure, **given)

    def _resampled(self) -> list[Row]:
        """Fit to resampled data, each time starting from the fit to all data."""
        from airpuck.identification.bootstrap import resampled_estimates

        # A frozen pydantic model has a hash, which the type checker does not see.
        whole: Any = self.model_copy(update={"seed": 0, "resamplings": 0})
        fit = _fit_to_all(whole, whole.key())
        model = fit.model
        estimates = resampled_estimates(fit, self.resamplings, seed=self.seed)
        return [_labelled(model, model.parameters.with_vector(e)) for e in estimates]


class ShortestTime(Item):
    """The shortest time for a moving craft to reach a place; the seed sets its initial yaw."""

    SOURCES: ClassVar = {"model": of_file}

    #: Model of the craft.
    model: str = "paper:M3"
    #: Distance to the goal, and speed at the start.
    distance_m: Annotated[float, pydantic.Field(ge=0, le=10)]
    speed_m_s: Annotated[float, pydantic.Field(ge=0, le=3)] = 0.0
    #: Angle between the velocity and the direction to the place.
    direction_rad: Annotated[float, pydantic.Field(ge=0, le=math.pi)] = 0.0
    #: ``rest``; ``any``: pass with any velocity.
    arrival: Literal["rest", "any"] = "rest"

    def run(self) -> list[Row]:
        """Plan; see `Item.run`."""
        from airpuck.planning.minimal_time import shortest_time

        yaw = np.random.default_rng(self.seed).uniform(-np.pi, np.pi)
        velocity = self.speed_m_s * np.array(
            [np.cos(self.direction_rad), np.sin(self.direction_rad)]
        )
        # A worker builds the solver once for all items with this model.
        model = _planned(self.model, *(() if ":" in self.model else (of_file(self.model),)))
        time = shortest_time(model, self.distance_m, velocity.tolist(), float(yaw), self.arrival)
        return [{"time_s": time}]


# Items of one campaign share recordings, and resamplings share their initial fit. The keys of these
# caches include file hashes, because a file may change during the life of a worker.
@lru_cache(maxsize=8)
def _trajectory(name: str, vehicle: str | None, *_hashes: str | None) -> Trajectory:
    return airpuck.load_trajectory(name, None if vehicle is None else read_vehicle(vehicle))


@lru_cache(maxsize=8)
def _planned(name: str, *_hashes: str) -> Model:
    return read_model(name)


@lru_cache(maxsize=8)
def _fit_to_all(item: Fitting, _key: str) -> Fit:
    return item.fit()[0]


def thrust_error(model: Model, truth: Model) -> Float[np.ndarray, " n"]:
    """Return the relative RMS error of each thrust curve over all speeds."""
    speeds = np.tile(np.linspace(0.03, 1, 200), (len(truth.parameters.thrust), 1))
    found, true = (thrust(m.dynamics.thrust, speeds) for m in (model, truth))
    return np.sqrt(np.mean((found - true) ** 2, axis=1) / np.mean(true**2, axis=1))


def recovery_errors(model: Model, truth: Model) -> Row:
    """Return relative errors of a model; of α and the centre of mass, differences."""
    found, true = model.parameters, truth.parameters
    return {
        "thrust": float(thrust_error(model, truth).max()),
        "motor_time_constant": float(found.motor_time_constant / true.motor_time_constant - 1),
        "inertia": float(found.inertia / true.inertia - 1),
        "angle_offset_rad": float(found.angle_offset - true.angle_offset),
        "center_of_mass_m": float(np.linalg.norm(found.center_of_mass - true.center_of_mass)),
    }


def _progress(fit: Fit) -> Row:
    """Return loss, iterations and convergence of a fit."""
    return {name: float(getattr(fit, name)) for name in ("loss", "iterations", "converged")}


def _labelled(model: Model, parameters: Parameters | None = None) -> Row:
    """Return the parameters, by default the model's, by label."""
    labels = model.parameters.labels(model.vehicle.propeller_names)
    vector = (model.parameters if parameters is None else parameters).to_vector()
    return dict(zip(labels, vector.tolist(), strict=True))
