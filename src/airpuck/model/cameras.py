"""What recordings taught about the cameras: a table of the model file, for tuning controllers."""

from __future__ import annotations

from airpuck.boundary.files import NonNegative, Positive, Section


class Cameras(Section):
    """Rate, noise and time stamps of the poses that a model was learned from."""

    #: Poses per second, on average between gaps.
    rate_hz: Positive
    #: Standard deviations of the white noise of a pose.
    position_noise_m: NonNegative
    yaw_noise_rad: NonNegative
    #: Standard deviation of the stamps' errors, which show as noise in proportion to speed.
    stamp_jitter_s: NonNegative = 0.0
