"""The whole controller as C99: estimator, law, allocation, and the model.

The sources in ``packaged/c`` are written by hand; an export adds one file of sizes and one of
numbers. The laws and the estimator are those of `airpuck.control.tracking`.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from airpuck.boundary.errors import InputError
from airpuck.control.lqr import motor_lag, regulator
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning
from airpuck.estimate.axis_filter import INITIAL_DISTURBANCE, INITIAL_VELOCITY
from airpuck.export.c_source import constant, copy_sources, write_model
from airpuck.export.golden import golden_flight
from airpuck.export.kinds import Subject
from airpuck.model.model_file import Model

#: Time for which unconfirmed commands are kept [s]; `airpuck_sent` forgets older ones.
_REMEMBERED = 0.5
#: Sources of the controller, besides the model's.
_SOURCES = (
    "README.md",
    "CMakeLists.txt",
    "main.c",
    "airpuck_selftest.c",
    "airpuck.h",
    "airpuck.c",
    "airpuck_lqr.h",
    "airpuck_lqr.c",
    "airpuck_qp.h",
    "airpuck_qp.c",
    "airpuck_daqp.c",
)
#: DAQP's, which they include.
_DAQP = (
    "LICENSE",
    "types.h",
    "constants.h",
    *(f"{name}{end}" for name in ("daqp", "auxiliary", "factorization") for end in (".h", ".c")),
)


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write the controller of a model as C99; return its sizes."""
    model, tuning = subject.model, subject.tuning
    _check(model, tuning)
    sizes = {
        "AIRPUCK_STEPS": 0,
        "AIRPUCK_HELD": math.ceil((_REMEMBERED + model.transport_delay) / tuning.period_s) + 4,
    }
    tuned = constant("airpuck_tuning", "airpuck_tuned", _tuning(model, tuning))
    write_model(model, folder, sizes=sizes, data={"airpuck.h": tuned})
    copy_sources(_SOURCES, folder)
    (folder / "daqp").mkdir()
    copy_sources([f"daqp/{name}" for name in _DAQP], folder / "daqp")
    golden = "\n".join(golden_flight(model, tuning))
    (folder / "golden.csv").write_text(f"{golden}\n")
    n = model.vehicle.n_propellers
    return {
        "state in double precision, bytes": _state_bytes(sizes, n, ctypes.c_double),
        "state in single precision, bytes": _state_bytes(sizes, n, ctypes.c_float),
    }


def _state_bytes(sizes: Mapping[str, int], motors: int, number: Any) -> int:
    """Return the size of the C struct `airpuck`, whose layout this repeats."""
    n, allocated = motors, motors + 2
    most = allocated + 1
    numbers = allocated * (allocated + 1) // 2 + 3 * allocated + 5 * (allocated + 3)
    numbers += 4 * allocated + 3 + most * (most + 11) // 2
    whole, time = ctypes.c_int, ctypes.c_double

    class Held(ctypes.Structure):
        _fields_: ClassVar = [("begins", time), ("command", number * n)]

    class Craft(ctypes.Structure):
        _fields_: ClassVar = [
            ("status", whole),
            ("estimate", number * (12 + n)),
            ("iterations", whole),
            ("times", time * 3),
            ("doubt", whole * 2),
            ("doubtful_since", time),
            ("doubtful_pose", number * 3),
            ("filtered", time * 2),
            ("belief", number * (36 + n)),
            ("held", whole),
            ("commands", Held * sizes["AIRPUCK_HELD"]),
            ("numbers", number * numbers),
            ("active", whole * most),
        ]

    return ctypes.sizeof(Craft)


def _check(model: Model, tuning: Tuning) -> None:
    """Raise InputError for what the C sources do not hold."""
    kind = tuning.regulator.kind
    if kind not in ("lqr",):
        raise InputError(f"{kind!r} has no C; choose 'lqr' or 'mpc'", field="regulator.kind")
    if tuning.estimation.estimator != "kalman":
        problem = f"{tuning.estimation.estimator!r} has no C; choose 'kalman'"
        raise InputError(problem, field="estimation.estimator")
    if tuning.allocation.solver != "daqp":
        problem = f"{tuning.allocation.solver!r} has no C; choose 'daqp'"
        raise InputError(problem, field="allocation.solver")
    if model.vehicle.actuators.pulsed:
        raise InputError(
            "on/off thrusters have no C; only propellers have", field="vehicle.actuators"
        )
    # Raises InputError for a craft that cannot be steered.
    TrackingController(model, SetPoint(0.0, 0.0, 0.0), tuning, compiled=False)


def _tuning(model: Model, tuning: Tuning) -> dict[str, Any]:
    """Return the fields of the C struct `airpuck_tuning`."""
    noise, vehicle, period = tuning.estimation.noise, model.vehicle, tuning.period_s
    lag, drive = motor_lag(float(model.dynamics.motor_time_constant), period)
    disturbed = INITIAL_DISTURBANCE * (np.array(noise.disturbance) > 0)
    return {
        "transport_delay": model.transport_delay,
        "period": period,
        "gain": regulator(tuning.weights, period),
        "motor_lag": lag,
        "motor_drive": drive,
        "command_min": vehicle.command_min,
        "command_max": vehicle.command_max,
        "arm": model.radius_of_gyration,
        "slack_root": math.sqrt(tuning.allocation.slack_weight),
        "pose_variance": np.square(noise.pose),
        "initial_variance": np.square(np.array([noise.pose, INITIAL_VELOCITY, disturbed])).T,
        "acceleration_density": np.square(noise.acceleration),
        "disturbance_density": np.square(noise.disturbance),
    }
