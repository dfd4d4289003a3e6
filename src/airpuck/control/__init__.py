"""Controllers: from a model to motor commands.

Entry points: `lqr.law`, `allocation.ThrustAllocator`, `excitation.Excitation`,
`reference.Reference`, `authority.control_authority`.
"""
