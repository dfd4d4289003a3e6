"""`python -m airpuck`: the command line."""

from airpuck.cli import main

if __name__ == "__main__":
    main()
