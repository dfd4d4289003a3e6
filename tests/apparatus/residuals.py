"""Correlated errors of known variance."""

import numpy as np
from scipy.signal import lfilter

#: Time between starts [s], and correlation time of the errors: as long as they overlap [s].
SPACING, CORRELATED = 1 / 60, 0.1


def residuals(seed: int, duration: float, channels: int) -> tuple[np.ndarray, np.ndarray]:
    """Make autoregressive errors of variance 1, and their start times."""
    rng, size = np.random.default_rng(seed), round(duration / SPACING)
    keep = np.exp(-SPACING / CORRELATED)
    noise = rng.normal(size=(channels, size + 200))
    errors = lfilter([np.sqrt(1 - keep**2)], [1, -keep], noise)[:, 200:]
    return errors, SPACING * np.arange(size)
