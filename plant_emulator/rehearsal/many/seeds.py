"""Seeds in the spelling of a command line: `7`, `1-40`, `1-40,50,60-70`."""

from drive_profiles.standard.shown import numbers_of

MOST_SEEDS = 100_000
"""Robots of one rehearsal at most."""
LARGEST_SEED = 2**31 - 1


def seeds_of(text: str) -> tuple[int, ...]:
    """Return the seeds that a text names, each once, in order.

    >>> seeds_of("7"), seeds_of("3-5,1")
    ((7,), (1, 3, 4, 5))

    Raises:
        ValueError: The text names none, one twice, or too many.
    """
    return tuple(sorted(numbers_of(text, "seed", 0, LARGEST_SEED, MOST_SEEDS)))
