"""A craft that plays: what it sees, its tactics, and the player that steers it.

Entry points: `player.Player`, `player.Level`, `tactic.Tactic`.
"""
