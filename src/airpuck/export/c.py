"""The whole controller as C99: estimator, law, allocation, and the model.

The sources in ``packaged/c`` are written by hand; an export adds one file of sizes and one of
numbers. It has the laws and the estimator of `airpuck.control.tracking`.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

import airpuck
from airpuck.boundary.errors import InputError, either
from airpuck.control import horizon
from airpuck.control.allocation import TIE_SLACK, TIE_THRUST, UNSCALED
from airpuck.control.horizon import Blocks, Sizes
from airpuck.control.law import LawOptions
from airpuck.control.laws import LAWS, law_class
from airpuck.control.lqr import LQRSettings, cost_to_go, lqr_gain, motor_lag, point_mass
from airpuck.control.mpc import FLOWN_ON, MPC, Ongoing
from airpuck.control.pose_gate import BLIND, JUMP, MOVES, ROUNDING, longest_pause, remembered
from airpuck.control.predictive import PredictiveSettings
from airpuck.control.reference import SetPoint
from airpuck.control.tracking import TrackingController
from airpuck.control.tuning import Tuning
from airpuck.export.kinds import Subject, refuse_actuators, refuse_effects
from airpuck.model.model_file import Model
from airpuck.model.parameters import thrust_scale
from airpuck.physics.effects import Drag, Effect, IdleLag, Inflow, PairInteraction, Tilt, VoltageSag
from airpuck.physics.motor import IDLE
from airpuck.physics.rigid_body import Dynamics, step
from airpuck.planning import tracking
from airpuck.planning.plan import Plan
from airpuck.planning.tracking import PlanTracker

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


def copy_sources(names: Sequence[str], folder: Path, language: str = "c") -> None:
    """Copy packaged sources, by their paths below ``packaged/c`` or another language's."""
    packaged = resources.files("airpuck") / "packaged" / language
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


#: Rate of poses [1/s], and number of control steps.
_RATE, _STEPS = 240, 120
#: Set points, each held for the same time: near, turned, far, back.
_TARGETS = ((0.0, 0.0, 0.0), (0.3, 0.1, 2.0), (-0.6, 0.3, -1.0), (0.0, 0.0, 0.0))
#: Departure of a planned flight, and time for which it continues after its end [s].
_DEPARTS, _AFTERWARDS = 0.05, 0.2
#: Frames that are lost, that are not finite, and that show another object.
_LOST, _BAD, _JUMPING = range(100, 165), range(170, 172), range(230, 233)
#: Standard deviation of the poses [m, m, rad].
_NOISE = (5e-5, 5e-5, 6e-4)


