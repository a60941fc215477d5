"""Seeds in the spelling of a command line: `7`, `1-40`, `1-40,50,60-70`."""

import re

MOST_SEEDS = 100_000
"""Robots of one rehearsal at most."""
LARGEST_SEED = 2**31 - 1

_SPAN = re.compile(r"(\d{1,10})(?:-(\d{1,10}))?")


def seeds_of(text: str) -> tuple[int, ...]:
    """Return the seeds that a text names, each once, in order.

    >>> seeds_of("7"), seeds_of("3-5,1")
    ((7,), (1, 3, 4, 5))

    Raises:
        ValueError: The text names none, one twice, or too many.
    """
    found: set[int] = set()
    for part in text.split(","):
        span = _SPAN.fullmatch(part.strip())
        if span is None or not part.isascii():
            raise ValueError(f"seeds {text}: expected a comma-separated list of seeds such as 7 or 1-40,50")
        first, last = int(span[1]), int(span[2] or span[1])
        if last < first:
            raise ValueError(f"seeds {text}: {part.strip()} ends before it begins")
        if last > LARGEST_SEED:
            raise ValueError(f"seeds {text}: the largest seed is {LARGEST_SEED}")
        if len(found) + last - first + 1 > MOST_SEEDS:
            raise ValueError(f"seeds {text}: expected at most {MOST_SEEDS} robots")
        named = range(first, last + 1)
        if twice := found.intersection(named):
            raise ValueError(f"seeds {text}: seed {min(twice)} is named twice")
        found.update(named)
    return tuple(sorted(found))
