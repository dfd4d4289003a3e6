"""The command line: each command parses, calls the verb of the same name, and prints."""

# In the order in which the help lists their commands.
from airpuck.cli import identification, validation, flying, designing, planning, export  # noqa: F401 # isort: skip
from airpuck.cli import live, study  # noqa: F401 # isort: skip
from airpuck.cli.app import main

__all__ = ["main"]
