"""Which contact is chosen for a shot."""

import numpy as np

from airpuck.hockey import attack
from airpuck.hockey.attack import Shoot, _Found
from airpuck.hockey.interception import Outlook
from airpuck.hockey.player import Player

from .test_player import MODEL, PLAY, Noted, moving, stepped


def test_a_later_contact_is_taken_where_the_sooner_one_is_too_unlikely(monkeypatch):
    noted = Noted()
    stepped(Player(MODEL, PLAY, noted), moving, 5)
    view = noted.views[-1]
    chance = np.repeat([0.24, 0.27], 3)
    # The sooner one is worth more, as patience costs: 0.24 exp(-0.036) > 0.27 exp(-0.18).
    found = _Found(view.time + np.array([0.3, 1.5]), np.zeros(2), np.ones(2))
    monkeypatch.setattr(attack, "chances", lambda *_: (chance, np.zeros(6)))
    monkeypatch.setattr(attack, "way_is_free", lambda *_: True)
    shot, _ = Shoot(least=0.25)._closely(view, Outlook(view), found)
    assert shot is not None
    assert shot.chance == 0.27
    assert shot.meeting.time == view.time + 1.5
