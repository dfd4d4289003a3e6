"""How craft agree on paths that keep clear of each other, whatever messages are late or lost.

Every craft has one agreed path, which it flies, and may propose another. It may fly a proposal only
when every other craft has accepted it; see docs/fleet.md for the proof that agreed paths always
keep their distance.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
import pydantic

from airpuck.boundary.results import plain
from airpuck.fleet.path import Reach, Route
from airpuck.fleet.search import Taken, apart

#: A craft that has sent nothing for this time counts as dead [s].
SILENT = 0.5
#: Longest text, and most pieces of a path, that are read.
_LONGEST, _MOST_PIECES = 100_000, 200
#: A duration may be negative by a rounding error [s].
_ROUNDED = 1e-9


def _read_route(fields: Any) -> Route:
    """Return a path; raise ValueError if the numbers do not describe one."""
    names = [one.name for one in dataclasses.fields(Route)]
    try:
        begin, *parts = (np.array(fields[name], dtype=float) for name in names)
        count = parts[2].shape[-1]
    except (LookupError, TypeError) as error:
        raise ValueError("not a path") from error
    shapes = [(), (3,), (3,), (3, count), (3, count)]
    if [part.shape for part in (begin, *parts)] != shapes or count > _MOST_PIECES:
        raise ValueError("a path of another shape")
    finite = all(np.isfinite(part).all() for part in (begin, *parts))
    if not finite or (parts[2] < -_ROUNDED).any():
        raise ValueError("a path with impossible numbers")
    return Route(float(begin), *parts)


#: A path that messages may contain.
_Path = Annotated[Route, pydantic.PlainValidator(_read_route)]


class Numbered(NamedTuple):
    """A path with its number, which grows from path to path of a craft."""

    number: int
    path: _Path


@dataclass(frozen=True)
class Message:
    """All that a craft tells the others; any message makes all earlier ones unnecessary."""

    sender: str
    #: When it was sent, on the common clock [s].
    time: pydantic.FiniteFloat
    agreed: Numbered
    proposal: Numbered | None
    #: Numbers of the others' proposals that it has accepted, or refused.
    accepted: Mapping[str, int]
    refused: Mapping[str, int]
    #: When it expects to arrive; those who arrive last go first [s].
    arrival: pydantic.FiniteFloat
    #: The path that it would need, and the rank of that wish; None if it needs nothing.
    wish: tuple[tuple[pydantic.FiniteFloat, str], _Path] | None = None


@dataclass
class _Other:
    """What a craft knows about another one."""

    reach: Reach
    agreed: Numbered
    accepted: Numbered | None = None
    heard: float = -1.0
    said: Message | None = None


@dataclass
class Agreement:
    """The part of one craft in the agreement.

    Parameters
    ----------
    name : str
        The craft.
    reach : Reach
        What it can do.
    start : Route
        Its agreed path at the beginning.
    others : mapping
        Name, reach and agreed path at the beginning of every other craft.
    """

    name: str
    reach: Reach
    start: Route
    others: Mapping[str, tuple[Reach, Route]]
    agreed: Numbered = field(init=False)
    proposal: Numbered | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.agreed = Numbered(0, self.start)
        self.arrival = 0.0
        self.wish: tuple[tuple[float, str], Route] | None = None
        self._count = 0
        self._leaves = 0.0
        self._accepting: set[str] = set()
        self._refused: dict[str, int] = {}
        self._known = {
            name: _Other(reach, Numbered(0, path)) for name, (reach, path) in self.others.items()
        }

    def taken(self, without: Container[str] = ()) -> list[Taken]:
        """Return all paths that the others may fly, now or later; leave out some of the others."""
        found = []
        for name, other in self._known.items():
            distance = self.reach.room + other.reach.room
            for numbered in (other.agreed, other.accepted):
                if numbered is not None and name not in without:
                    found.append(Taken(numbered.path, distance))
        return found

    def followed(self) -> list[tuple[str, Reach, Route]]:
        """Return name, reach and agreed path of each other craft."""
        return [(name, one.reach, one.agreed.path) for name, one in self._known.items()]

    def propose(self, path: Route, leaves: float) -> None:
        """Propose a path that leaves the agreed one at a time; it keeps clear of `taken`."""
        self._count += 1
        self.proposal = Numbered(self._count, path)
        self._leaves = leaves
        self._accepting = set()

    def withdraw(self) -> None:
        """Give the proposal up; this is always safe."""
        self.proposal = None

    def settle(self, now: float, ahead: float) -> bool:
        """Fly the proposal if all others have accepted it; give it up if that is too late.

        The reference is used up to a time ahead [s]. Returns whether the path changed.
        """
        if self.proposal is None:
            return False
        if now + ahead >= self._leaves:
            self.withdraw()
            return False
        if self.silent(now) | self._accepting < set(self._known):
            return False
        self.agreed, self.proposal = self.proposal, None
        return True

    def silent(self, now: float) -> set[str]:
        """Return the craft that have died, as far as their messages tell."""
        return {name for name, one in self._known.items() if now - max(one.heard, 0.0) > SILENT}

    def message(self, now: float) -> Message:
        """Return what to tell the others."""
        accepted = {n: o.accepted.number for n, o in self._known.items() if o.accepted}
        return Message(
            self.name,
            now,
            self.agreed,
            self.proposal,
            accepted,
            dict(self._refused),
            self.arrival,
            self.wish,
        )

    def wishes(self, now: float) -> Iterable[tuple[tuple[float, str], Route]]:
        """Return the wishes of the others that live."""
        silent = self.silent(now)
        live = [one.said for name, one in self._known.items() if name not in silent]
        return [said.wish for said in live if said and said.wish]

    def receive(self, message: Message, now: float) -> None:
        """Take note of a message, and decide on the proposal in it."""
        other = self._known.get(message.sender)
        if other is None or (other.said is not None and message.time <= other.said.time):
            return
        other.said, other.heard = message, now
        other.agreed = message.agreed
        proposal = message.proposal
        if other.accepted is not None and (
            proposal is None or proposal.number != other.accepted.number
        ):
            other.accepted = None  # It is agreed now, or withdrawn.
        mine = self.proposal
        if mine is not None:
            if message.accepted.get(self.name) == mine.number:
                self._accepting.add(message.sender)
            elif message.refused.get(self.name) == mine.number:
                self.withdraw()
        if proposal is not None and other.accepted is None:
            self._decide(message, proposal, other, now)

    def _decide(self, message: Message, proposal: Numbered, other: _Other, now: float) -> None:
        """Accept or refuse a proposal."""
        if self._refused.get(message.sender) == proposal.number:
            return
        distance = self.reach.room + other.reach.room
        free = apart(self.agreed.path, Taken(proposal.path, distance), now)
        if free and self.proposal is not None:
            clear = apart(self.proposal.path, Taken(proposal.path, distance), now)
            if not clear and (message.arrival, message.sender) > (self.arrival, self.name):
                self.withdraw()
                clear = True
            free = clear
        if free:
            other.accepted = proposal
        else:
            self._refused[message.sender] = proposal.number


@dataclass(frozen=True)
class Letter:
    """What a craft sends: a message, and what all must know to begin together.

    Times in the message are on the sender's clock.
    """

    message: Message
    #: System time at which the sender's clock was 0, and of the start, if known [ns].
    epoch_ns: int
    start_ns: int | None
    #: Whether the craft waits for the start, and a digest of the paths that it has computed.
    ready: bool
    opening: str

    def text(self) -> str:
        """Write it as JSON."""
        return json.dumps(plain(self))

    @classmethod
    def read(cls, text: str) -> Letter:
        """Read it; raise ValueError if it is not one."""
        if len(text) > _LONGEST:
            raise ValueError(f"longer than {_LONGEST:,} characters")
        try:
            return _LETTERS.validate_json(text)
        except pydantic.ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"]))
            raise ValueError(f"not a message of a craft: {where} {first['msg']}") from error


_LETTERS = pydantic.TypeAdapter(Letter)


def digest(paths: Iterable[Route]) -> str:
    """Return a short digest of paths."""
    return hashlib.sha256(json.dumps(plain(list(paths))).encode()).hexdigest()[:16]


def on_clock(message: Message, later: float) -> Message:
    """Return a message with times on another clock, which shows a time more [s]."""

    def shift(numbered: Numbered) -> Numbered:
        return Numbered(numbered.number, numbered.path.later(later))

    wish = message.wish
    if wish is not None:
        (since, name), path = wish
        wish = (since + later, name), path.later(later)
    return replace(
        message,
        time=message.time + later,
        arrival=message.arrival + later,
        agreed=shift(message.agreed),
        proposal=None if message.proposal is None else shift(message.proposal),
        wish=wish,
    )
