"""Levels of play: handicaps in thrust, reaction and aim."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from airpuck import Model
from airpuck.extend import MinimalTimes, numbers, thrust

#: Number of commands at which the thrust is computed.
_COMMANDS = 500
_SHARE = numbers.Range(0.05, 1.0, "the craft must move", "of the full thrust")
_REACTION = numbers.Range(0.0, 1.0, "with a longer one nothing is seen in time", "s")
_NOISE = numbers.Range(0.0, 1.0, "no shot would go forward", "rad")


@dataclass(frozen=True)
class Level:
    """A handicap.

    Attributes
    ----------
    thrust : float
        Fraction of the craft's thrust that is used.
    reaction_s : float
        Delay with which puck and opponent are seen.
    shot_noise_rad : float
        Standard deviation of the direction of shots.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> easy = airpuck_hockey.Level(thrust=0.6, reaction_s=0.15)
    >>> easy.thrust
    0.6
    """

    thrust: float = 1.0
    reaction_s: float = 0.0
    shot_noise_rad: float = 0.0

    def __post_init__(self) -> None:
        _SHARE.check(self.thrust, "thrust")
        _REACTION.check(self.reaction_s, "reaction_s")
        _NOISE.check(self.shot_noise_rad, "shot_noise_rad")


#: By name.
LEVELS = {
    "easy": Level(thrust=0.45, reaction_s=0.15, shot_noise_rad=0.15),
    "medium": Level(thrust=0.55, reaction_s=0.12, shot_noise_rad=0.1),
    "hard": Level(),
}


def weakened(model: Model, share: float) -> Model:
    """Return a craft whose largest command gives a share of the full thrust."""
    if share >= 1.0:
        return model
    vehicle = model.vehicle
    commands = np.linspace(vehicle.command_min, vehicle.command_max, _COMMANDS)
    given = np.array(
        [np.sum(thrust(model.dynamics.thrust, np.full(vehicle.n_propellers, c))) for c in commands]
    )
    most = float(commands[np.searchsorted(given, share * given[-1])])
    return replace(model, vehicle=vehicle.model_copy(update={"command_max": most}))


def slower(times: MinimalTimes, share: float) -> MinimalTimes:
    """Return the shortest times of a craft that accelerates with a fraction of the thrust.

    With the acceleration a, the distance d from the speed v takes
    T(d, v, a) = T(d, v / √s, a / s) / √s.
    """
    root = share**0.5
    return replace(times, speed=times.speed * root, time=times.time / root)
