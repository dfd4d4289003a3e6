"""A vehicle file set right by what single motors do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from airpuck.boundary.results import Finding
from airpuck.craft.vehicle import Vehicle
from airpuck.faults.propeller_check import EffectMatch, force_to_moment, match_effects
from airpuck.model.model_file import Model
from airpuck.physics.rigid_body import acceleration_map

#: Bounds for the ratio of measured and stated inertia: beyond, the pulses were disturbed.
_INERTIA = (0.4, 2.5)
#: Least thrust of a motor whose pulses tell none, relative to the median motor's.
_LEAST = 0.1


def matched(model: Model, effects: Float[np.ndarray, "3 n"]) -> dict[int, EffectMatch]:
    """Match the measured effects of motors (nan: not measured) with the model's.

    A wrong inertia scales all moments alike. So moments are first scaled to the forces, if most
    motors are measured: then the scale does not depend on their order.
    """
    scale = np.array([1.0, 1.0, model.radius_of_gyration])[:, None]
    expected = scale * acceleration_map(np, model.dynamics, 0.0, 0.0)[0]
    motors = np.flatnonzero(np.isfinite(effects).all(axis=0))
    seen = scale * effects[:, motors]
    if 2 * len(motors) > expected.shape[1]:
        factor = force_to_moment(seen, np.zeros_like(seen), expected[:, motors])
        expected[2] /= np.clip(factor, *_INERTIA)
    return match_effects(seen, expected, motors)


def layout_findings(vehicle: Vehicle, matches: Mapping[int, EffectMatch]) -> list[Finding]:
    """Name the motors that act like another one, or the other way."""
    names, found = vehicle.propeller_names, []
    for k, match in sorted(_of_propellers(vehicle, matches).items()):
        if match.acts_as is None:
            continue
        other = names[match.acts_as]
        if match.acts_as != k:
            how = "" if match.sign > 0 else " the other way round"
            remedy = f"Exchange their cables, or give {names[k]} the place of {other}."
            found.append(Finding("order", f"{names[k]} acts like {other}{how}", "", remedy))
        elif match.sign < 0:
            remedy = f"Add 180 to direction_deg of {names[k]}, or turn it round."
            found.append(Finding("layout", f"{names[k]} pushes the other way", "", remedy))
    return found


def corrected(vehicle: Vehicle, matches: Mapping[int, EffectMatch]) -> Vehicle:
    """Return a copy whose motors stand and push as their effects say; names stay in order."""
    matches = _of_propellers(vehicle, matches)
    if all(match.acts_as == k and match.sign > 0 for k, match in matches.items()):
        return vehicle
    given, propellers, place = vehicle.propellers, list(vehicle.propellers), dict[int, int]()
    taken = {match.acts_as: k for k, match in matches.items()}
    for k in set(range(len(given))) - set(matches):
        # An untried motor whose place is taken most likely has the place of the one that took it.
        there = k
        while there in taken:
            there = taken[there]
        matches[k] = EffectMatch(there, 1, 1.0)
    curves = vehicle.nominal_thrust[: len(given)].copy()
    for k, match in matches.items():
        if match.acts_as is None:
            continue
        source = given[match.acts_as]
        turned = (source.direction_deg + 90 * (1 - match.sign)) % 360
        reverse = given[k].reverse and (source.reverse or given[k].reverse)
        update = {"position_m": source.position_m, "direction_deg": turned, "reverse": reverse}
        propellers[k] = given[k].model_copy(update=update)
        curves[k] = vehicle.nominal_thrust[match.acts_as]
        if match.sign > 0:
            place[match.acts_as] = k
    # A pair holds the motors that now stand where its motors stood, if both push as those did.
    pairs = [
        (given[place[one]].name, given[place[other]].name)
        for one, other in vehicle.pair_indices
        if one in place and other in place
    ]
    return _copy(vehicle, propellers=propellers, pairs=pairs, thrust_N=curves.tolist())


def _of_propellers(vehicle: Vehicle, matches: Mapping[int, EffectMatch]) -> dict[int, EffectMatch]:
    """Return the matches of the propellers' forward channels.

    A propeller that acts like a backward channel is that propeller, turned round.
    """
    count = len(vehicle.propellers)
    backwards = [k for k, one in enumerate(vehicle.propellers) if one.reverse is not None]

    def forwards(match: EffectMatch) -> EffectMatch:
        if match.acts_as is None or match.acts_as < count:
            return match
        return replace(match, acts_as=backwards[match.acts_as - count], sign=-match.sign)

    return {k: forwards(match) for k, match in matches.items() if k < count}


def measured(model: Model, effects: Float[np.ndarray, "3 n"], delay: float) -> Vehicle:
    """Return a vehicle with the thrusts, inertia, lag and delay that the pulses showed."""
    vehicle = model.vehicle
    stated = np.asarray(acceleration_map(np, model.dynamics, 0.0, 0.0)[0])
    tried = np.isfinite(effects).all(axis=0)
    push = np.sum(effects[:2] * stated[:2], axis=0) / np.sum(stated[:2] ** 2, axis=0)
    turns = tried & (np.abs(stated[2]) > 0.2 * np.abs(stated[2]).max())
    ratio = effects[2, turns] / stated[2, turns] / push[turns]
    inertia = 1 / float(np.clip(np.median(ratio), *_INERTIA)) if turns.any() else 1.0
    # Of a propeller that pushes both ways, the file states the thrust forwards.
    usual = float(np.median(push[tried]))
    # What is not clear yet keeps a little thrust: a curve must rise.
    strength = np.maximum(np.where(tried, push, usual), _LEAST * abs(usual))
    nominal, curves = vehicle.nominal, vehicle.nominal_thrust[: len(vehicle.propellers)]
    return _copy(
        vehicle,
        thrust_N=(strength[: len(curves), None] * curves).tolist(),
        inertia_kg_m2=inertia * nominal.inertia_kg_m2,
        motor_time_constant_s=float(np.max(model.dynamics.lag)),
        transport_delay_s=max(delay, 0.0),
    )


def _copy(vehicle: Vehicle, **changes: object) -> Vehicle:
    """Return a checked copy with other values, of the vehicle or its nominal values."""
    content = vehicle.model_dump(mode="json")
    for key, value in changes.items():
        place = content if key in content else content["nominal"]
        place[key] = (
            [one.model_dump(mode="json", exclude_none=True) for one in value]  # type: ignore
            if key == "propellers"
            else value
        )
    return Vehicle.model_validate(content)
