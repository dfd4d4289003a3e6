"""The available laws, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pkgutil import resolve_name
from typing import Any

from airpuck.boundary.errors import InputError, unknown
from airpuck.boundary.extensions import added, loaded, users_class

#: Subclasses of `airpuck.control.law.Law`, or the location of a law that is slow to import.
#: FILE.py:NAME names a user's law wherever a law is named; entry points (`airpuck.laws`) add more.
LAWS: dict[str, Callable[..., Any] | str] = {
    "lqr": "airpuck.control.lqr.LQR",
    "mpc": "airpuck.control.mpc.MPC",
    "plan": "airpuck.planning.tracking.PlanTracker",
}

#: The law of the paper's controller.
PAPERS = "lqr"


def check_law(name: str, field: str | None = None) -> str:
    """Return the name of a law; raise InputError about a field for an unknown name."""
    if name not in LAWS and ".py:" not in name and name not in added("airpuck.laws"):
        known = [*LAWS, *added("airpuck.laws"), "FILE.py:NAME"]
        raise InputError(unknown(name, known), field=field)
    return name


def law_class(name: str) -> Any:
    """Import the class of a law."""
    found = LAWS.get(check_law(name))
    if found is None:
        known = name in added("airpuck.laws")
        return loaded("airpuck.laws", name) if known else users_class(name, "--law")
    return resolve_name(found) if isinstance(found, str) else found


def law_label(law: Any) -> str:
    """Return a law's name for labels and file names: without its path, or that of its class."""
    if isinstance(law, str):
        return law.rpartition(":")[2]
    return getattr(law, "__name__", type(law).__name__)


def numbered(labels: Sequence[str]) -> list[str]:
    """Return labels with a number on each that occurs several times."""
    counts = ((one, labels.count(one), labels[: k + 1].count(one)) for k, one in enumerate(labels))
    return [f"{one} {number}" if several > 1 else one for one, several, number in counts]


def name_among(names: Iterable[str], law: str, otherwise: str) -> str:
    """Return the name that means a law, which may name its file, too; or another if none does."""
    return next((name for name in names if law in (name, law_label(name))), otherwise)
