"""The available laws, by name."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from airpuck.boundary.errors import InputError
from airpuck.boundary.kinds import unknown
from airpuck.boundary.user_code import UserCode

#: Subclasses of `airpuck.control.law.Law`, or the location of a law that is slow to import.
#: FILE.py:NAME names a user's law wherever a law is named.
LAWS: dict[str, Callable[..., Any] | str] = {
    "lqr": "airpuck.control.lqr.LQR",
    "mpc": "airpuck.control.mpc.MPC",
    "plan": "airpuck.planning.tracking.PlanTracker",
}


def check_law(name: str) -> str:
    """Return the name of a law; raise InputError for an unknown name."""
    if name not in LAWS and ".py:" not in name:
        raise InputError(unknown(name, [*LAWS, "FILE.py:NAME"]))
    return name


def law_label(name: str) -> str:
    """Return the name of a law for labels and file names: without its path."""
    return name.rpartition(":")[2]


def law_named(name: str) -> Callable[..., Any]:
    """Return a factory that makes the named law from model, tuning and options."""
    found = LAWS.get(check_law(name))
    if found is None:
        return _own(name)
    if isinstance(found, str):
        module, _, attribute = found.rpartition(".")
        found = getattr(import_module(module), attribute)
    return found


def _own(name: str) -> Callable[..., Any]:
    """Return a factory that makes a user's law and checks its results."""
    code = UserCode(name, "--regulator")

    def make(*given: Any) -> Any:
        from airpuck.control.law import Law, UserLaw

        law = code.run("cannot be made from (model, tuning, options)", code.kind, *given)
        if not isinstance(law, Law):
            code.refuse("must inherit from airpuck.Law; see docs/control.md")
        return UserLaw(law, code)

    return make
