"""What computes the commands of a flight, and how to bring one's own."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.user_code import UserCode
from airpuck.control.law import Prediction, Step
from airpuck.control.reference import Reference, SetPoint, sheltered
from airpuck.estimate.estimator import Estimate
from airpuck.model.model_file import Model

#: Methods of a pilot, and how many arguments each is called with.
_METHODS = {"pose": 2, "imu": 3, "mouse": 2, "step": 1, "sent": 2}


@runtime_checkable
class Pilot(Protocol):
    """Computes commands: a `TrackingController`, or a class of one's own.

    A class that inherits from it need only have `step`; the other methods then do nothing, and the
    reference is the middle of the table. One that plays also has ``puck(time, pose)`` and
    ``mallet(time, pose)``, which take note of those.
    """

    #: The reference that the craft tracks.
    reference: Reference = SetPoint(0.0, 0.0, 0.0)

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Take note of a pose.

        Parameters
        ----------
        time : float
            Its stamp [s].
        pose : array, shape (3,)
            x, y [m], yaw [rad].
        """

    def imu(self, time: float, acceleration: Float[np.ndarray, " 2"], gyro: float) -> None:
        """Take note of an inertial measurement.

        Parameters
        ----------
        time : float
            Its stamp [s].
        acceleration : array, shape (2,)
            Along the body's x and y axes [m/s²].
        gyro : float
            Spin [rad/s].
        """

    def mouse(self, time: float, velocity: Float[np.ndarray, " 2"]) -> None:
        """Take note of a velocity from the optical sensor.

        Parameters
        ----------
        time : float
            Its stamp [s].
        velocity : array, shape (2,)
            Along the body's x and y axes [m/s].
        """

    def step(self, time: float) -> Step:
        """Compute the command to send now.

        Parameters
        ----------
        time : float
            Now, on the clock of the poses [s].

        Returns
        -------
        Step
            The command; ``Step(command)`` will do.
        """
        ...

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Take note of the command that was really sent.

        Parameters
        ----------
        time : float
            When [s].
        command : array, shape (n,)
            Motor commands.
        """


def called(pilot: Any) -> str:
    """Return how messages call a pilot."""
    return getattr(pilot, "called", f"pilot {type(pilot).__name__}")


def check_pilot(pilot: Any) -> None:
    """Refuse what is no pilot, and name what it lacks."""
    reference = getattr(pilot, "reference", None)
    if not isinstance(reference, Reference):
        raise InputError(
            "must have a `reference`, such as airpuck.SetPoint(0, 0, 0); inherit from "
            "airpuck.Pilot for a default",
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
                f"{method}() must take {count} arguments beside self; see docs/control.md",
                field=called(pilot),
            ) from None


def checked_step(pilot: Any, step: Any) -> Step:
    """Return a pilot's step, or refuse one that is none."""
    problem = _what_is_wrong(step)
    if problem:
        raise InputError(f"step() {problem}", field=called(pilot))
    return step


def _what_is_wrong(step: Any) -> str:
    """Say why something is no step; an empty text where it is one."""
    if not isinstance(step, Step):
        return f"must return airpuck.Step(command), not {type(step).__name__}"
    try:
        np.asarray(step.command, dtype=float)
    except (TypeError, ValueError) as error:
        return f"gave a command that is no array of numbers: {error}"
    kinds = {"status": str, "estimate": Estimate | None, "prediction": Prediction | None}
    for name, kind in kinds.items():
        if not isinstance(getattr(step, name), kind):
            return f"gave as {name} a {type(getattr(step, name)).__name__}"
    return ""


class UserPilot(Pilot):
    """A pilot of a user's class, behind the boundary; a `Pilot`."""

    def __init__(self, own: Any, code: UserCode) -> None:
        self._own, self._code, self.called = own, code, code.name
        for kind in ("puck", "mallet"):
            if hasattr(own, kind):
                setattr(self, kind, partial(self._run, kind))

    @property
    def reference(self) -> Reference:  # pyright: ignore[reportIncompatibleVariableOverride]
        """What the craft is to track."""
        own = self._code.run("reference", lambda: self._own.reference)
        return sheltered(own, self._code)

    def pose(self, time: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Take note of a pose; see `Pilot.pose`."""
        self._run("pose", time, pose)

    def imu(self, time: float, acceleration: Float[np.ndarray, " 2"], gyro: float) -> None:
        """Take note of an inertial measurement; see `Pilot.imu`."""
        self._run("imu", time, acceleration, gyro)

    def mouse(self, time: float, velocity: Float[np.ndarray, " 2"]) -> None:
        """Take note of a velocity from the optical sensor; see `Pilot.mouse`."""
        self._run("mouse", time, velocity)

    def step(self, time: float) -> Step:
        """Compute the command to send now; see `Pilot.step`."""
        step = self._run("step", time)
        problem = self._code.run(f"step() at {time:.2f} s", _what_is_wrong, step)
        if problem:
            self._code.refuse(f"step() at {time:.2f} s {problem}")
        return step

    def sent(self, time: float, command: Float[np.ndarray, " n"]) -> None:
        """Take note of the command that was really sent; see `Pilot.sent`."""
        self._run("sent", time, command)

    def _run(self, method: str, time: float, *given: Any) -> Any:
        """Call a method of the user's object."""
        called = f"{method}() at {time:.2f} s"
        return self._code.run(called, lambda: getattr(self._own, method)(time, *given))


#: Makes a pilot.
PilotMaker = Callable[[Model, Reference], Pilot]


def pilot_maker(name: str) -> PilotMaker:
    """Return what makes a user's pilot, named FILE.py:NAME, from a model and a reference."""
    code = UserCode(name, "--pilot")

    def make(model: Model, reference: Reference) -> Pilot:
        pilot = code.run("cannot be made from (model, reference)", code.kind, model, reference)
        code.run("is no pilot", check_pilot, pilot)
        return UserPilot(pilot, code)

    # What flies is named by the class.
    make.__name__ = name.rpartition(":")[2]
    return make
