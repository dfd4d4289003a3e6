"""Models and controllers for other tools: one module for each kind of export.

Entry points: `kinds.write`; functions that return objects: `casadi.functions`, `mjcf.xml`,
`holohover.params_json`, `holohover.params_yaml`, `matlab.parameters`.
"""

from airpuck.export.kinds import KINDS, ExportKind, Subject, Written, refuse_effects, write

__all__ = ["KINDS", "ExportKind", "Subject", "Written", "refuse_effects", "write"]
