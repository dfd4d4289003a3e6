"""Skills: episodes modelled on the Robot Air Hockey Challenge, on this table.

docs/hockey.md, "Skills", describes initial distributions, ends and criteria.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from airpuck import AirHockey, InputError, Model, PuckState, Twin, TwinSettings
from airpuck.extend import (
    Plant,
    PuckOnTable,
    Result,
    build_plant,
    control,
    default_twin_settings,
    numbers,
    wilson_interval,
)
from airpuck_hockey.game.contestant import tactic_maker
from airpuck_hockey.player.all_rounder import AllRounder
from airpuck_hockey.player.attack import Shoot
from airpuck_hockey.player.defence import Catch, Defend, Free, Wait
from airpuck_hockey.player.player import Player, pitch_of
from airpuck_hockey.player.tactic import Pitch, Tactic
from airpuck_hockey.puck.prediction import goal_within

#: Length and width of the Challenge's table, radii of its mallet and its puck [m].
_LENGTH, _WIDTH = 1.948, 1.038
# Starts and zones of the Challenge, in metres of its table.
#: Starts of shots at the goal: lowest and highest x, highest |y|.
_SHOT_FROM, _SHOT_TO, _SHOT_ASIDE = 0.29, 0.65, 0.4
#: Their lowest and highest speed [m/s], largest angle [rad] and spin [rad/s].
_SHOT_SPEEDS, _SHOT_ANGLE, _SHOT_SPIN = (1.0, 3.0), 0.5, 10.0
#: Starts of pucks to hit: lowest and highest x; their highest speed [m/s] and spin [rad/s], and
#: by how much their direction may point away from the craft [rad].
_HIT_FROM, _HIT_TO, _HIT_SPEED, _HIT_SPIN, _HIT_AWAY = -0.7, -0.2, 0.5, 2.0, 0.1
#: Lowest and highest x of the zone that a puck can be shot from, and lowest x beside the goal.
_ZONE_FROM, _ZONE_TO, _BESIDE_GOAL = -0.8, -0.2, -0.94
#: Clearance of a start from rails, and from the craft [m].
_FROM_RAIL, _FROM_CRAFT = 0.002, 0.01
#: Just beyond the next bounce [s]: a puck on the rail would meet the rail again.
_BEYOND = 1e-8
#: Seeds lie below this.
SEEDS = 2**31
#: Time limit of an episode [s].
LONGEST = 10.0
#: A puck slower than this is under control [m/s].
_STOPPED = 0.1
#: A puck further into the other half that moves away is out of the craft's reach [m].
_GONE = 0.05
#: Largest number of draws to find a start.
_DRAWS = 2000

SkillName = Literal["defend", "hit", "prepare"]
SKILLS: tuple[SkillName, ...] = ("defend", "hit", "prepare")


@dataclass(frozen=True)
class Skill(Result):
    """Episodes of one skill, and their success rate.

    Attributes
    ----------
    successes, episodes : int
        How many.
    stopped : int
        Number that ended with a puck under control on the craft's own half.
    """

    JSON = "successes episodes stopped interval_95"

    successes: int
    episodes: int
    stopped: int

    @property
    def interval_95(self) -> tuple[float, float]:
        """Wilson's interval of the probability of success."""
        return wilson_interval(self.successes, self.episodes)


def skills(
    model: Model,
    *,
    settings: TwinSettings | None = None,
    episodes: int = 100,
    seed: int = 0,
    names: tuple[SkillName, ...] = SKILLS,
    tactic: str | None = None,
    progress: Callable[[SkillName, int, int], None] | None = None,
) -> Mapping[SkillName, Skill]:
    """Measure how well a craft defends, hits and prepares, on the twin.

    Parameters
    ----------
    model : Model
        The craft, and the truth of the twin.
    settings : TwinSettings, optional
        Table, puck, radio, noise; by default the paper's.
    episodes : int, default 100
        Number of episodes per skill.
    seed : int, default 0
        Seed of all random numbers; episode k is the same in two runs with one seed.
    names : tuple of str, optional
        Skills to measure; by default all.
    tactic : str, optional
        The craft's tactic for all skills, FILE.py:NAME; by default the package's own strategies.
    progress : callable, optional
        Called with name, episodes done and successes after each episode.

    Returns
    -------
    mapping of str to Skill
        The skills by name.

    Raises
    ------
    InputError
        If the table has no room for the craft beside the puck, or for the initial positions, or the
        tactic cannot be made.

    Examples
    --------
    >>> found = airpuck_hockey.skills(model, episodes=1, names=("defend",))
    >>> found["defend"].episodes
    1
    """
    numbers.EPISODES.check(episodes, "episodes")
    stage = make_stage(model, settings, None if tactic is None else tactic_maker(tactic))
    found = {}
    for name in names:
        ends = []
        for k in range(episodes):
            ends.append(episode(stage, name, [seed, k]))
            if progress is not None:
                progress(name, k + 1, sum(success for success, _ in ends))
        successes, stopped = (sum(part) for part in zip(*ends, strict=True))
        found[name] = Skill(successes, episodes, stopped)
    return found


