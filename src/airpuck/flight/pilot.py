"""Users' pilots: loading and checking."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, get_args

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.user_code import UserCode
from airpuck.control.law import Law, Pilot, Prediction, Step
from airpuck.control.laws import check_law
from airpuck.control.reference import Reference, sheltered
from airpuck.data.measurement import Measurement, MeasurementKind
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model

#: Methods of a pilot, and the number of arguments of each.
_METHODS = {"measured": 1, "step": 1, "sent": 2}


def called(pilot: Any) -> str:
    """Return the name of a pilot in messages."""
    return getattr(pilot, "called", f"pilot {type(pilot).__name__}")


def check_pilot(pilot: Any) -> None:
    """Raise InputError if an object is not a pilot, naming what it lacks."""
    reference = getattr(pilot, "reference", None)
    if not isinstance(reference, Reference):
        raise InputError(
            "must have a `reference`, such as airpuck.SetPoint(0, 0, 0); inherit from "
            "airpuck.Pilot for a default",
            field=called(pilot),
        )
    watches = getattr(pilot, "watches", None)
    if not isinstance(watches, tuple) or not set(watches) <= set(get_args(MeasurementKind)):
        raise InputError(
            'must have `watches`, a tuple such as ("puck", "mallet"), or () for poses of the craft '
            "alone; inherit from airpuck.Pilot for a default",
            field=called(pilot),
        )
    for method, count in _METHODS.items():
        found = getattr(pilot, method, None)
        if not callable(found):
            raise InputError(
                f"lacks {method}(); inherit from airpuck.Pilot, or see docs/control.md",
                field=called(pilot),
            )
        try:
            inspect.signature(found).bind(*range(count))
        except TypeError:
            raise InputError(
                f"{method}() must take {count} argument{'s' * (count > 1)} beside self; see "
                "docs/control.md",
                field=called(pilot),
            ) from None


def checked_step(pilot: Any, step: Any) -> Step:
    """Return a pilot's step, or raise InputError if it is not a Step."""
    problem = _what_is_wrong(step)
    if problem:
        raise InputError(f"step() {problem}", field=called(pilot))
    return step


def _what_is_wrong(step: Any) -> str:
    """Describe why an object is not a valid step; empty if it is one."""
    if not isinstance(step, Step):
        return f"must return airpuck.Step(command), not {type(step).__name__}"
    try:
        real = np.asarray(step.command).dtype.kind in "fiu"
    except ValueError:
        real = False
    if not real:
        return "gave a command that is not an array of numbers"
    kinds = {"status": str, "estimate": Estimate | None, "prediction": Prediction | None}
    for name, kind in kinds.items():
        if not isinstance(getattr(step, name), kind):
            return f"gave a {type(getattr(step, name)).__name__} as {name}"
    return ""


class UserPilot(Pilot):
    """A pilot from a user's class, with its results checked; a `Pilot`."""

    def __init__(self, own: Any, code: UserCode) -> None:
        self._own, self._code, self.called = own, code, code.name
        self.watches = own.watches

    @property
    def reference(self) -> Reference:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The reference that the craft tracks."""
        own = self._code.run("reference", lambda: self._own.reference)
        return sheltered(own, self._code)

    def measured(self, measurement: Measurement) -> None:
        """Receive a measurement; see `Pilot.measured`."""
        what = f"{measurement.kind} at {measurement.stamp:.2f} s"
        self._code.run(what, self._own.measured, measurement)

    def step(self, time: float) -> Step:
        """Compute the command to send now; see `Pilot.step`."""
        step = self._code.run(f"step() at {time:.2f} s", self._own.step, time)
        problem = self._code.run(f"step() at {time:.2f} s", _what_is_wrong, step)
        if problem:
            self._code.refuse(f"step() at {time:.2f} s {problem}")
        return step

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Receive the command that was actually sent; see `Pilot.sent`."""
        self._code.run(f"sent() at {time:.2f} s", self._own.sent, time, command)


#: A factory of pilots.
PilotMaker = Callable[[Model, Reference], Pilot]


def pilot_named(name: str) -> PilotMaker | None:
    """Return a factory for a user's pilot, named FILE.py:NAME; None if it names a law."""
    if ".py:" not in check_law(name):
        return None
    kind = UserCode(name, "--law").kind
    is_law = isinstance(kind, type) and issubclass(kind, Law)
    return None if is_law else pilot_maker(name)


def pilot_maker(name: str) -> PilotMaker:
    """Return a factory for a user's pilot, named FILE.py:NAME, from a model and a reference."""
    code = UserCode(name, "--law")

    def make(model: Model, reference: Reference) -> Pilot:
        pilot = code.run("cannot be made from (model, reference)", code.kind, model, reference)
        code.run("is no pilot", check_pilot, pilot)
        return UserPilot(pilot, code)

    # Flights are labelled by the class.
    make.__name__ = name.rpartition(":")[2]
    return make
