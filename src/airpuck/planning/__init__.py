"""The shortest time from one state to another: planned, and bounded from below.

Entry points: `plan.plan`, `plan.read_plan`, `certificate.lower_bound`,
`minimal_time.read_minimal_times`.
"""
