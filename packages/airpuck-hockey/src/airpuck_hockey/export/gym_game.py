"""The game of two craft as a PettingZoo parallel environment."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from airpuck import InputError, Measurement, Pilot, Step
from airpuck.extend import (
    BLUE,
    RED,
    DrawnDisc,
    MeasurementKind,
    ModelSource,
    Observation,
    PilotPolicy,
    Seen,
    TwinSource,
    action_space,
    check_render_mode,
    checked_action,
    drawn_puck,
    observation_space,
    picture,
    read_world,
)
from airpuck_hockey.game.contestant import Contestant
from airpuck_hockey.game.game import Game
from airpuck_hockey.game.rules import Rules
from airpuck_hockey.game.skills import SEEDS
from airpuck_hockey.player.player import Player

try:
    from gymnasium.utils.seeding import np_random
    from pettingzoo import ParallelEnv
except ImportError:
    raise InputError("the game for two needs PettingZoo: pip install pettingzoo") from None

_BODIES: tuple[MeasurementKind, ...] = ("pose", "puck", "mallet")
#: Signs of the sides, by agent.
_SIDES = {"left": -1, "right": 1}


class _Agent(Pilot):
    """A pilot whose commands come from outside."""

    watches = ("puck", "mallet")

    def __init__(self, n_motors: int) -> None:
        self.command = np.zeros(n_motors)

    def step(self, time: float) -> Step:
        """Return the command that was set."""
        return Step(self.command)


class GameEnv(ParallelEnv[str, Observation, np.ndarray]):
    """Air hockey between two craft, ``left`` and ``right``, by the package's rules.

    Each side observes the table in its own frame, with its own goal at negative x; ``mallet`` is
    the opponent's disc. A goal gives 1 to its scorer and -1 to the other. A decided game
    terminates; a game that reaches its time limit is truncated.

    Parameters
    ----------
    model : Model or path-like, default "paper:M3"
        Both craft.
    twin : TwinSettings or path-like, optional
        Table, puck, sensors, radio, effects; by default the paper's.
    goals : int, default 1
        Goals needed to win.
    limit_s : float, default 30
        Time limit [s].
    render_mode : str, optional
        ``rgb_array``: `render` returns pictures.

    Attributes
    ----------
    game : Game
        The current game: score, events, true states.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "airpuck_game_v0", "render_modes": ["rgb_array"]}  # pyright: ignore

    def __init__(
        self,
        model: ModelSource = "paper:M3",
        twin: TwinSource = None,
        goals: int = 1,
        limit_s: float = 30.0,
        render_mode: str | None = None,
    ) -> None:
        check_render_mode(render_mode, self.metadata)
        self.model, self.settings = read_world(model, twin)
        self._rules = Rules(goals=goals, limit_s=limit_s)
        self.possible_agents, self.agents = list(_SIDES), []
        self.render_mode = render_mode
        self.action_spaces = {name: action_space(self.model) for name in _SIDES}
        self.observation_spaces: dict[str, Any] = {
            name: observation_space(self.model, self.settings, _BODIES) for name in _SIDES
        }
        self._random = np_random()[0]

    def observation_space(self, agent: str) -> Any:
        """Return the space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:
        """Return the space of an agent's motor commands."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Begin a game; options are not used."""
        if seed is not None:
            self._random = np_random(seed)[0]
        n = self.model.vehicle.n_propellers
        self._pilots = {name: _Agent(n) for name in _SIDES}
        players = [
            Contestant(name, player=lambda *_, pilot=pilot: pilot)
            for name, pilot in self._pilots.items()
        ]
        self.game = Game(
            *players,
            settings=self.settings,
            rules=self._rules,
            model=self.model,
            seed=int(self._random.integers(SEEDS)),
            logs=False,
        )
        self.agents, self._seen = list(_SIDES), {}
        places = [np.array(side.state[:3]) for side in self.game.sides]
        puck = np.array(self.game.puck)[:3]
        for (name, space), own, other in zip(
            self.observation_spaces.items(), places, places[::-1], strict=True
        ):
            offset = self.settings.motion_capture.clock_offset_s
            seen = self._seen[name] = Seen(1, space, _BODIES, offset)
            for body, pose in zip(_BODIES, (own, puck, other), strict=True):
                seen.begin(body, self._frame(name).states(pose)[None])
        return self._observations(), {name: {} for name in _SIDES}

    def step(self, actions: dict[str, Any]) -> tuple[Any, Any, Any, Any, Any]:
        """Send both sides' motor commands, and advance by a control period."""
        playing = self.agents
        if not playing:
            return {}, {}, {}, {}, {}
        commands = {}
        for name in playing:
            if name not in actions:
                raise InputError("has no action", field=name)
            commands[name] = checked_action(actions[name], self._pilots[name].command.shape)
        for name, command in commands.items():
            self._pilots[name].command = command
            self._seen[name].command(command[None])
        before, game = self.game.score, self.game
        game.step()
        for name, side in zip(playing, game.sides, strict=True):
            assert side.twin is not None
            frame = self._frame(name)
            arrived = (m for m in side.twin.wait_until(game.time) if m.kind in _BODIES)
            seen = [Measurement(m.kind, m.stamp, frame.states(m.values)) for m in arrived]
            self._seen[name].measured(seen)
        left, right = (now - then for now, then in zip(game.score, before, strict=True))
        over, won = game.phase == "over", max(game.score) >= (self._rules.goals or 0)
        self.agents = [] if over else playing
        rewards = {"left": float(left - right), "right": float(right - left)}
        infos = {name: {"score": game.score[::-side]} for name, side in _SIDES.items()}
        terminated = dict.fromkeys(playing, over and won)
        truncated = dict.fromkeys(playing, over and not won)
        return self._observations(), rewards, terminated, truncated, infos

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return a picture of the true poses; see `TwinEnv.render`."""
        if self.render_mode is None:
            return None
        radius = self.model.vehicle.radius_m
        craft = [
            DrawnDisc(side.state[:3], radius, color)
            for side, color in zip(self.game.sides, (BLUE, RED), strict=True)
        ]
        return picture(self.settings.table, [*drawn_puck(self.game.puck, self.settings), *craft])

    def baseline(self) -> PilotPolicy:
        """Return a policy for one game: the package's player, for either side."""
        radius = self.model.vehicle.radius_m
        return PilotPolicy(Player(self.model, self.settings, opponent_radius=radius))

    def _frame(self, name: str) -> Any:
        return self.game.sides[_SIDES[name] > 0].frame

    def _observations(self) -> dict[str, Observation]:
        return {
            name: {key: values[0] for key, values in seen.observation().items()}
            for name, seen in self._seen.items()
        }
