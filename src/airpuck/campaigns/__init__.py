"""Many independent flights, fits and games, on all cores or on a cluster.

Entry points: `campaign.campaign`, `match.match`, `items.recovery_errors`.
"""
