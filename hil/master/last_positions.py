"""Last known positions of the axes of this process, for the line on an interrupt."""

from typing import ClassVar


class LastPositions:
    """Positions of the axes as the master has last seen them at rest.

    Attributes:
        words: Each axis with its position, in words; empty before the first session.
        have_moved: True if a motion was begun.
    """

    words: ClassVar[tuple[str, ...]] = ()
    have_moved: ClassVar[bool] = False

    @classmethod
    def note(cls, words: tuple[str, ...], *, have_moved: bool) -> None:
        """Note positions, and whether a motion has led to them."""
        cls.words, cls.have_moved = words, have_moved

    @classmethod
    def when(cls) -> str:
        """Return the place of an interrupt that comes now.

        No motion lasts: a session takes the signals itself, and ends its motion by a ramp.
        """
        return "; ".join(("after the last motion" if cls.have_moved else "before anything moved", *cls.words))
