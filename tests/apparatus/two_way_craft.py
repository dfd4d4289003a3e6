"""A craft whose propellers reverse and which has a reaction wheel."""

from pathlib import Path

from airpuck import Vehicle, read_vehicle

#: Three reversible propellers at 120°, through the centre, and a wheel: 3 s to its largest speed.
TRIANGLE = """
name = "triangle"
mass_kg = 2.0
radius_m = 0.15
propellers = [
    {name = "a", position_m = [0.1, 0.0], direction_deg = 0.0, reverse = 0.5},
    {name = "b", position_m = [-0.05, 0.0866], direction_deg = 120.0, reverse = 0.5},
    {name = "c", position_m = [-0.05, -0.0866], direction_deg = 240.0},
]
[[wheels]]
name = "wheel"
torque_Nm = 0.02
inertia_kg_m2 = 1e-4
max_speed_rad_s = 600.0
COMMANDED
[nominal]
thrust_N = [0.1, 0.3]
inertia_kg_m2 = 0.022
motor_time_constant_s = 0.06
"""


def triangle(tmp_path: Path, commanded: str = "", **changes: str) -> Vehicle:
    text = TRIANGLE.replace("COMMANDED", commanded)
    for old, new in changes.items():
        text = text.replace(old, new)
    (tmp_path / "triangle.toml").write_text(text)
    return read_vehicle(tmp_path / "triangle.toml")
