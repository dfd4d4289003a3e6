"""Address and duration of serving a game."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from airpuck.extend import Setting, Settings, numbers


@dataclass(frozen=True)
class ArenaSettings(Settings):
    """Address and duration of serving a game.

    Parameters
    ----------
    port : int, default 8088
        Port of the page.
    interface : str, optional
        Network interface; by default loopback, so that only this machine can play.
    browser : bool, default True
        Whether to open the page.
    duration : float, optional
        How long to serve [s]; by default until SIGINT or SIGTERM.

    Raises
    ------
    InputError
        If a number is out of range.
    """

    HEADING: ClassVar = "Page"

    port: Annotated[int, Setting("Port of the page.", numbers.PORT, "N")] = 8088
    interface: Annotated[
        str | None,
        Setting("Network interface, such as eth0; by default this machine alone.", metavar="NAME"),
    ] = None
    browser: Annotated[
        bool, Setting("Whether to open the page in a browser.", option="--browser/--no-browser")
    ] = True
    duration: Annotated[
        float | None,
        Setting("How long to run; by default until Ctrl-C", numbers.LIVE_DURATION, "S"),
    ] = None

    @property
    def host(self) -> str:
        """Address to serve at."""
        from airpuck.extend import address_of

        return address_of(self.interface)
