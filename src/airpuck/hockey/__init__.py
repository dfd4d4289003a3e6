"""Air hockey: where the puck is and where it will be, and a craft that plays.

Entry points: `puck_filter.PuckFilter`, `prediction.predict_puck`,
`prediction.predict_crossing`, `player.Player`, `level.Level`, `tactic.Tactic`.
"""
