"""Many games: matches and leagues, as items of campaigns.

Entry points: `match.match`, `match.league`.
"""
