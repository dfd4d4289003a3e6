"""What computes the commands of a flight, and how to bring one's own."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from airpuck.boundary.errors import InputError
from airpuck.boundary.user_class import load_class
from airpuck.control.law import Step
from airpuck.control.reference import Reference, SetPoint
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


def check_pilot(pilot: Any) -> None:
    """Refuse what is no pilot, and name what it lacks."""
    name = type(pilot).__name__
    reference = getattr(pilot, "reference", None)
    if not isinstance(reference, Reference):
        raise InputError(
            "must have a `reference`, such as airpuck.SetPoint(0, 0, 0); inherit from "
            "airpuck.Pilot for a default",
            field=f"pilot {name}",
        )
    for method, count in _METHODS.items():
        found = getattr(pilot, method, None)
        if not callable(found):
            raise InputError(
                f"lacks {method}(); inherit from airpuck.Pilot, or see docs/control.md",
                field=f"pilot {name}",
            )
        try:
            inspect.signature(found).bind(*range(count))
        except TypeError:
            raise InputError(
                f"{method}() must take {count} arguments beside self; see docs/control.md",
                field=f"pilot {name}",
            ) from None


def checked_step(pilot: Any, step: Any) -> Step:
    """Return a pilot's step, or refuse one that is none."""
    if not isinstance(step, Step):
        raise InputError(
            f"step() must return airpuck.Step(command), not {type(step).__name__}",
            field=f"pilot {type(pilot).__name__}",
        )
    try:
        np.asarray(step.command, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"step() gave a command that is no array of numbers: {error}",
            field=f"pilot {type(pilot).__name__}",
        ) from error
    return step


#: Makes a pilot.
PilotMaker = Callable[[Model, Reference], Pilot]


def pilot_maker(name: str) -> PilotMaker:
    """Return what makes a user's pilot, named FILE.py:NAME, from a model and a reference."""
    kind = load_class(name, "--pilot")

    def make(model: Model, reference: Reference) -> Pilot:
        try:
            pilot = kind(model, reference)
        # Whatever goes wrong in a user's class is for the user to mend.
        except Exception as error:
            raise InputError(
                f"cannot be made from (model, reference): {type(error).__name__}: {error}",
                file=name,
                field="--pilot",
            ) from error
        check_pilot(pilot)
        return pilot

    # What flies is named by the class.
    make.__name__ = name.rpartition(":")[2]
    return make
