"""The equations of motion: pure functions over an array namespace.

Entry points: `rigid_body.Dynamics`, `rigid_body.acceleration`, `thrust.thrust`,
`thrust.InverseThrust`, `motor.motor_speeds`, `rigid_body.rollout`,
`puck_on_table.PuckOnTable`.
"""
