"""How many random examples a test tries."""

from hypothesis import settings


def examples(count: int) -> settings:
    """Try as many in all tests, a tenth in the quick ones."""
    # The profile says which: 100 examples, or 10.
    return settings(max_examples=max(5, count * settings.default.max_examples // 100))
