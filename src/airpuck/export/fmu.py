"""A co-simulation FMU (FMI 3.0, source code) of the craft on its table."""

from __future__ import annotations

import math
import tempfile
import uuid
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.boundary.outputs import rendered
from airpuck.export.c import coefficients, constant, copy_sources, title, write_model
from airpuck.export.kinds import Subject, refuse_actuators, refuse_settings
from airpuck.physics.puck import Disc
from airpuck.twin.plant import build_plant
from airpuck.twin.settings import TwinSettings

#: Name of the FMU and of its library.
NAME = "airpuck"
#: Files to compile. They include `fmi3Functions.h`, which the importing tool provides: FMI 3.0
#: excludes its own headers from a unit (section 2.5.1, structure of the ZIP file).
_SOURCES = ("airpuck_plant.c", "airpuck_fmu.c", "airpuck_fmu_absent.c")
#: Settings of the twin that the FMU cannot represent.
_REFUSED = (
    "radio.outages_s",
    *(f"motion_capture.{name}" for name in ("gaps_s", "clock_offset_s", "clock_drift")),
    "motion_capture.stamp_step_s",
    "effects.battery_sag_1_s",
    "motors",
)
#: Largest values of parameters: times [s], frame rate [Hz], noise [m or rad].
_TIME, _RATE, _NOISE = 10.0, 1e5, 10.0


@dataclass(frozen=True)
class Variable:
    """A variable of the FMU; its value reference is its index in the list."""

    name: str
    causality: str
    description: str
    unit: str | None = None
    start: float | None = None
    low: float = -math.inf
    high: float = math.inf
    variability: str = "discrete"
    #: XML element that describes it.
    kind: str = "Float64"


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write the FMU; see `airpuck.export.kinds.ExportKind`."""
    check(subject)
    model = subject.model
    plant = build_plant(model, subject.twin, compiled=False)
    listed = variables(subject)
    table = _variable_table(listed)
    craft = _craft(plant.disc)
    numbers = constant("airpuck_model", "", coefficients(model, plant.dynamics))
    token = str(uuid.uuid5(uuid.NAMESPACE_OID, f"{airpuck.__version__}{numbers}{craft}{listed}"))
    with tempfile.TemporaryDirectory() as made:
        unit = Path(made)
        sources = unit / "sources"
        sources.mkdir()
        write_model(
            model,
            sources,
            kind="fmu",
            dynamics=plant.dynamics,
            sizes={**_references(listed), "AIRPUCK_TOKEN": f'"{token}"'},
            data={"airpuck_plant.h": f"{craft}\n\n{table}"},
        )
        copy_sources([f"fmu/{name}" for name in ("airpuck_plant.h", *_SOURCES)], sources)
        licences = unit / "documentation" / "licenses"
        licences.mkdir(parents=True)
        copy_sources(["LICENSE"], licences)
        (licences / "LICENSE").rename(licences / "license.txt")
        build = rendered("buildDescription.xml.jinja", name=NAME, sources=_SOURCES)
        (sources / "buildDescription.xml").write_text(build, encoding="utf-8")
        description = _description(subject, listed, token)
        (unit / "modelDescription.xml").write_text(description, encoding="utf-8")
        _zip(unit, folder / f"{NAME}.fmu")
    counts = {c: sum(v.causality == c for v in listed) for c in ("input", "parameter", "output")}
    return {
        "unit": f"{NAME}.fmu, FMI 3.0, co-simulation, source code",
        **{f"{causality}s": count for causality, count in counts.items()},
        "not in the FMU": "goals, puck and mallet, on-board sensors, the radio's timeout",
    }


def check(subject: Subject) -> None:
    """Raise InputError for what the FMU cannot represent."""
    model, twin = subject.model, subject.twin
    refuse_actuators(model, "fmu")
    for name in model.vehicle.propeller_names:
        if not name.isprintable():
            raise InputError(f"has a propeller called {name!r}; rename it", field="MODEL")
    refuse_settings(twin, "fmu", _REFUSED)


def variables(subject: Subject) -> list[Variable]:
    """List the variables in the order of their value references, integers last."""
    names = subject.model.vehicle.propeller_names
    twin = subject.twin.with_usual_delay(subject.model.radio_delay)
    lag = float(subject.model.dynamics.motor_time_constant)
    state = ("x", "y", "yaw", "vx", "vy", "yaw_rate")
    units = ("m", "m", "rad", "m/s", "m/s", "rad/s")
    bounds = (1e3, 1e3, 1e4, 1e2, 1e2, 1e3)
    return [
        Variable("time", "independent", "simulated time", "s", variability="continuous"),
        *_parameters(twin, lag),
        *(
            Variable(f"start.{n}", "parameter", "of the craft's centre", u, 0.0, -b, b, "fixed")
            for n, u, b in zip(state, units, bounds, strict=True)
        ),
        *(Variable(f"command.{n}", "input", "motor command", None, 0.0, 0.0, 1.0) for n in names),
        *(
            Variable(f"state.{n}", "output", "true motion", u, variability="continuous")
            for n, u in zip(state, units, strict=True)
        ),
        *(
            Variable(f"speed.{n}", "output", "true motor speed", variability="continuous")
            for n in names
        ),
        *(
            Variable(f"pose.{n}", "output", "the last measured pose that arrived", u)
            for n, u in zip((*state[:3], "time"), (*units[:3], "s"), strict=True)
        ),
        Variable("contact.time", "output", "of the last contact with a rail", "s"),
        Variable("contact.speed", "output", "towards the rail", "m/s"),
        Variable("pose.count", "output", "poses that arrived", kind="Int32"),
        Variable("contact.count", "output", "contacts with rails", kind="Int32"),
        Variable(
            "seed", "parameter", "of the random numbers", None, 0, 0, 2**31 - 1, "fixed", "Int32"
        ),
    ]


def _parameters(twin: TwinSettings, lag: float) -> Iterator[Variable]:
    """Return the parameters of table, motors, radio and camera."""
    table, radio, camera = twin.table, twin.radio, twin.motion_capture
    assert radio.delay_s is not None
    for name, description, unit, start, high in (
        ("table.length", "distance of the rails along x", "m", table.length_m, 1e3),
        ("table.width", "distance of the rails along y", "m", table.width_m, 1e3),
        ("table.restitution", "returned fraction of speed", None, table.restitution, 1.0),
        ("table.friction", "coefficient of friction at a rail", None, table.friction, 1e3),
        ("motor.time_constant", "lag of motor speed", "s", lag, _TIME),
        ("radio.delay", "mean delay of a command", "s", radio.delay_s, _TIME),
        ("radio.jitter", "standard deviation of the delay", "s", radio.jitter_s, _TIME),
        ("radio.loss", "fraction of lost commands", None, radio.loss, 1.0),
        ("camera.rate", "frames per second", "Hz", camera.rate_hz, _RATE),
        ("camera.position_noise", "standard deviation", "m", camera.position_noise_m, _NOISE),
        ("camera.yaw_noise", "standard deviation", "rad", camera.yaw_noise_rad, _NOISE),
        ("camera.latency", "minimum age of an arriving pose", "s", camera.latency_s, _TIME),
        ("camera.latency_jitter", "mean additional age", "s", camera.latency_jitter_s, _TIME),
        ("camera.dropped", "fraction of missing frames", None, camera.dropped, 1.0),
    ):
        low = 1e-3 if name == "camera.rate" else 0.0
        if not low <= start <= high:
            raise InputError(
                f"is {start:g}; an export to fmu needs {low:g} to {high:g}", field=name
            )
        yield Variable(name, "parameter", description, unit, start, low, high, "fixed")


def _references(listed: list[Variable]) -> dict[str, int]:
    """Return macros for the first value reference of each group that the sources use."""
    found: dict[str, int] = {}
    groups = {"command", "state", "speed", "pose"}
    for reference, variable in enumerate(listed):
        group, _, rest = variable.name.partition(".")
        known = (
            group
            if group in groups and variable.kind == "Float64"
            else f"{group}_{rest}".rstrip("_")
        )
        found.setdefault(f"AIRPUCK_{known.upper()}", reference)
    reals = sum(variable.kind == "Float64" for variable in listed)
    return {**found, "AIRPUCK_REALS": reals, "AIRPUCK_VARIABLES": len(listed)}


def _craft(disc: Disc) -> str:
    """Return the definition of the craft's numbers that contacts need."""
    fields = {key: float(getattr(disc, key)) for key in ("mass", "inertia", "radius")}
    return constant("airpuck_disc", "airpuck_craft", fields)


