"""Air hockey: where the puck is and where it will be.

Entry points: `puck_filter.PuckFilter`, `prediction.predict_puck`,
`prediction.predict_crossing`.
"""
