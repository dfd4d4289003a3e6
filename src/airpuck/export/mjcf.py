"""The craft on its table for MuJoCo: a planar rigid body, site actuators, rails, sensors."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from airpuck.craft.table import Table
from airpuck.craft.vehicle import GRAVITY
from airpuck.export.kinds import (
    Subject,
    printable,
    refuse_actuators,
    refuse_effects,
    refuse_frame,
    refuse_settings,
)
from airpuck.model.model_file import Model
from airpuck.physics.effects import Tilt

#: Time step [s].
_TIMESTEP = 2.5e-4
#: Angular frequency of a contact with a rail [rad/s]: it lasts about 6 ms, or 25 steps, and a craft
#: at 1 m/s penetrates the rail by 2 mm.
_RAIL = 500.0
#: MuJoCo's largest constraint impedance. The smaller its difference from 1, the less a force that
#: pushes the craft into the rail affects the bounce.
_IMPEDANCE = "0.9999 0.9999 0.001 0.5 2"
#: Lowest restitution exported: below it, the damping makes the contact stiff [fraction].
_LEAST_RESTITUTION = 0.05
#: Drawn height and thickness of a rail [m].
_RAIL_HEIGHT, _RAIL_THICKNESS = 0.03, 0.05
_HEADER = """ {name}: {vehicle}, written by airpuck.

  Units are SI. qpos is x, y, yaw, and qvel their rates, of the geometric centre. The activations
  are the motor speeds in [0, 1], then their squares, and so on up to the degree of the thrust
  curves: the force of an actuator is linear in its activation. Set the controls with set_command
  of airpuck_craft.py before each step.

  dyntype="filterexact" is the exact solution of the motors' lag with the integrators Euler and
  implicitfast, but not with RK4; use dyntype="filter" there.

  Not in this file: the transport delay of {delay:.4g} ms, noise, and goals.
"""


def xml(model: Model, table: Table) -> str:
    """Return the MJCF of a craft on its table.

    Parameters
    ----------
    model : Model
        The craft. The table's tilt is the only effect that MuJoCo can represent here.
    table : Table
        Size of the table, restitution and friction of its rails.

    Returns
    -------
    str
        The file's content.

    Raises
    ------
    InputError
        If MuJoCo cannot represent the model.
    """
    refuse_effects(model, "mjcf", [Tilt])
    refuse_actuators(model, "mjcf")
    refuse_frame(model, "mjcf", "body")
    root = ElementTree.Element("mujoco", model="airpuck")
    names = {"name": printable(model.name), "vehicle": printable(model.vehicle.name)}
    header = _HEADER.format(**names, delay=1e3 * model.transport_delay)
    root.append(ElementTree.Comment(header))
    slopes = [effect.gravity for effect in model.dynamics.effects if effect.gravity is not None]
    _add(
        root,
        "option",
        timestep=_TIMESTEP,
        # Without lag the forces jump, which RK4 alone integrates exactly.
        integrator="implicitfast" if model.parameters.motor_time_constant > 0 else "RK4",
        cone="elliptic",
        gravity=[*np.sum([(0.0, 0.0), *slopes], axis=0), -GRAVITY],
    )
    # Until when the controls are right, which set_command checks.
    _add(root, "size", nuserdata=1)
    custom = _add(root, "custom")
    _add(custom, "numeric", name="thrust_degree", data=np.shape(model.parameters.thrust)[1])
    world = _add(root, "worldbody")
    _add(world, "light", pos=(0, 0, 3), directional="true")
    _add_table(world, table)
    gears = _add_craft(world, model)
    _add_contacts(root, table)
    _add_actuators(root, model, gears)
    _add_sensors(root, model)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write the MJCF, and the Python functions that set its controls."""
    model, table = subject.model, subject.twin.table
    refuse_settings(subject.twin, "mjcf", ("effects", "motors"))
    (folder / "craft.xml").write_text(xml(model, table), encoding="utf-8")
    # Not imported: an export does not need MuJoCo.
    shutil.copyfile(Path(__file__).with_name("mujoco_craft.py"), folder / "airpuck_craft.py")
    return {
        "time step": f"{1e3 * _TIMESTEP:g} ms",
        "thrust": "set_command of airpuck_craft.py sets the controls before each step",
        "transport delay": f"{1e3 * model.transport_delay:.4g} ms, not in the file",
        "not in the file": "goals, puck and mallet, sensors and radio of the twin",
    }


