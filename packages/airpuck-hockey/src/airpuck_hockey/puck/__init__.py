"""The puck: where it is and will be, and what its recordings say about drag and bounces.

Entry points: `puck_filter.PuckFilter`, `prediction.predict_puck`, `prediction.predict_crossing`,
`identification.identify_puck`.
"""
