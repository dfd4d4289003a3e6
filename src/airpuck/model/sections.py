"""Tables of a model file: values of the parameters, and their uncertainty."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_origin

import numpy as np
import pydantic
from jaxtyping import Bool, Float

from airpuck.boundary.errors import InputError, about, check_known
from airpuck.boundary.extensions import added
from airpuck.boundary.files import Section, checked
from airpuck.craft.vehicle import Vehicle
from airpuck.model.parameters import Parameters, with_own
from airpuck.model.quantities import EFFECTS, QUANTITIES, Matrix, Quantity, quantity_of
from airpuck.model.rungs import effect_named
from airpuck.model.uncertainty import Bootstrap, Cameras, DelayJitter, Uncertainty
from airpuck.physics.effects import Effect
from airpuck.physics.rigid_body import CenterOfMassFrame


class NanSection(Section):
    """A table in which nan marks unknown values."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=True)


def _one_field_each(section: type[Section], *, bounded: bool) -> type[Section]:
    """Add a field for each quantity, and for the coefficients of ``[effects]``, to a section.

    A quantity is required only if values are bounded.
    """
    entries: dict[str, Any] = {}
    for q in QUANTITIES:
        kind = q.toml if bounded or get_origin(q.toml) is not Annotated else float
        required = bounded and q.default is not None
        entries[q.key] = (kind, ...) if required else (kind | None, None)
    entries["effects"] = (dict[str, tuple[float, ...]], pydantic.Field(default_factory=dict))
    return pydantic.create_model(section.__name__, __base__=section, **entries)


class ParametersSection(_one_field_each(Section, bounded=True)):
    """The table ``[parameters]``."""


class StandardErrors(_one_field_each(NanSection, bounded=False)):
    """The table ``[uncertainty.standard_errors]``."""


class OwnEffect(NanSection):
    """One of ``[effects]``: an effect of the user's own, by its name."""

    #: Its class: FILE.py:NAME or MODULE:NAME.
    source: str
    #: By coefficient: where a fit starts, and its bounds.
    start: dict[str, float]
    bounds: dict[str, tuple[float, float]]


def model_content(model: Any) -> dict[str, Any]:
    """Return what a model file holds of a `Model`, without the format."""
    learned, free = model.parameters.with_vector(model.free), {}
    for quantity in model.parameters.quantities:
        entries = np.ravel(getattr(learned, quantity.name)).tolist()
        free[quantity.name] = entries[0] if len(set(entries)) == 1 else entries
    content = {
        "name": model.name,
        "source": model.source,
        "center_of_mass_frame": model.frame,
        "encoder_indexing": model.indexing,
        "parameters": parameters_content(model.parameters),
        "free": free,
        "fit": dict(model.fit),
        "data": dict(model.data),
    }
    if model.parameters.own:
        content["effects"] = {q.name: _declaration(q) for q in model.parameters.own}
    if model.known is not None:
        content["uncertainty"] = uncertainty_content(model.known, model.parameters, model.vehicle)
    for name in ("delay_jitter", "cameras"):
        if (section := getattr(model, name)) is not None:
            content[name] = section.model_dump()
    if model.recordings:
        content["recordings"] = [_recording_content(one, model) for one in model.recordings]
    content["vehicle"] = model.vehicle.model_dump(mode="json")
    return content


def _recording_content(one: Any, model: Any) -> dict[str, Any]:
    """Return what a model file holds of one of several recordings."""
    content = {"source": one.source, "parameters": parameters_content(one.parameters)}
    if one.uncertainty is not None:
        content["uncertainty"] = uncertainty_content(one.uncertainty, one.parameters, model.vehicle)
    return content


def _declaration(quantity: Quantity) -> dict[str, Any]:
    """Return what a model file holds of a user's effect."""
    names = quantity.entries((), 0)
    bounds = dict(zip(names, zip(*quantity.bounds, strict=True), strict=True))
    start = dict(zip(names, np.ravel(quantity.start).tolist(), strict=True))
    return {"source": quantity.term, "start": start, "bounds": bounds}


def parameters_content(parameters: Parameters) -> dict[str, Any]:
    """Return the numbers of all quantities by their keys."""
    content = {
        q.key: np.asarray(getattr(parameters, q.name)).tolist() for q in parameters.quantities
    }
    own = {q.key: content.pop(q.key) for q in parameters.own}
    return content | ({"effects": own} if own else {})


