"""What the page of a game shows: the table and its players, all positions, and intentions."""

from __future__ import annotations

import math
import time
from typing import Any

from airpuck import AirHockey, Model
from airpuck.extend import (
    Clock,
    PageKind,
    Pages,
    hockey_shape,
    invite,
    packed_state,
    served,
    table_of,
)
from airpuck_hockey.game.game import PERIOD, Game, GameEvent
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.player.level import LEVELS
from airpuck_hockey.player.player import Player
from airpuck_hockey.web.settings import ArenaSettings

#: The page of a game; the first page that connects plays.
GAME_PAGE = PageKind("airpuck_hockey", "play")
#: Plain words for what the craft intends; a user's tactic may have words of its own.
_INTENTIONS = {
    "strike": "straight shot",
    "bank": "shot off a rail",
    "defend": "block",
    "prepare": "catch",
    "free": "push into the open",
    "clear": "clearing hit",
    "wait": "waiting for the puck",
    "home": "back to its goal",
}


def hello_of(model: Model, equipment: AirHockey) -> dict[str, Any]:
    """Return the data that a page needs before it can show anything."""
    mallet, rules = equipment.mallet, Rules()
    return table_of(model, equipment.table) | {
        "hockey": hockey_shape(equipment),
        "mallet": {"speed": mallet.speed_m_s, "acceleration": mallet.acceleration_m_s2},
        "period": PERIOD,
        "names": ["airpuck", "you"],
        "sides": ["craft", "hand"],
        "levels": list(LEVELS),
        "first_to": rules.goals,
        "foul_s": rules.foul_s,
    }


def state_of(game: Game, heard: int = 0) -> bytes:
    """Return the message with all positions in a game; see `packed_state`."""
    left, right = game.sides
    commands: list[float] = []
    for side in game.sides:
        if side.action is not None:
            commands += side.action.step.command.tolist()
    x, y, yaw, vx, vy = right.state
    return packed_state(
        game.world.time,
        heard,
        game.puck is None,
        game.puck or (0.0, 0.0, 0.0),
        (x, y, vx, vy) if right.kind == "hand" else (x, y, yaw, 0.0),
        left.state,
        commands,
    )


def news_of(event: GameEvent) -> dict[str, Any] | None:
    """Return the message to a page about an audible or announced event, or None."""
    kind = event.kind
    if kind == "hit":
        kind = "craft" if event.side < 0 else "mallet"
    elif kind not in ("rail", "post", "goal", "foul"):
        return None
    return {"is": "event", "kind": kind, "side": event.side, "strength": event.value}


def thought_of(player: Player, time: float) -> dict[str, Any]:
    """Return the craft's expectations and intention, for the page."""
    intention, predicted = player.intention, player.predicted
    thought: dict[str, Any] = {"is": "thought", "words": "", "meet": None, "path": None}
    thought["predicted"] = None if predicted is None else predicted.round(4).tolist()
    decision, control = (1e3 * took for took in player.took)
    said = "" if player.sight == "seen" else f"The puck is {player.sight}. "
    if intention is not None:
        words = _INTENTIONS.get(intention.kind, intention.kind)
        said += words[:1].upper() + words[1:]
        if intention.chance is not None and math.isfinite(intention.chance):
            words += f": {100 * intention.chance:.0f} %"
        thought["words"] = words
        if intention.meet is not None:
            when, x, y = intention.meet
            thought["meet"] = [round(x, 4), round(y, 4)]
            said += f" in {max(when - time, 0.0):.2f} s"
        if intention.path is not None:
            thought["path"] = intention.path.round(4).tolist()
        said += ". "
    computed = f"Computing time: {decision:.1f} ms to decide, {control:.1f} ms to steer."
    thought["said"] = said + computed
    return thought


#: Polling period for the first page, and time for which the page shows the winner [s].
_LOOK, _END = 0.02, 3.0


def watch_in_browser(game: Game, model: Model, arena: ArenaSettings, tell: Any = print) -> None:
    """Play a game in real time, once the first page is connected; pages only show it.

    Parameters
    ----------
    game : Game
        The game; it is played to its end.
    model : Model
        The craft.
    arena : ArenaSettings
        Where to serve the page.
    tell : callable, default print
        Receives the line with the page's address.

    Raises
    ------
    InputError
        If websockets is not installed, or the address is not free.
    """
    names, kinds = ([getattr(side, what) for side in game.sides] for what in ("name", "kind"))
    hello = hello_of(model, game.settings)
    hello |= {"live": True, "levels": [], "names": names, "sides": kinds}
    with served(arena.host, arena.port, hello, page=GAME_PAGE) as pages:
        pages.say_status("watch", game.score, "")
        invite(pages, arena.browser, tell, "Watch")
        _show(game, pages)
        if pages.lost:
            tell("The page server has ended; the game was played to its end without a page.")


def _show(game: Game, pages: Pages) -> None:
    """Play a game to its end, and show it."""
    while not pages.hear()[0] and not pages.lost:  # the first page takes the seat
        time.sleep(_LOOK)
    thinker = next((s.player for s in game.sides if isinstance(s.player, Player)), None)
    clock, began = Clock(), game.time
    while game.phase != "over":
        events = game.step()
        pages.show(state_of(game))
        for event in events:
            news = news_of(event)
            if event.kind in ("stuck", "over"):
                news = {"is": "event", "kind": event.kind, "side": event.side}
            if news is not None:
                pages.say(news)
        pages.say_status("watch", game.score, "")
        pages.hear()
        if thinker is not None:
            pages.think(lambda: thought_of(thinker, game.time))
        if not pages.lost:
            clock.sleep_until(game.time - began)
    if not pages.lost:
        time.sleep(_END)
