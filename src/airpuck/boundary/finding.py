"""A finding: what is wrong with a recording, a vehicle file or a craft, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, get_args

from airpuck.boundary.results import Result

#: Kinds of causes, in the order in which causes have consequences: a wrong clock looks like wrong
#: motors, wrong motors like missing physics, and never the other way round. ``clock``: clocks and
#: time stamps; ``units``, ``axes`` and ``signs`` of poses and commands; ``order`` of the motors'
#: columns or sockets; ``layout``: positions and directions of the vehicle file; ``mass``: mass,
#: inertia and radius; ``actuator``: weak, dead, reversed; ``physics`` that the model lacks;
#: ``change`` during the recording; ``excitation``: too little of it; ``control``: the controller
#: does not settle.
Kind = Literal[
    "clock",
    "units",
    "axes",
    "signs",
    "order",
    "layout",
    "mass",
    "actuator",
    "physics",
    "change",
    "excitation",
    "control",
]
#: Kinds that make a recording suspect: whatever is learned from it is wrong.
SUSPECT: tuple[Kind, ...] = ("clock", "units", "axes", "signs", "order")


@dataclass(frozen=True)
class Finding(Result):
    """Something that is wrong.

    Attributes
    ----------
    kind : str
        Kind of the cause, one of `Kind`.
    cause : str
        What is wrong: a sentence without its full stop, such as "The poses are stamped 80 ms late".
    evidence : str
        What shows it, with a number.
    remedy : str
        What to do: a sentence, or the line to write into a file.
    """

    JSON = "kind cause evidence remedy"

    kind: Kind
    cause: str
    evidence: str = ""
    remedy: str = ""

    @property
    def suspect(self) -> bool:
        """Whether nothing that is learned from the recording can be right."""
        return self.kind in SUSPECT

    @property
    def sentence(self) -> str:
        """The finding in words."""
        shown = f"{self.cause} ({self.evidence})" if self.evidence else self.cause
        return f"{shown}." + (f" {self.remedy}" if self.remedy else "")


def by_cause(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings in the order of their causes, each once."""
    kinds = get_args(Kind)
    return tuple(sorted(dict.fromkeys(findings), key=lambda one: kinds.index(one.kind)))