def read_parameters(section: Any, vehicle: Vehicle, own: Sequence[Quantity] = ()) -> Parameters:
    """Return the parameters in a table; raise InputError if numbers do not fit the vehicle."""
    values = {}
    for quantity in QUANTITIES:
        value = getattr(section, quantity.key)
        if isinstance(value, tuple):
            value = _array(value)
            if value is None:
                raise InputError(
                    "its rows must all have the same length", field=f"parameters.{quantity.key}"
                )
        values[quantity.name] = value
    found, weights = Parameters(**values), values["residual"]
    keys = {f"parameters.{q.name}": f"parameters.{q.key}" for q in QUANTITIES}
    with about(None, lambda field: keys.get(field, field)):
        found.check(vehicle.n_propellers)
    if weights is not None:
        needed = len(EFFECTS["residual"].entries(vehicle.propeller_names, 0))
        if weights.shape != (needed,):
            raise InputError(f"must be {needed} numbers", field="parameters.residual")
    for quantity in own:
        if len(section.effects.get(quantity.name, ())) != len(quantity.entries((), 0)):
            names = ", ".join(quantity.entries((), 0))
            field = f"parameters.effects.{quantity.name}"
            raise InputError(f"must have one number for each of {names}", field=field)
    return with_own(found, {q: section.effects[q.name] for q in own}) if own else found


def read_own(
    declared: Mapping[str, OwnEffect], given: Sequence[type[Effect]]
) -> Iterator[Quantity]:
    """Yield the quantities of the user's effects, whose classes are given or imported already.

    A file never runs code that its reader has not named.
    """
    for name, one in declared.items():
        module, _, attribute = one.source.rpartition(":")
        found = {kind.__name__: kind for kind in given}.get(attribute or one.source)
        if found is None and module in sys.modules:
            found = getattr(sys.modules[module], attribute, None)
        if found is None and one.source in added("airpuck.effects"):
            found = effect_named(one.source)
        if found is None:
            raise InputError(
                f"uses code that is not in the file, {one.source}: append +{one.source} to the "
                f"name of the model, or call read_model(…, effects=[{attribute}])",
                field=f"effects.{name}",
            )
        quantity = quantity_of(found, one.source, one.start, one.bounds)
        if quantity.name != name or set(quantity.entries((), 0)) != set(one.start):
            problem = f"was learned with a {name} that differs from {one.source}: identify it again"
            raise InputError(problem, field=f"effects.{name}")
        yield quantity


def read_free(
    free: Mapping[str, bool | tuple[bool, ...]], parameters: Parameters
) -> Bool[np.ndarray, " P"]:
    """Return which entries a file marks as learned."""
    sizes = {q.name: np.size(getattr(parameters, q.name)) for q in parameters.quantities}
    for name, entries in free.items():
        problem = f"is not a known key; it must be one of {', '.join(sorted(sizes))}"
        check_known(name, sizes, problem, field=f"free.{name}")
        if not isinstance(entries, bool) and len(entries) != sizes[name]:
            raise InputError(f"must be one truth value or {sizes[name]}", field=f"free.{name}")
    return parameters.laid_out(free, False)


def with_nominal_delay(
    section: Mapping[str, Any], vehicle: Vehicle, file: Path | None = None
) -> Parameters:
    """Read published parameters, which include no transport delay."""
    content = {**section, "transport_delay_s": vehicle.nominal.transport_delay_s}
    return read_parameters(checked(content, ParametersSection, file=file), vehicle)


def _array(rows: tuple[Any, ...]) -> np.ndarray | None:
    """Return numbers or rows of numbers as an array; None if rows differ in length or are empty."""
    try:
        array = np.array(rows, dtype=float)
    except ValueError:
        return None
    return array if array.size else None


class BootstrapSection(NanSection):
    """The table ``[uncertainty.bootstrap]``."""

    #: Number of fits to resampled data, and the seed of the resampling.
    replicates: int = pydantic.Field(ge=0)
    seed: int
    #: Ends of the 95 % intervals, in the order of the labels.
    lower: tuple[float, ...]
    upper: tuple[float, ...]


