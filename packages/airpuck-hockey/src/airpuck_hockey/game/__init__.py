"""Games: rules, hands with human limits, contestants, score, skills.

Entry points: `game.Game`, `contestant.contestant`, `skills.skills`.
"""
