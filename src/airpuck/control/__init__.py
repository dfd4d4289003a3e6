"""Controllers: from a model to motor commands.

Entry points: `lqr.lqr_gain`, `allocation.ThrustAllocator`, `excitation.Excitation`,
`reference.Reference`, `authority.control_authority`.
"""