def _add(parent: ElementTree.Element, tag: str, **attributes: Any) -> ElementTree.Element:
    """Append an element; its numbers are read back bit for bit."""
    values = {
        name: printable(value)
        if isinstance(value, str)
        else " ".join(map(_number, np.ravel(value)))
        for name, value in attributes.items()
    }
    return ElementTree.SubElement(parent, tag, values)


def _number(value: Any) -> str:
    """Return a number in the fewest digits that identify it."""
    return repr(float(value)).removesuffix(".0")


def _add_table(world: ElementTree.Element, table: Table) -> None:
    """Add the surface, which nothing collides with, and the rails."""
    x, y, half = table.length_m / 2, table.width_m / 2, _RAIL_THICKNESS / 2
    surface = {"type": "plane", "contype": 0, "conaffinity": 0, "rgba": "0.9 0.9 0.9 1"}
    height = _RAIL_HEIGHT / 2
    _add(world, "geom", name="table", size=(x, y, 0.01), pos=(0, 0, -height), **surface)
    for name, position, size in (
        ("east", (x + half, 0), (half, y + 2 * half)),
        ("west", (-x - half, 0), (half, y + 2 * half)),
        ("north", (0, y + half), (x + 2 * half, half)),
        ("south", (0, -y - half), (x + 2 * half, half)),
    ):
        _add(
            world,
            "geom",
            name=f"rail_{name}",
            type="box",
            pos=(*position, 0),
            size=(*size, height),
            contype=0,
            conaffinity=0,
            rgba="0.3 0.3 0.35 1",
        )


def _add_craft(world: ElementTree.Element, model: Model) -> np.ndarray:
    """Add the body; return the gear of each motor, so that any Π is represented exactly."""
    vehicle, dynamics = model.vehicle, model.dynamics
    mass, inertia = vehicle.mass_kg, float(model.parameters.inertia)
    center = np.asarray(model.parameters.center_of_mass, dtype=float)
    body = _add(world, "body", name="craft")
    for name, kind, axis in (
        ("x", "slide", "1 0 0"),
        ("y", "slide", "0 1 0"),
        ("yaw", "hinge", "0 0 1"),
    ):
        _add(body, "joint", name=name, type=kind, axis=axis)
    # Only the moment about the vertical axis acts; the others satisfy the triangle inequality.
    _add(
        body, "inertial", pos=(*center, 0), mass=mass, diaginertia=np.array([0.6, 0.6, 1]) * inertia
    )
    seen = {"contype": 0, "conaffinity": 0}
    radius = vehicle.radius_m
    _add(body, "geom", type="cylinder", size=(radius, 0.01), rgba="0.2 0.4 0.8 1", **seen)
    # A sphere touches a rail at one point.
    _add(body, "geom", name="hull", type="sphere", size=radius, group=3, **seen)
    turned = model.parameters.angle_offset
    cos, sin = math.cos(turned), math.sin(turned)
    places = vehicle.positions @ np.array([[cos, sin], [-sin, cos]])
    forces, moments = mass * dynamics.configuration[:2].T, inertia * dynamics.configuration[2]
    gears = np.zeros((len(places), 6))
    for propeller, place, force, moment, gear in zip(
        vehicle.propellers, places, forces, moments, gears, strict=True
    ):
        angle, (px, py) = math.atan2(force[1], force[0]), place - center
        _add(
            body,
            "site",
            name=propeller.name,
            pos=(*place, 0),
            quat=(math.cos(angle / 2), 0, 0, math.sin(angle / 2)),
            size=0.006,
            rgba="0.9 0.5 0.1 1",
        )
        # A learned Π may turn the craft differently than the forces at its propellers would.
        gear[0], gear[5] = math.hypot(*force), moment - (px * force[1] - py * force[0])
    return gears


