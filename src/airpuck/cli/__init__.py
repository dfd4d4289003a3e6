"""The command line: each command parses, calls the verb of the same name, and prints."""

from airpuck.cli.app import main

__all__ = ["main"]