@dataclass(frozen=True, eq=False)
class Stage:
    """Shared data of all episodes."""

    model: Model
    settings: TwinSettings
    plant: Plant
    pitch: Pitch
    #: Makes the user's tactic; None if the package's own strategies play.
    tactic: Callable[[], Tactic] | None = None

    def twin(self, puck: PuckState, seed: int) -> Twin:
        """Return a twin with a puck and the craft at its home position."""
        return Twin(
            self.model,
            self.settings,
            seed=seed,
            pose=(*self.pitch.home, 0.0),
            plant=self.plant,
            puck=puck,
            logs=False,
        )


def make_stage(
    model: Model, settings: TwinSettings | None = None, tactic: Callable[[], Tactic] | None = None
) -> Stage:
    """Return a craft on its table; raise InputError if the table is too small for the skills."""
    settings = settings or default_twin_settings()
    settings = settings.with_usual_delay(model.radio_delay).without_on_board()
    stage = Stage(model, settings, build_plant(model, settings), pitch_of(model, settings), tactic)
    reach, _ = settings.table.reach(stage.pitch.craft_radius)
    if _beside_rail(stage) <= 0 or -stage.pitch.home[0] > reach:
        size = f"{settings.table.length_m:g} × {settings.table.width_m:g} m"
        raise _no_room(f"for the craft beside the puck in its half; it is {size}")
    return stage


def opening(stage: Stage, name: SkillName, rng: np.random.Generator) -> tuple[PuckState, int, int]:
    """Draw an episode: start of the puck, seeds of player and twin."""
    draw, suits, what = _STARTS[name]
    for _ in range(_DRAWS):
        puck = draw(stage, rng)
        if suits(stage, puck):
            return puck, int(rng.integers(SEEDS)), int(rng.integers(SEEDS))
    raise _no_room(f"for {what}")


def episode(stage: Stage, name: SkillName, seed: list[int]) -> tuple[bool, bool]:
    """Play one episode; return whether it succeeded, and whether it ended with a stopped puck."""
    puck, players, twins = opening(stage, name, np.random.default_rng(seed))
    player = Player(stage.model, stage.settings, (stage.tactic or TACTICS[name])(), seed=players)
    twin = stage.twin(puck, twins)
    body = twin.world.puck
    assert body is not None
    for _ in control(player, twin, LONGEST):
        if ended(stage, name, body):
            break
    return outcome(stage, name, body)


def ended(stage: Stage, name: SkillName, body: PuckOnTable) -> bool:
    """Return whether an episode is over before its time limit."""
    state = body.state
    if body.goal or (state.x > _GONE and state.vx > 0):
        return True
    if name == "hit" or math.hypot(state.vx, state.vy) >= _STOPPED:
        return False
    return state.x < 0 if name == "defend" else _in_zone(stage, state)


def outcome(stage: Stage, name: SkillName, body: PuckOnTable) -> tuple[bool, bool]:
    """Return whether an episode that ends now succeeded, and whether the puck is stopped."""
    state = body.state
    slow = not body.goal and math.hypot(state.vx, state.vy) < _STOPPED and state.x < 0
    if name == "defend":
        return body.goal >= 0, slow
    if name == "prepare":
        return slow and _in_zone(stage, state), slow
    return _scores(stage.settings, body), slow


def _scores(equipment: AirHockey, body: PuckOnTable) -> bool:
    """Return whether the untouched puck scores before it comes back."""
    if body.goal:
        return body.goal > 0
    alone = PuckOnTable(equipment, body.state, logs=False)
    while not alone.goal and alone.state.vx > 0 and alone.time < LONGEST:
        alone.run(min(alone.next_meeting + _BEYOND, LONGEST))
    return alone.goal > 0