class UncertaintySection(NanSection):
    """The table ``[uncertainty]``; `labels` names rows and columns of the covariance."""

    method: Literal["sandwich"] = "sandwich"
    #: Number of independent blocks of time.
    clusters: int = pydantic.Field(ge=0)
    #: Half width of a 95 % interval, in standard errors.
    quantile_95: float
    #: Sentences.
    notes: tuple[str, ...] = ()
    #: Parameters with an uncertainty.
    labels: tuple[str, ...]
    #: In the order of the labels.
    covariance: Matrix
    #: Directions that the data do not determine, one in each row.
    undetermined: Matrix = ()
    #: The keys of ``[parameters]``.
    standard_errors: StandardErrors
    bootstrap: BootstrapSection | None = None


class RecordingSection(NanSection):
    """One of ``[[recordings]]``: a recording with parameters of its own."""

    #: The recording.
    source: str
    #: All parameters, with its own values.
    parameters: ParametersSection
    #: Their standard errors and covariance.
    uncertainty: UncertaintySection | None = None


class ModelFile(Section):
    """A craft with known parameters; every number is read back bit for bit."""

    format: Literal["airpuck model 1"]
    #: The rung.
    name: str
    #: Origin of the numbers.
    source: str = ""
    #: Frame in which the offset of the centre of mass is constant.
    center_of_mass_frame: CenterOfMassFrame = "body"
    #: ``end`` as in the code behind the published numbers.
    encoder_indexing: Literal["start", "end"] = "start"
    #: Values of the parameters.
    parameters: ParametersSection
    #: Effects of the user's own. The file does not contain their code; its reader has to name it.
    effects: dict[str, OwnEffect] = pydantic.Field(default_factory=dict)
    #: What was learned: true, false, or one boolean for each entry. Its keys are names of
    #: quantities without units, such as ``thrust``. A missing key means not learned.
    free: dict[str, bool | tuple[bool, ...]] = pydantic.Field(default_factory=dict)
    #: The fit: loss, iterations, method, windows and lengths (in samples), faults left out, choice
    #: of the rung, version of airpuck.
    fit: dict[str, Any] = pydantic.Field(default_factory=dict)
    #: SHA-256 of every file that the model was learned from.
    data: dict[str, str] = pydantic.Field(default_factory=dict)
    #: Standard errors and covariance, of an identified model.
    uncertainty: UncertaintySection | None = None
    #: Of a learned delay: how much it differs between packets.
    delay_jitter: DelayJitter | None = None
    #: The poses that it was learned from; controllers are tuned to them.
    cameras: Cameras | None = None
    #: Values of each recording, if some parameters are each recording's own.
    recordings: tuple[RecordingSection, ...] = ()
    #: The vehicle file.
    vehicle: Vehicle


def uncertainty_content(
    uncertainty: Uncertainty, parameters: Parameters, vehicle: Vehicle
) -> dict[str, Any]:
    """Return the table ``[uncertainty]``, without entries that have no uncertainty."""
    labels = np.array(parameters.labels(vehicle.propeller_names))
    errors, bootstrap = uncertainty.standard_errors, uncertainty.bootstrap
    used = (uncertainty.covariance != 0).any(axis=0) | np.isfinite(errors)
    used |= (uncertainty.undetermined != 0).any(axis=0)
    if bootstrap is not None:
        used |= np.isfinite(bootstrap.lower)
    content = {
        "method": "sandwich",
        "clusters": uncertainty.clusters,
        "quantile_95": uncertainty.quantile,
        "notes": list(uncertainty.notes),
        "labels": labels[used].tolist(),
        "covariance": uncertainty.covariance[np.ix_(used, used)].tolist(),
        "undetermined": uncertainty.undetermined[:, used].tolist(),
        "standard_errors": {
            key: value
            for key, value in parameters_content(parameters.with_vector(errors)).items()
            if key == "effects" or np.isfinite(value).any()
        },
    }
    if bootstrap is not None:
        content["bootstrap"] = {
            "replicates": bootstrap.replicates,
            "seed": bootstrap.seed,
            "lower": bootstrap.lower[used].tolist(),
            "upper": bootstrap.upper[used].tolist(),
        }
    return content


