"""A boat with two propellers side by side, simulated independently of the package."""

import numpy as np

from airpuck import Recording, Vehicle

#: Sample period [s], full thrust [N], mass [kg], inertia [kg m²], lever arm [m] and lag [s].
PERIOD, FULL, MASS, INERTIA, ARM, LAG = 0.02, 20.0, 16.0, 2.0, 0.25, 0.08
#: Damping of surge and sway [N s/m], and of yaw [N m s].
DAMPING, TURN_DAMPING = np.array([15.0, 30.0]), 4.0


def boat() -> Vehicle:
    """Its vehicle file, which is right."""
    propellers = [
        {"name": name, "position_m": (-0.3, y), "direction_deg": 0.0}
        for name, y in (("port", ARM), ("starboard", -ARM))
    ]
    nominal = {"thrust_N": (0.0, FULL), "inertia_kg_m2": INERTIA, "motor_time_constant_s": LAG}
    return Vehicle.model_validate(
        {"name": "boat", "mass_kg": MASS, "radius_m": 0.5, "command_max": 1.0}
        | {"propellers": propellers, "nominal": {**nominal, "transport_delay_s": 0.0}}
    )


def sail(helm, duration: float, noise: float = 2e-4, seed: int = 0) -> Recording:
    """Record a voyage; `helm` maps time [s] and yaw [rad] to the two commands."""
    rng, count = np.random.default_rng(seed), round(duration / PERIOD)
    pose, motion, force = np.zeros(3), np.array([0.5, 0.0, 0.0]), np.full(2, 0.25 * FULL)
    time, poses, commands = PERIOD * np.arange(count), np.zeros((count, 3)), np.zeros((count, 2))
    for k in range(count):
        command = np.array(helm(time[k], pose[2]), dtype=float)
        poses[k], commands[k] = pose, command
        for _ in range(4):
            h = PERIOD / 4
            force += h / LAG * (FULL * command**2 - force)
            along, turning = motion[:2], motion[2]
            push = np.array([force.sum(), 0.0]) - DAMPING * along
            # The frame turns with the boat.
            coriolis = turning * np.array([along[1], -along[0]])
            moment = ARM * (force[1] - force[0]) - TURN_DAMPING * turning
            motion = motion + h * np.append(push / MASS + coriolis, moment / INERTIA)
            cos, sin = np.cos(pose[2]), np.sin(pose[2])
            u, v = motion[:2]
            pose = pose + h * np.array([cos * u - sin * v, sin * u + cos * v, motion[2]])
    poses += noise * rng.standard_normal(poses.shape)
    return Recording.from_arrays(time, poses, time, commands, propellers=("port", "starboard"))


def zigzag():
    """The ships' test: bang-bang feedback on the heading, with a constant sum of the commands."""
    side = -1

    def helm(_: float, yaw: float) -> tuple[float, float]:
        nonlocal side
        if side * yaw > 0.35:
            side = -side
        return 0.5 - 0.1 * side, 0.5 + 0.1 * side

    return helm