def _add_contacts(root: ElementTree.Element, table: Table) -> None:
    """Add contacts between craft and rails with the table's restitution and friction."""
    damping = _damping_ratio(max(table.restitution, _LEAST_RESTITUTION))
    contacts = _add(root, "contact")
    for rail in ("east", "west", "north", "south"):
        _add(
            contacts,
            "pair",
            geom1="hull",
            geom2=f"rail_{rail}",
            condim=3,
            friction=(table.friction, table.friction, 0, 0, 0),
            solref=(-(_RAIL**2), -2 * damping * _RAIL),
            solimp=_IMPEDANCE,
        )


def _damping_ratio(restitution: float) -> float:
    """Return the damping ratio of a spring and damper that bounces with a restitution.

    A contact ends when spring and damper no longer push. After a contact of duration t the speed is
    exp(-ζ t) times the speed before it, with time in units of the spring's (Schwager, Pöschel,
    Granular Matter 9, 2007).
    """

    def bounce(ratio: float) -> float:
        away = math.sqrt(abs(1 - ratio**2))
        if ratio < 1:
            time = math.atan2(2 * ratio * away, 2 * ratio**2 - 1) / away
        else:
            time = math.atanh(2 * ratio * away / (2 * ratio**2 - 1)) / away
        return math.exp(-ratio * time)

    low, high = 0.0, 0.999999
    if restitution < bounce(high):
        low, high = 1.000001, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if bounce(middle) > restitution else (low, middle)
    return low


def _add_actuators(root: ElementTree.Element, model: Model, gears: np.ndarray) -> None:
    """Add an actuator for each motor and power of its speed, all motors of a power together."""
    vehicle, tau = model.vehicle, float(model.parameters.motor_time_constant)
    actuators = _add(root, "actuator")
    for k, coefficients in enumerate(np.asarray(model.parameters.thrust).T):
        for name, coefficient, gear in zip(
            vehicle.propeller_names, coefficients, gears, strict=True
        ):
            lag = {"dyntype": "filterexact", "dynprm": tau / (k + 1)} if tau > 0 else {}
            # A motor that starts from rest needs lower controls for the higher powers.
            limits = (vehicle.command_min if k == 0 else 0.0, vehicle.command_max ** (k + 1))
            _add(
                actuators,
                "general",
                name=_actuator(name, k),
                site=name,
                gear=gear,
                gainprm=coefficient,
                ctrlrange=limits,
                ctrllimited="true",
                **lag,
            )


def _actuator(name: str, k: int) -> str:
    """Return the name of the actuator for a motor and the power k + 1 of its speed."""
    return name if k == 0 else f"{name}^{k + 1}"


def _add_sensors(root: ElementTree.Element, model: Model) -> None:
    """Add pose and velocity of the geometric centre, and the forces of the actuators."""
    sensors = _add(root, "sensor")
    # No framepos: mujoco.sysid divides by each channel's size, and the height is always zero.
    for joint, rate in (("x", "vx"), ("y", "vy"), ("yaw", "spin")):
        _add(sensors, "jointpos", name=f"pose_{joint}", joint=joint)
        _add(sensors, "jointvel", name=rate, joint=joint)
    for k in range(np.shape(model.parameters.thrust)[1]):
        for propeller in model.vehicle.propeller_names:
            name = _actuator(propeller, k)
            _add(sensors, "actuatorfrc", name=f"force_{name}", actuator=name)
