"""Messages between craft as text, for any network."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from airpuck.fleet.agreement import Message, Numbered
from airpuck.fleet.path import Route

#: Longest text, and most pieces of a path, that are read.
_LONGEST, _MOST_PIECES = 100_000, 200
#: A duration may be negative by a rounding error [s].
_ROUNDED = 1e-9


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
        return json.dumps(vars(self) | {"message": _fields(self.message)})

    @classmethod
    def read(cls, text: str) -> Letter:
        """Read it; raise ValueError if it is not one."""
        if len(text) > _LONGEST:
            raise ValueError(f"longer than {_LONGEST:,} characters")
        try:
            fields = json.loads(text)
            start = fields["start_ns"]
            return cls(
                _message(fields["message"]),
                int(fields["epoch_ns"]),
                None if start is None else int(start),
                bool(fields["ready"]),
                str(fields["opening"]),
            )
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
            raise ValueError(f"not a message of a craft: {error!r}") from error
        except RecursionError as error:
            raise ValueError("not a message of a craft") from error


def digest(paths: Iterable[Route]) -> str:
    """Return a short digest of paths."""
    said = hashlib.sha256(json.dumps([_route(path) for path in paths]).encode())
    return said.hexdigest()[:16]


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


def _fields(message: Message) -> dict[str, Any]:
    """Return a message as JSON's types."""
    wish = message.wish
    return {
        "sender": message.sender,
        "time": float(message.time),
        "arrival": float(message.arrival),
        "agreed": _numbered(message.agreed),
        "proposal": None if message.proposal is None else _numbered(message.proposal),
        "accepted": dict(message.accepted),
        "refused": dict(message.refused),
        "wish": None if wish is None else [float(wish[0][0]), wish[0][1], _route(wish[1])],
    }


def _message(fields: dict[str, Any]) -> Message:
    """Return a message from JSON's types; raise ValueError if a number is not finite."""
    time, arrival = float(fields["time"]), float(fields["arrival"])
    if not np.isfinite([time, arrival]).all():
        raise ValueError("a time that is not finite")
    wish = fields["wish"]
    if wish is not None:
        since, name, path = wish
        wish = (float(since), str(name)), _read_route(path)
    proposal = fields["proposal"]
    return Message(
        str(fields["sender"]),
        time,
        _read_numbered(fields["agreed"]),
        None if proposal is None else _read_numbered(proposal),
        {str(k): int(v) for k, v in fields["accepted"].items()},
        {str(k): int(v) for k, v in fields["refused"].items()},
        arrival,
        wish,
    )


def _numbered(one: Numbered) -> list[Any]:
    return [one.number, _route(one.path)]


def _read_numbered(fields: Any) -> Numbered:
    number, path = fields
    return Numbered(int(number), _read_route(path))


def _route(path: Route) -> list[Any]:
    arrays = path.pose, path.rate, path.durations, path.accelerations
    return [float(path.begin), *(array.tolist() for array in arrays)]


def _read_route(fields: Any) -> Route:
    """Return a path; raise ValueError if the numbers do not describe one."""
    begin, *arrays = fields
    pose, rate, durations, accelerations = (np.array(array, dtype=float) for array in arrays)
    count = durations.shape[-1]
    shapes = [(3,), (3,), (3, count), (3, count)]
    parts = [pose, rate, durations, accelerations]
    if [part.shape for part in parts] != shapes or count > _MOST_PIECES:
        raise ValueError("a path of another shape")
    finite = np.isfinite(float(begin)) and all(np.isfinite(part).all() for part in parts)
    if not finite or (durations < -_ROUNDED).any():
        raise ValueError("a path with impossible numbers")
    return Route(float(begin), pose, rate, durations, accelerations)
