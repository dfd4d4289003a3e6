"""Ends a study with one line if its input is unusable, as commands do."""

from __future__ import annotations

import sys
from collections.abc import Callable

from airpuck import InputError


def run(main: Callable[[], None]) -> None:
    """Run a study; bad input ends with one line and status 2."""
    try:
        main()
    except InputError as error:
        print(f"{sys.argv[0]}: " + " ".join(str(error).split()), file=sys.stderr)
        sys.exit(2)
