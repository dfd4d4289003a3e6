"""Air hockey with a craft: pucks, players, games, a page to play on, environments.

Public names are imported on first use. The commands ``match``, ``play`` and so on, the export
``gym-hockey`` and the campaign item ``match`` join airpuck through entry points.
"""

from airpuck.extend import public_names

__getattr__, __dir__ = public_names(__name__, __file__, checked=True)