def _scaled(stage: Stage) -> tuple[float, float]:
    """Return the ratios of this table's length and width to the Challenge's."""
    table = stage.settings.table
    return table.length_m / _LENGTH, table.width_m / _WIDTH


def _beside_rail(stage: Stage) -> float:
    """Return the distance from the axis beyond which the craft has no room behind a puck."""
    table, puck = stage.settings.table, stage.settings.puck
    return table.width_m / 2 - puck.radius_m - 2 * stage.pitch.craft_radius


def _in_zone(stage: Stage, state: PuckState) -> bool:
    """Return whether a puck can be shot from its position."""
    along, _ = _scaled(stage)
    return _ZONE_FROM * along < state.x <= _ZONE_TO * along and abs(state.y) < _beside_rail(stage)


def _defend(stage: Stage, rng: np.random.Generator) -> PuckState:
    """Draw a shot towards the craft's half."""
    along, across = _scaled(stage)
    aside = _SHOT_ASIDE * across
    x, y = rng.uniform([_SHOT_FROM * along, -aside], [_SHOT_TO * along, aside])
    speed, angle = rng.uniform(*_SHOT_SPEEDS), rng.uniform(-_SHOT_ANGLE, _SHOT_ANGLE)
    spin = rng.uniform(-_SHOT_SPIN, _SHOT_SPIN)
    return PuckState(x, y, 0.0, -speed * math.cos(angle), speed * math.sin(angle), spin)


def _enters(stage: Stage, start: PuckState) -> bool:
    """Return whether an untouched puck enters the craft's goal, directly or over rails."""
    return goal_within(stage.settings, start, LONGEST) < 0


def _hit(stage: Stage, rng: np.random.Generator) -> PuckState:
    """Draw a resting or slow puck in the craft's half."""
    along, _ = _scaled(stage)
    width, turned = _beside_rail(stage), math.pi / 2 + _HIT_AWAY
    x, y = rng.uniform([_HIT_FROM * along, -width], [_HIT_TO * along, width])
    speed = rng.uniform(0.0, _HIT_SPEED)
    angle, spin = rng.uniform(-turned, turned), rng.uniform(-_HIT_SPIN, _HIT_SPIN)
    return PuckState(x, y, 0.0, -speed * math.cos(angle), speed * math.sin(angle), spin)


def _prepare(stage: Stage, rng: np.random.Generator) -> PuckState:
    """Draw a puck at rest near a rail, where it cannot be shot."""
    along, _ = _scaled(stage)
    table, puck = stage.settings.table, stage.settings.puck
    outer, inner = table.width_m / 2 - puck.radius_m - _FROM_RAIL, _beside_rail(stage)
    side = np.array([[_ZONE_FROM * along, _ZONE_TO * along], [inner, outer]])
    bottom = np.array([[_BESIDE_GOAL * along, _ZONE_FROM * along], [table.goal_width_m / 2, outer]])
    # There is no end rail beside a goal as wide as the table.
    areas = [float(np.prod(np.maximum(area[:, 1] - area[:, 0], 0.0))) for area in (side, bottom)]
    area = side if rng.random() < areas[0] / sum(areas) else bottom
    x, y = rng.uniform(area[:, 0], area[:, 1])
    return PuckState(x, y * rng.choice([-1.0, 1.0]))


def _no_room(what: str) -> InputError:
    """Return the InputError for a table without room."""
    return InputError(f"has no room {what}", field="table")


def _free(stage: Stage, start: PuckState) -> bool:
    """Return whether a puck does not overlap the craft at home."""
    x, y = stage.pitch.home
    return math.hypot(start.x - x, start.y - y) > stage.pitch.contact_distance + _FROM_CRAFT


#: How starts are drawn, which of them suit, and what they are.
_STARTS = {
    "defend": (_defend, _enters, "a shot at the goal"),
    "hit": (_hit, _free, "a puck in front of the craft"),
    "prepare": (_prepare, _free, "a puck near a rail"),
}
#: In two of the skills the task is to stop the puck, so their tactics do not shoot.
TACTICS: Mapping[SkillName, Callable[[], Tactic]] = {
    "defend": lambda: AllRounder((Defend(), Catch(), Wait())),
    "hit": lambda: AllRounder((Shoot(least=0.05), Defend(), Catch(), Free(), Wait())),
    "prepare": lambda: AllRounder((Defend(), Catch(), Free(), Wait())),
}
