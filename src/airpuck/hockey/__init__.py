"""Air hockey: puck estimation and prediction, a craft that plays, games.

Entry points: `puck_filter.PuckFilter`, `prediction.predict_puck`,
`prediction.predict_crossing`, `player.Player`, `level.Level`, `tactic.Tactic`, `game.Game`,
`contestant.contestant`, `minimal_time.read_minimal_times`.
"""
