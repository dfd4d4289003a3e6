"""The command line: each command parses, calls the verb of the same name, and prints."""

# In the order in which the help lists their commands.
from airpuck.cli import learning, faults, judging, flying, designing  # isort: skip
from airpuck.cli import live, many, study  # isort: skip
from airpuck.cli.app import main

__all__ = [
    "designing",
    "faults",
    "flying",
    "judging",
    "learning",
    "live",
    "main",
    "many",
    "study",
]
