# The public names and their modules; `airpuck_hockey` imports each of them at its first use.
# isort: off
from airpuck_hockey.game.contestant import contestant as contestant
from airpuck_hockey.game.game import Game as Game
from airpuck_hockey.game.rules import Rules as Rules
from airpuck_hockey.game.skills import skills as skills
from airpuck_hockey.matches.match import league as league
from airpuck_hockey.matches.match import match as match
from airpuck_hockey.player.all_rounder import AllRounder as AllRounder
from airpuck_hockey.player.attack import Shoot as Shoot
from airpuck_hockey.player.player import Level as Level
from airpuck_hockey.player.player import Player as Player
from airpuck_hockey.player.tactic import Intention as Intention, Tactic as Tactic, View as View
from airpuck_hockey.puck.identification import identify_puck as identify_puck
from airpuck_hockey.puck.puck_filter import PuckFilter as PuckFilter
