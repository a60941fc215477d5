"""Counts in words: `1 frame`, `2 frames`, `once`, `3 times`; lists of axes."""

from collections.abc import Sequence


def counted(number: int, one: str, many: str | None = None) -> str:
    """Return a number with its noun.

    >>> counted(1, "frame"), counted(3, "frame"), counted(2, "emergency", "emergencies")
    ('1 frame', '3 frames', '2 emergencies')
    """
    return f"{number} {one if number == 1 else many or one + 's'}"


def times(number: int) -> str:
    """Return how often something happens.

    >>> times(1), times(2), times(7)
    ('once', 'twice', '7 times')
    """
    return {1: "once", 2: "twice"}.get(number, f"{number} times")


def axes_in_words(numbers: Sequence[int]) -> str:
    """Return the axes of one number or more.

    >>> axes_in_words([2]), axes_in_words([2, 3, 5])
    ('axis 2', 'axes 2, 3 and 5')
    """
    *first, last = map(str, numbers)
    return f"axes {', '.join(first)} and {last}" if first else f"axis {last}"
