"""Gymnasium environments of air hockey: skills with a puck. The game for two is `gym_game`.

Importing this module registers them:
``gymnasium.make("airpuck_hockey.export.gym:airpuck/Hit-v0")``.
docs/export.md describes observations, rewards and termination.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np

from airpuck import InputError
from airpuck.extend import (
    ModelSource,
    Observation,
    PilotPolicy,
    Subject,
    TwinEnv,
    TwinSource,
    read_world,
    register,
    unknown,
    write_environments,
)
from airpuck_hockey.game.skills import (
    LONGEST,
    SKILLS,
    TACTICS,
    SkillName,
    ended,
    make_stage,
    opening,
    outcome,
)
from airpuck_hockey.player.player import Player

#: Environments by name; see `airpuck.export.gym.register`.
ENVIRONMENTS = {
    name.capitalize(): ("airpuck_hockey.export.gym:PuckEnv", None, {"skill": name})
    for name in SKILLS
}
#: Package that an export to this kind writes.
_PACKAGE = '''"""Air hockey with a craft, by this folder's name: "NAME:NAME/Hit-v0"."""

from pathlib import Path

from airpuck.export.gym import register

from airpuck_hockey.export.gym import ENVIRONMENTS
from airpuck_hockey.export.gym_game import GameEnv

HERE = Path(__file__).resolve().parent
CRAFT = {"model": str(HERE / "model.toml"), "twin": str(HERE / "twin.toml")}
register(HERE.name, ENVIRONMENTS, **CRAFT)


def game(**settings):
    """Return the game between two such craft, a PettingZoo parallel environment."""
    return GameEnv(**CRAFT, **settings)
'''


class PuckEnv(TwinEnv):
    """A skill of `airpuck skills`, with the same starts and ends; the reward is 1 for success.

    Parameters
    ----------
    skill : str
        ``defend``, ``hit`` or ``prepare``.
    model : Model or path-like, default "paper:M3"
        The craft.
    twin : TwinSettings or path-like, optional
        Table, puck, sensors, radio, effects; by default the paper's.
    render_mode : str, optional
        ``rgb_array``: `render` returns pictures.

    Raises
    ------
    InputError
        If the skill or the render mode is unknown, or the table has no room for it.
    """

    def __init__(
        self,
        skill: str,
        model: ModelSource = "paper:M3",
        twin: TwinSource = None,
        render_mode: str | None = None,
    ) -> None:
        if skill not in SKILLS:
            raise InputError(unknown(skill, list(SKILLS)), field="skill")
        self.skill: SkillName = cast(SkillName, skill)
        self._stage = make_stage(*read_world(model, twin))
        self._build(self._stage.model, self._stage.settings, ("pose", "puck"), render_mode)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; options are not used."""
        super().reset(seed=seed)
        puck, _, number = opening(self._stage, self.skill, self.np_random)
        self._twin = self._stage.twin(puck, number)
        self._seen.begin("pose", self._twin.state[None, :3])
        self._seen.begin("puck", *np.split(np.array([puck]), 2, axis=1))
        return self._observation(), {"is_success": False}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Send motor commands, and advance by a control period."""
        puck = self._fly(action).world.puck
        assert puck is not None
        over = ended(self._stage, self.skill, puck)
        late = bool(self._seen.time[0] >= LONGEST) and not over
        success = (over or late) and outcome(self._stage, self.skill, puck)[0]
        return self._observation(), float(success), over, late, {"is_success": success}

    def baseline(self) -> PilotPolicy:
        """Return a policy for one episode: the package's player, with the skill's tactic."""
        return PilotPolicy(Player(self.model, self.settings, TACTICS[self.skill]()))

    def _observation(self) -> Observation:
        return {name: values[0] for name, values in self._seen.observation().items()}


def write(subject: Subject, folder: Path) -> dict[str, Any]:
    """Write model, twin settings and a package that registers the environments of this craft."""
    return write_environments(subject, folder, _PACKAGE, ENVIRONMENTS)


register(environments=ENVIRONMENTS)
