"""Situations in a game as a tactic sees them, and their true outcomes."""

import math
from dataclasses import replace

import numpy as np

from airpuck.craft.table import AirHockey
from airpuck.model.model_file import read_model
from airpuck.physics.puck import Disc, PuckState, strike
from airpuck.physics.puck_on_table import PuckOnTable
from airpuck.planning.minimal_time import read_minimal_times
from airpuck_hockey.player.all_rounder import Turns
from airpuck_hockey.player.interception import Outlook, Searcher
from airpuck_hockey.player.player import pitch_of
from airpuck_hockey.player.tactic import Intention, View
from airpuck_hockey.puck.prediction import PuckBelief, PuckModel

MODEL, PLAY = read_model("paper:M3"), AirHockey()
PITCH, TIMES, PUCK = pitch_of(MODEL, PLAY), read_minimal_times(), PuckModel(PLAY)
#: Covariance of the filter for a puck that it has seen for a while.
SEEN = np.diag([3e-5, 3e-5, 1e-3, 3e-3, 3e-3, 0.1]) ** 2
#: Signs of x, y, yaw and their rates in a mirror along the table.
MIRROR = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])


def view_of(puck, craft=None, time=0.0, opponent=None):
    """A puck, by default with the craft at home."""
    craft = np.array([*PITCH.home, 0, 0, 0, 0] if craft is None else craft, dtype=float)
    belief = PuckBelief(time, np.array(puck, dtype=float), SEEN)
    return View(time, craft, belief, PUCK, opponent, PITCH, TIMES)


def mirrored(view):
    """The same situation in a mirror along the table."""
    belief = replace(view.puck, mean=view.puck.mean * MIRROR)
    other = None if view.opponent is None else view.opponent * [1.0, -1.0, 1.0, -1.0]
    return replace(view, craft=view.craft * MIRROR, puck=belief, opponent=other)


def later(view, duration, craft=None):
    """The same situation after the puck has coasted."""
    puck = PuckOnTable(PLAY, PuckState(*view.puck.mean.tolist()), view.time, logs=False)
    puck.run(view.time + duration)
    return view_of(puck.state, view.craft if craft is None else craft, puck.time, view.opponent)


def decided(strategy, view, periods=4):
    """Ask a strategy for some periods while nothing moves; return its last proposal."""
    found, turns = None, Turns()
    for k in range(periods):
        found = asked(strategy, replace(view, time=view.time + 0.01 * k), turns)
    return found


def asked(strategy, view, turns):
    """Ask a strategy once, giving it every turn to search."""
    outlook = Outlook(view)
    found = strategy.propose(view, outlook)
    if isinstance(strategy, Searcher) and turns.give(view, outlook, [strategy]):
        found = strategy.propose(view, outlook)
    return found


def assert_mirrored(one: Intention | None, other: Intention | None, atol=1e-9):
    """Check that two intentions are mirror images."""
    assert (one is None) == (other is None)
    if one is None or other is None:
        return
    assert one.kind == other.kind
    for now in (0.0, 0.3):
        a, b = one.reference.at(now, 0.0).state, other.reference.at(now, 0.0).state
        np.testing.assert_allclose(a * MIRROR, b, atol=atol)
    for a, b, signs in (
        (one.meet, other.meet, [1, 1, -1]),
        (one.avoid, other.avoid, [1, -1, 1]),
        (one.path, other.path, [1, -1]),
    ):
        assert (a is None) == (b is None)
        if a is not None:
            np.testing.assert_allclose(np.array(a) * signs, np.array(b), atol=atol)


def contact(view, intention):
    """The planned contact: time, middle of the craft, its velocity, and the puck before."""
    reference, (time, *_) = intention.reference, intention.meet
    velocity = reference.state[3:5]
    place = reference.state[:2] - (reference.time - time) * velocity
    puck = PuckOnTable(PLAY, PuckState(*view.puck.mean.tolist()), view.puck.time)
    puck.run(time)
    return time, place, velocity, puck.state


def after_contact(view, intention):
    """The puck after a planned contact, by the law of single discs; and how the craft moves on."""
    time, place, velocity, puck = contact(view, intention)
    x, y = (np.array(puck[:2]) - place).tolist()
    apart = math.hypot(x, y)
    laws = PLAY.puck
    body = Disc(0, 0, puck.vx, puck.vy, puck.spin, laws.radius_m, laws.mass_kg, laws.inertia)
    craft = Disc(
        0, 0, *velocity.tolist(), 0.0, PITCH.craft_radius, PITCH.craft_mass, PITCH.craft_inertia
    )
    if ((puck.vx - craft.vx) * x + (puck.vy - craft.vy) * y) < 0:
        strike(body, craft, x / apart, y / apart, laws.craft)
    state = puck._replace(vx=body.vx, vy=body.vy, spin=body.spin)
    return PuckOnTable(PLAY, state, time), np.array([craft.vx, craft.vy])
