"""Number of random examples that a test tries."""

from hypothesis import settings


def examples(count: int) -> settings:
    """Set the number of examples for all tests; quick runs try a tenth of it."""
    # The profile determines which: 100 examples or 10.
    return settings(max_examples=max(5, count * settings.default.max_examples // 100))