def golden_flight(model: Model, tuning: Tuning, plan: Plan | None = None) -> Iterator[str]:
    """Yield the lines of a flight: targets, poses, plans, results of steps, and commands sent.

    Motors act without delay, unlike the model's, so that the controller has errors to correct. A
    planned flight begins after the first pose, and the targets follow it.
    """
    random, period = np.random.default_rng(0), tuning.period_s
    pilot = TrackingController(model, SetPoint(0.0, 0.0, 0.0), tuning, compiled=False)
    n = model.vehicle.n_propellers
    state = np.concatenate([np.zeros(6), np.full(n, model.vehicle.command_min)])
    frame = planned = 0
    if plan is not None:
        state[:6] = plan.states[0, :6]
        planned = math.ceil((plan.duration + _AFTERWARDS) / period)
        pilot.reference = plan.starting(_DEPARTS)
        yield _line("depart", _DEPARTS)
    for k in range(planned + _STEPS):
        now = (k + 1) * period
        if k >= planned and (k - planned) % (_STEPS // len(_TARGETS)) == 0:
            pose = _TARGETS[(k - planned) * len(_TARGETS) // _STEPS]
            pilot.reference = SetPoint(*pose)
            yield _line("target", *pose)
        while frame / _RATE <= now:
            seen = state[:3] + random.normal(size=3) * _NOISE + (frame in _JUMPING)
            if frame in _BAD:
                seen[frame % 3] = math.nan
            if frame not in _LOST:
                pilot.pose(frame / _RATE, seen)
                yield _line("pose", frame / _RATE, *seen)
            frame += 1
        if isinstance(pilot.state, Ongoing):
            # Each plan depends on the previous one: without a copy, rounding would accumulate.
            kept = pilot.state
            yield _line("plan", kept.since, kept.answered, float(kept.way), *kept.plan.ravel())
        result = pilot.step(now)
        yield _line("step", now, result.status, *result.command)
        pilot.sent(now, result.command)
        yield _line("sent", now, *result.command)
        state = step(np, model.dynamics, state, result.command, period)


def _line(*values: str | float) -> str:
    """Format values with all their digits."""
    return ",".join(v if isinstance(v, str) else repr(float(v)) for v in values)


def _sources(*modules: str) -> list[str]:
    """Return the headers and sources of modules of the controller."""
    return [f"airpuck_{name}.{suffix}" for name in modules for suffix in "hc"]


#: Sources of the controller, besides the model's.
_SOURCES = (
    *("LICENSE", "README.md", "CMakeLists.txt", "main.c", "airpuck_selftest.c"),
    *("airpuck.h", "airpuck.c", "airpuck_laws.h", "airpuck_lqr.c", *_sources("least_norm")),
)
#: Constants of `tracking` that `airpuck_flight` has by the same name.
_OF_FLIGHT = (
    *("LATER", "LEAST", "LASTING", "PRECISION", "CORRECTION", "DIFFERENCE", "SAMPLES"),
    *("ITERATIONS", "TOLERANCE", "DECREASE", "SHORTEST", "ROUNDING"),
)


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write the controller of a model as C99; return its sizes."""
    model, tuning, plan = subject.model, subject.tuning, subject.plan
    if plan is not None:
        tuning = tracking.for_plans(tuning)
    _check(model, tuning, plan)
    laws = [law_class(tuning.law.kind), *([] if plan is None else [PlanTracker])]
    modules = [name for one in laws for name in one.c_modules or ()]
    copy_sources([*_SOURCES, *_sources(*modules)], folder)
    held = remembered(longest_pause(model, tuning)) + model.transport_delay
    sizes = {
        "AIRPUCK_STEPS": 0,
        "AIRPUCK_INTERVALS": 0,
        "AIRPUCK_HELD": math.ceil(held / tuning.period_s) + 4,
    }
    numbers = [constant("airpuck_tuning", "airpuck_tuned", _tuning(model, tuning))]
    facts: dict[str, Any] = {"law": tuning.law.kind, "on-board sensors": "not used"}
    if MPC in laws:
        sizes |= _prediction_sizes(tuning.of(PredictiveSettings))
        predicted = _horizon(model, tuning)
        numbers.append(constant("airpuck_horizon", "airpuck_predicted", predicted))
        low, high = np.round(predicted["fence"], 4).tolist()
        facts["fence, m"] = f"{low} to {high}; set law.mpc.limits.fence_m for another table"
    if plan is not None:
        flight = _flight(plan)
        sizes |= {
            "AIRPUCK_INTERVALS": len(plan.commands),
            "AIRPUCK_PARTS": (len(flight["states"]) - 1) // len(plan.commands),
            "AIRPUCK_PERIODS": tracking.periods(math.inf, tuning.period_s),
        }
        numbers.append(constant("airpuck_flight", "airpuck_planned", flight))
        facts["planned flight, numbers in flash"] = flight["states"].size + plan.commands.size
    write_model(model, folder, sizes=sizes, data={"airpuck.h": "\n\n".join(numbers)})
    golden = "\n".join(golden_flight(model, tuning, plan))
    (folder / "golden.csv").write_text(f"{golden}\n")
    return facts


def _check(model: Model, tuning: Tuning, plan: Plan | None) -> None:
    """Raise InputError for settings that the C sources do not support."""
    kind = tuning.law.kind
    if kind == "plan" and plan is None:
        raise InputError("'plan' needs a plan; pass it with --plan FILE", field="law.kind")
    able = [name for name in LAWS if getattr(law_class(name), "c_modules", None) is not None]
    if kind not in able:
        problem = f"{kind!r} cannot be exported to c; choose {either(map(repr, able))}"
        raise InputError(problem, field="law.kind")
    if tuning.estimation.estimator != "kalman":
        problem = f"{tuning.estimation.estimator!r} cannot be exported to c; choose 'kalman'"
        raise InputError(problem, field="estimation.estimator")
    if tuning.turning(model) is not model:
        problem = "cannot be exported to c; leave it out, or raise command_min of the vehicle"
        raise InputError(problem, field="least_command")
    refuse_actuators(model, "c")
    # Raises InputError for a craft that cannot be steered.
    TrackingController(model, SetPoint(0.0, 0.0, 0.0), tuning, compiled=False)


def _tuning(model: Model, tuning: Tuning) -> dict[str, Any]:
    """Return the fields of the C struct `airpuck_tuning`."""
    noise, vehicle, period = tuning.estimation.noise, model.vehicle, tuning.period_s
    settings = tuning.of(LQRSettings)
    pause = longest_pause(model, tuning)
    lag, drive = motor_lag(float(model.dynamics.motor_time_constant), period)
    return {
        "transport_delay": model.transport_delay,
        "longest_pause": pause,
        "blind": BLIND,
        "moves": MOVES,
        "believed_after": pause - ROUNDING,
        "remembered": remembered(pause),
        "jump": np.array(JUMP),
        "period": period,
        "gain": lqr_gain(settings.weights, period),
        "motor_lag": lag,
        "motor_drive": drive,
        "command_min": vehicle.command_min,
        "command_max": vehicle.command_max,
        "arm": model.radius_of_gyration,
        "slack_root": math.sqrt(settings.slack_weight),
        "unscaled": UNSCALED,
        "tie_thrust": TIE_THRUST,
        "tie_slack": TIE_SLACK,
        "pose_variance": np.square(noise.pose),
        "initial_variance": noise.initial_variance,
        "acceleration_density": np.square(noise.acceleration),
        "disturbance_density": np.square(noise.disturbance),
    }


def _flight(plan: Plan) -> dict[str, Any]:
    """Return the fields of the C struct `airpuck_flight`."""
    return {
        "ahead": tracking.HORIZON,
        **{name.lower(): getattr(tracking, name) for name in _OF_FLIGHT},
        "duration": plan.duration,
        "given_up": tracking.given_up(plan),
        "rests": int(tracking.rests(plan)),
        "times": plan.time,
        "commands": plan.commands,
        "states": plan.samples[1],
    }


def _prediction_sizes(law: PredictiveSettings) -> dict[str, int]:
    """Return the macros that set the sizes of a prediction."""
    blocks, limits = Blocks.of(law), law.limits
    speed, spin = limits.speed_m_s is not None, limits.spin_rad_s is not None
    discs = len(limits.keep_out_m)
    return {
        "AIRPUCK_STEPS": len(blocks.owner),
        "AIRPUCK_BLOCKS": len(blocks.lengths),
        "AIRPUCK_LIMITS": 2 + speed + spin + discs,
        "AIRPUCK_LIMITS_SPEED": int(speed),
        "AIRPUCK_LIMITS_SPIN": int(spin),
        "AIRPUCK_DISCS": discs,
    }


def _horizon(model: Model, tuning: Tuning) -> dict[str, Any]:
    """Return the fields of the C struct `airpuck_horizon`."""
    chosen = tuning.of(PredictiveSettings)
    law = MPC(model, tuning, LawOptions(compiled=False))
    limits, blocks = chosen.limits, Blocks.of(chosen)
    sizes, h = Sizes(model.vehicle, blocks, chosen), blocks.step
    weights = chosen.weights.errors * h
    terminal = cost_to_go(*point_mass(h), np.diag(weights), np.diag(sizes.effort))
    n = model.vehicle.n_propellers
    return {
        "step": h,
        "owner": blocks.owner,
        "lasting": h * np.array(blocks.lengths),
        "weights": weights,
        "terminal": (terminal + terminal.T) / 2,
        "effort": sizes.effort,
        "used": sizes.used[::n],
        "damping": float(sizes.changed[0] - sizes.used[0]),
        "first": float(law.init().plan[0, 0]),
        "brake": float(horizon.braking(np, model.dynamics, model.vehicle.command_max)),
        "headway": limits.headway_s,
        "turning": horizon.TURNING,
        "most_room": horizon.MOST_ROOM,
        "undecided": horizon.UNDECIDED,
        "flown_on": FLOWN_ON,
        "speed": limits.speed_m_s or 0.0,
        "spin": limits.spin_rad_s or 0.0,
        "fence": law.fence,
        "keep_out": np.array([*limits.keep_out_m, (0.0, 0.0, 0.0)]),
        "iterations": sizes.most,
        "penalty": sizes.penalty,
    }
