"""Models of craft that play."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import cache

import airpuck
from airpuck.extend import about, read_belief, say, show_time_left


def read_player(name: str, quiet: bool) -> airpuck.Model:
    """Read a model for a player; first plan its shortest times if they are unknown."""
    from airpuck.extend import minimal_times_of
    from airpuck_hockey.player.player import check_player

    model = read_belief(name)
    with about(name):
        check_player(model)
    with ExitStack() as stack:

        @cache
        def progress() -> Callable[[float, float], None]:  # shown only if there is any work
            words = "planning this craft's shortest times, once"
            return stack.enter_context(show_time_left(words, quiet))

        with about(name):
            times = minimal_times_of(model, lambda done, of: progress()(done, of))
    if times.margin > 0:
        say(quiet)(
            f"{name}: this craft's shortest times are uncertain by {times.error['p95']:.2f} s; its "
            f"player allows {times.margin:.2f} s more for each move and tries fewer shots"
        )
    return model
