"""The command line: each command parses, calls the verb of the same name, and prints."""

# In the order in which the help lists their commands.
from airpuck.cli import learning, validation, flying, designing  # isort: skip
from airpuck.cli import live, campaign, study  # isort: skip
from airpuck.cli.app import main

__all__ = ["campaign", "designing", "flying", "learning", "live", "main", "study", "validation"]
