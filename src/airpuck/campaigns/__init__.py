"""Many independent flights and fits, on all cores or on a cluster.

Entry points: `campaign.campaign`.
"""
