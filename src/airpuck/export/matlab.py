"""Function files for MATLAB and Octave: dynamics, one step, linearisation about hover."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import airpuck
from airpuck.export.c import check_effects, coefficients, copy_sources
from airpuck.export.kinds import Subject, command_range, printable, refuse_actuators
from airpuck.model.model_file import Model
from airpuck.model.simulation import trim

#: Packaged function files.
_SOURCES = ("airpuck_dynamics.m", "airpuck_acceleration.m", "airpuck_step.m", "airpuck_hover.m")
_PARAMETERS = """\
function p = airpuck_parameters()
% Parameters of the model {name} of the craft {vehicle}. SI units.
%
% Source: {source}
% Written by airpuck {version}.
{fields}
end
"""


def parameters(model: Model) -> str:
    """Return the function file with the numbers of a model.

    Parameters
    ----------
    model : Model
        The craft.

    Returns
    -------
    str
        The content of ``airpuck_parameters.m``.

    Raises
    ------
    InputError
        If the model has an effect that the function files do not compute.
    """
    check_effects(model, "matlab")
    refuse_actuators(model, "matlab", ["on_off", "reversible propeller"])
    dynamics, vehicle = model.dynamics, model.vehicle
    fields = coefficients(model, dynamics)
    fields |= {
        # MATLAB counts from 1.
        "twin": fields["twin"] + 1,
        "effects": int(bool(dynamics.effects)),
        "hover": trim(replace(dynamics, effects=())),
        "command_range": np.array(command_range(model)),
        "transport_delay": model.transport_delay,
    }
    lines = [f"    p.{name} = {_literal(value)};" for name, value in fields.items()]
    names = ", ".join(f"'{printable(name)}'" for name in vehicle.propeller_names)
    lines.append(f"    p.motors = {{{names}}};")
    return _PARAMETERS.format(
        name=printable(model.name),
        vehicle=printable(vehicle.name),
        source=printable(model.source or "-"),
        version=airpuck.__version__,
        fields="\n".join(lines),
    )


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write the function files."""
    model = subject.model
    (folder / "airpuck_parameters.m").write_text(parameters(model), encoding="utf-8")
    copy_sources(_SOURCES, folder, "matlab")
    return {"transport delay": f"{1e3 * model.transport_delay:.4g} ms, not in the functions"}


def _literal(value: Any) -> str:
    """Return a number, a column or a matrix that is read back bit for bit."""
    if np.ndim(value) == 0:
        return repr(value if isinstance(value, int) else float(value))
    inside = "\n        ".join(" ".join(map(repr, row)) for row in np.atleast_2d(value).tolist())
    return f"[{inside}]" if np.ndim(value) > 1 else f"[{inside}]'"