def _variable_table(listed: list[Variable]) -> str:
    """Return the definition of the table of variables."""
    letter = {"independent": "t", "parameter": "p", "input": "i", "output": "o"}
    rows = "".join(
        f"    {{{_c_string(v.name)}, '{letter[v.causality]}', {v.start or 0.0!r}, "
        f"{_c_number(v.low)}, {_c_number(v.high)}}},\n"
        for v in listed
    )
    return f"const airpuck_variable airpuck_variables[AIRPUCK_VARIABLES] = {{\n{rows}}};"


def _c_string(text: str) -> str:
    """Return a string literal, safe for any text."""
    return '"' + "".join(c if c.isascii() and c not in '"\\?' else "_" for c in text) + '"'


def _c_number(value: float) -> str:
    """Return a number, or infinity."""
    return f"{'-' * (value < 0)}INFINITY" if math.isinf(value) else repr(float(value))


def _description(subject: Subject, listed: list[Variable], token: str) -> str:
    """Return the content of `modelDescription.xml`."""
    return rendered(
        "modelDescription.xml.jinja",
        name=NAME,
        craft="".join(filter(str.isprintable, subject.model.vehicle.name)),
        token=token,
        description=" ".join(title(subject.model).strip("/* ").replace("\n *", "").split()),
        version=airpuck.__version__,
        variables=listed,
        infinity=math.inf,
    )


def _zip(folder: Path, archive: Path) -> None:
    """Write a folder as an archive that depends only on the contents."""
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as unit:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            entry = zipfile.ZipInfo(path.relative_to(folder).as_posix())
            entry.compress_type = zipfile.ZIP_DEFLATED
            unit.writestr(entry, path.read_bytes())