def read_uncertainty(
    section: UncertaintySection, parameters: Parameters, vehicle: Vehicle
) -> Uncertainty:
    """Return the uncertainty in a table; raise InputError if numbers do not fit the model."""
    labels = parameters.labels(vehicle.propeller_names)
    for label in section.labels:
        problem = f"has {label!r}, which is no parameter of this model"
        check_known(label, labels, problem, field="uncertainty.labels")
    at = np.array([labels.index(label) for label in section.labels], dtype=int)
    size = len(labels)
    covariance, undetermined = np.zeros((size, size)), np.zeros((len(section.undetermined), size))
    covariance[np.ix_(at, at)] = _rows(section.covariance, "covariance", len(at), len(at))
    undetermined[:, at] = _rows(
        section.undetermined, "undetermined", len(section.undetermined), len(at)
    )
    return Uncertainty(
        estimate=parameters.to_vector(),
        covariance=covariance,
        standard_errors=_standard_errors(section.standard_errors, parameters),
        undetermined=undetermined,
        clusters=section.clusters,
        quantile=section.quantile_95,
        notes=section.notes,
        bootstrap=section.bootstrap and _bootstrap(section.bootstrap, at, size),
    )


def _rows(rows: Matrix, key: str, count: int, length: int) -> Float[np.ndarray, "count length"]:
    """Return a matrix with one column for each label."""
    if len(rows) != count or any(len(row) != length for row in rows):
        raise InputError(
            f"must have rows of {length} numbers, one for each label", field=f"uncertainty.{key}"
        )
    return np.array(rows, dtype=float).reshape(count, length)


def _standard_errors(section: Any, parameters: Parameters) -> Float[np.ndarray, " P"]:
    """Return the standard errors of all entries."""
    given = {}
    for quantity in parameters.quantities:
        errors = getattr(section, quantity.key, section.effects.get(quantity.name))
        if errors is None:
            continue
        array = _array(errors) if isinstance(errors, tuple) else np.array(errors)
        if array is None or array.shape != np.shape(getattr(parameters, quantity.name)):
            raise InputError(
                "must have the shape of the parameter",
                field=f"uncertainty.standard_errors.{quantity.key}",
            )
        given[quantity.name] = array
    return parameters.laid_out(given, np.nan)


def _bootstrap(section: BootstrapSection, at: Any, size: int) -> Bootstrap:
    """Return the intervals of all entries."""
    ends = np.full((2, size), np.nan)
    ends[:, at] = _rows((section.lower, section.upper), "bootstrap", 2, len(at))
    return Bootstrap(section.replicates, section.seed, *ends)


@dataclass(frozen=True, eq=False)
class OfRecording:
    """What one of several recordings says about the craft: its parameters, and their errors."""

    source: str
    parameters: Parameters
    uncertainty: Uncertainty | None


def of_recording(model: Any, number: int, file: str) -> Any:
    """Return a model with the values of another recording, counted from 1, that it is from."""
    count = len(model.recordings)
    if not 1 <= number <= count:
        last = f"must be from 1 to {count}, not {number}"
        none = "has no effect: all recordings share all parameters; identify with --each"
        raise InputError(last if count else none, file=file, field=f"#{number}")
    found = model.recordings[number - 1]
    values = {"parameters": found.parameters, "uncertainty": found.uncertainty}
    return model if number == count else replace(model, source=found.source, **values)


def read_fields(content: ModelFile, effects: Sequence[type[Effect]]) -> dict[str, Any]:
    """Return the fields of the model that a checked file describes."""
    own = tuple(read_own(content.effects, effects))

    def known(section: Any) -> tuple[Parameters, Uncertainty | None]:
        parameters = read_parameters(section.parameters, content.vehicle, own)
        found = section.uncertainty
        return parameters, found and read_uncertainty(found, parameters, content.vehicle)

    parameters, uncertainty = known(content)
    alike = "name vehicle fit data source delay_jitter cameras"
    return {
        "parameters": parameters,
        "free": read_free(content.free, parameters),
        "frame": content.center_of_mass_frame,
        "indexing": content.encoder_indexing,
        "uncertainty": uncertainty,
        "recordings": tuple(OfRecording(one.source, *known(one)) for one in content.recordings),
        **{name: getattr(content, name) for name in alike.split()},
    }
