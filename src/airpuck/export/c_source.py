"""C source with the numbers of a model, and the packaged sources that compute with them."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

import airpuck
from airpuck.boundary.errors import InputError
from airpuck.export.kinds import refuse_effects
from airpuck.model.model_file import Model
from airpuck.model.parameters import thrust_scale
from airpuck.physics.effects import Drag, Effect, IdleLag, Inflow, PairInteraction, Tilt, VoltageSag
from airpuck.physics.motor import IDLE
from airpuck.physics.rigid_body import Dynamics

#: Effects that `airpuck_model.c` computes; those that change thrusts are in its order.
EFFECTS: tuple[type[Effect], ...] = (Inflow, PairInteraction, VoltageSag, Drag, Tilt, IdleLag)
#: Packaged sources of the model alone.
MODEL_SOURCES = ("airpuck_real.h", "airpuck_model.h", "airpuck_model.c")
_WIDTH = 100


def write_model(
    model: Model,
    folder: Path,
    *,
    kind: str = "c",
    dynamics: Dynamics | None = None,
    sizes: Mapping[str, object] | None = None,
    data: Mapping[str, str] | None = None,
) -> None:
    """Write the sources of a model: packaged ones, `airpuck_sizes.h` and `airpuck_data.c`.

    `dynamics` replaces the model's. `sizes` are additional macros by name; `data` are additional
    definitions (`constant`), by the header that declares them.
    """
    dynamics = dynamics or model.dynamics
    check_effects(model, kind, dynamics)
    copy_sources(MODEL_SOURCES, folder)
    n, degree = np.shape(dynamics.thrust)
    known = {"AIRPUCK_MOTORS": n, "AIRPUCK_DEGREE": degree, **(sizes or {})}
    macros = "\n".join(f"#define {name} {value}" for name, value in known.items())
    guard = "AIRPUCK_SIZES_H"
    (folder / "airpuck_sizes.h").write_text(
        f"{title(model)}\n#ifndef {guard}\n#define {guard}\n\n{macros}\n\n#endif\n",
        encoding="utf-8",
    )
    fields = coefficients(model, dynamics)
    definitions = {
        "airpuck_model.h": constant("airpuck_model", "airpuck_identified", fields),
        **(data or {}),
    }
    includes = "\n".join(f'#include "{header}"' for header in definitions)
    text = "\n\n".join([title(model), includes, *definitions.values()])
    (folder / "airpuck_data.c").write_text(f"{text}\n", encoding="utf-8")


def copy_sources(names: Sequence[str], folder: Path) -> None:
    """Copy packaged sources, by their paths below ``packaged/c``."""
    packaged = resources.files("airpuck") / "packaged" / "c"
    for name in names:
        (folder / Path(name).name).write_bytes((packaged / name).read_bytes())


def check_effects(model: Model, kind: str, dynamics: Dynamics | None = None) -> None:
    """Raise InputError for effects that the C sources do not compute, or not in this order."""
    dynamics = dynamics or model.dynamics
    refuse_effects(dynamics, kind, EFFECTS)
    present = [type(effect) for effect in dynamics.effects]
    changing = [effect for effect in present if effect.thrust is not Effect.thrust]
    if len(set(present)) < len(present) or changing != sorted(changing, key=EFFECTS.index):
        names = ", ".join(effect.__name__ for effect in present)
        raise InputError(
            f"has the effects {names}, including the twin's settings; an export to {kind} "
            "computes each at most once, in the order of docs/export.md; leave one out",
            field="MODEL",
        )


def title(model: Model) -> str:
    """Return a comment that names the model, its data and the version of airpuck."""
    lines = [
        f"Model {model.name} of the craft {model.vehicle.name}; source: {model.source or '-'}.",
        f"Motors, in the order of commands: {', '.join(model.vehicle.propeller_names)}.",
        *(f"Learned from {name}, SHA-256 {digest}." for name, digest in model.data.items()),
        f"Written by airpuck {airpuck.__version__}; do not edit.",
    ]
    wrapped = [part for line in lines for part in textwrap.wrap(line, _WIDTH - 6)]
    # No name may end the comment, continue a line, or contain a trigraph.
    harmless = str.maketrans(r"*\?", "___")
    printable = ("".join(filter(str.isprintable, part)).translate(harmless) for part in wrapped)
    body = "\n * ".join(printable)
    return f"/* {body} */"


def constant(kind: str, name: str, fields: Mapping[str, Any]) -> str:
    """Define a constant struct by its fields: numbers, or arrays of them."""
    rows = "\n".join(f"    .{field} = {initializer(value)}," for field, value in fields.items())
    return f"const {kind} {name} = {{\n{rows}\n}};"


def initializer(value: Any, depth: int = 2) -> str:
    """Write a number or an array as an initialiser; whole numbers of Python or NumPy are `int`."""
    if np.ndim(value) == 0:
        whole = isinstance(value, int | np.integer)
        return str(int(value)) if whole else f"AIRPUCK_R({float(value)!r})"
    line = f"\n{'    ' * depth}"
    if np.ndim(value) > 1:
        rows = f",{line}".join(initializer(row, depth + 1) for row in value)
        return f"{{{line}{rows}}}"
    joined = ", ".join(initializer(entry) for entry in value)
    return f"{{{line.join(textwrap.wrap(joined, _WIDTH - len(line)))}}}"


def coefficients(model: Model, dynamics: Dynamics) -> dict[str, Any]:
    """Return the fields of the C struct `airpuck_model`; 0 switches an effect off."""
    n = model.vehicle.n_propellers
    twin = np.full(n, -1)
    for first, second in model.vehicle.pair_indices:
        twin[first], twin[second] = second, first
    fields = {
        "thrust": np.asarray(dynamics.thrust, dtype=float),
        "configuration": np.asarray(dynamics.configuration, dtype=float),
        "center_of_mass": np.asarray(dynamics.center_of_mass, dtype=float),
        "center_of_mass_turns": int(dynamics.frame == "body"),
        "motor_time_constant": float(dynamics.motor_time_constant),
        "idle_lag": float(dynamics.idle_lag or 0.0),
        "idle_speed": IDLE,
        "inflow": 0.0,
        "inflow_axes": np.zeros((n, 3)),
        "pair_interaction": 0.0,
        "twin": twin,
        "voltage_sag": 0.0,
        "newtons": np.asarray(thrust_scale(np, model.parameters, model.vehicle), dtype=float),
        "drag": np.zeros(4),
        "slope": np.zeros(2),
    }
    for effect in dynamics.effects:
        match effect:
            case Inflow():
                fields |= {"inflow": float(effect.coefficient), "inflow_axes": effect.axes}
            case PairInteraction():
                fields["pair_interaction"] = float(effect.coefficient)
            case VoltageSag():
                fields["voltage_sag"] = float(effect.coefficient)
            case Drag():
                rates = effect.linear, effect.quadratic, effect.spin_linear, effect.spin_quadratic
                fields["drag"] = np.array(rates, dtype=float)
            case Tilt():
                fields["slope"] = np.array(effect.gravity, dtype=float)
    return fields
