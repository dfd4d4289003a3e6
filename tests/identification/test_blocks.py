"""Blocks of time: how windows are grouped, and what their borders miss."""

import numpy as np
import pytest

from airpuck.data.windows import make_windows
from airpuck.identification.blocks import cluster_windows, shared_at_borders

from .test_uncertainty import noisy


def test_what_blocks_share_is_what_a_moving_average_loses():
    """Scores that sum up the L samples of their window, white noise: the variance by hand."""
    windows = make_windows(noisy(duration=40.0), 40, 50, 7)
    clusters = cluster_windows(windows)
    sample = np.zeros((len(windows), int(windows.starts.max()) + 90))
    for row, start in zip(sample, windows.starts, strict=True):
        row[start : start + 90] = 1
    blocks = np.array([sample[clusters == c].sum(axis=0) for c in range(clusters.max() + 1)])
    missed = 1 - np.sum(blocks**2) / np.sum(blocks.sum(axis=0) ** 2)
    assert shared_at_borders(windows, clusters) == pytest.approx(missed, rel=0.1)
    assert shared_at_borders(windows, np.zeros(len(windows), dtype=int)) == 0
    # The ends of recordings are no borders.
    two = make_windows([noisy(1, 7.0), noisy(2, 7.0)], 40, 50, 7)
    by_trajectory = np.searchsorted(two.origins, two.starts, side="right")
    by_trajectory -= by_trajectory.min()
    assert shared_at_borders(two, by_trajectory) == 0


def test_clusters_are_blocks_of_time():
    flights = [noisy(seed, duration=7.0) for seed in (1, 2)]
    windows = make_windows(flights, 40, 50, 7)
    clusters = cluster_windows(windows)
    second = windows.starts >= len(flights[0])
    assert not set(clusters[second]) & set(clusters[~second])
    assert (np.diff(clusters) >= 0).all()
    seconds = np.bincount(clusters) * 7 / 240
    assert 1.2 < seconds.min() <= seconds.max() < 2.1
