"""`airpuck`, and `python -m airpuck`: the command line."""

import sys

from airpuck.boundary.signals import catch_signals

# The rest takes a second to import. Other programs may import this module, and so do workers.
if sys.argv[0].endswith(("airpuck", "__main__.py")) and "multiprocessing" not in sys.modules:
    catch_signals()


def main() -> None:
    """Run the command line."""
    from airpuck.cli import main as run

    run()


if __name__ == "__main__":
    main()
