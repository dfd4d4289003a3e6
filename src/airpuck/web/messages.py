"""Messages between pages and their server.

Positions are sent as packed numbers, a hundred times a second; all else is JSON. Messages from a
page are checked here: they may contain anything.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, get_args

#: Requests of a page other than a target for the mallet.
Deed = Literal["go", "pause", "restart", "level", "sit", "think"]
DEEDS = get_args(Deed)
#: Longest valid message from a page [bytes].
LONGEST = 64

_WISH = struct.Struct("<Ifff")
_STATE = struct.Struct("<dIB3x")


class Wish(NamedTuple):
    """A page's target for the mallet of a game, or for the set point of a craft."""

    #: Sequence number of this message, per page.
    number: int
    #: [m, m, rad]; a mallet has no yaw.
    x: float
    y: float
    yaw: float = 0.0


class Order(NamedTuple):
    """Another request of a page."""

    do: Deed
    #: The chosen level, if any.
    level: str = ""
    #: Whether to show the player's plans.
    on: bool = False


def read_message(message: str | bytes) -> Wish | Order | None:
    """Return a page's request; None for messages that our pages never send."""
    if len(message) > LONGEST:
        return None
    return _read_wish(message) if isinstance(message, bytes) else _read_order(message)


def packed_wish(wish: Wish) -> bytes:
    """Return the message of a wish."""
    return _WISH.pack(*wish)


def packed_state(
    time: float,
    heard: int,
    hidden: bool,
    puck: Sequence[float],
    mallet: Sequence[float],
    craft: Sequence[float],
    commands: Sequence[float],
) -> bytes:
    """Return the message of a state.

    Puck: x, y, yaw; mallet: x, y and their rates, or for a craft in its place: x, y, yaw, 0; craft,
    on the left: x, y, yaw. `commands` belong to the craft from left to right. `heard` is the
    sequence number of the newest wish that the game has processed.
    """
    numbers = [*puck[:3], *mallet[:4], *craft[:3], *commands]
    return _STATE.pack(time, heard, hidden) + struct.pack(f"<{len(numbers)}f", *numbers)


def _read_wish(data: bytes) -> Wish | None:
    """Return a wish, if the message is one."""
    if len(data) != _WISH.size:
        return None
    wish = Wish(*_WISH.unpack(data))
    return wish if all(map(math.isfinite, wish[1:])) else None


def _read_order(text: str) -> Order | None:
    """Return an order, if the message is one."""
    try:
        order: Any = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(order, dict) or order.get("do") not in DEEDS:
        return None
    level, on = order.get("level", ""), order.get("on", False)
    if not isinstance(level, str) or not isinstance(on, bool):
        return None
    return Order(order["do"], level, on)
