"""Counts in words: `1 frame`, `2 frames`, `once`, `3 times`."""


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
