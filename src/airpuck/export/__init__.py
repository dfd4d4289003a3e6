"""Models and controllers for other tools: one module for each kind of export.

Entry points: `write`, and the functions of the kinds' modules that return objects.
"""

from airpuck.export.kinds import KINDS, Kind, Subject, Written, refuse_effects, write

__all__ = ["KINDS", "Kind", "Subject", "Written", "refuse_effects", "write"]
