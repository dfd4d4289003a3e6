"""`airpuck`, and `python -m airpuck`: the command line."""

import sys


def main() -> None:
    """Run the command line; Ctrl-C ends it with one line while it is still being imported, too."""
    try:
        from airpuck.cli import main as run

        run()
    except KeyboardInterrupt:
        print("airpuck: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
