"""Environments of air hockey for reinforcement learning, as a kind of export."""

from airpuck.extend import ExportKind

#: For the entry point ``airpuck.exports``.
GYM = ExportKind(
    "air hockey as Gymnasium and PettingZoo environments", "airpuck_hockey.export.gym", ("twin",)
)
