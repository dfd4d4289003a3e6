"""A match in the browser: two players, in real time, with any number of spectators."""

from __future__ import annotations

import time
from typing import Any

from airpuck import Model
from airpuck.extend import Clock, Pages, invite, served
from airpuck_hockey.game.game import Game
from airpuck_hockey.player.player import Player
from airpuck_hockey.web.page import GAME_PAGE, hello_of, news_of, state_of, thought_of
from airpuck_hockey.web.settings import ArenaSettings

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
