"""Names for those who extend airpuck, beyond the names of `airpuck` itself.

Other distributions add commands, exports, laws, effects, actuators, items of campaigns and
opponents by entry points (`airpuck.boundary.extensions`); airpuck-hockey does so with these names
alone. Names are imported on first use; the stub file groups them.
"""

from airpuck.boundary.public import public_names

__getattr__, __dir__ = public_names(__name__, __file__)
