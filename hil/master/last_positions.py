"""Last known positions of the axes of this process, for the line on an interrupt."""

from typing import ClassVar, Final

from hil.errors import NOT_DISABLED

AT_REST: Final = "the axes are at rest, and their drives are disabled"
"""The words for the end of a motion that is followed by an error of the master alone."""


class LastPositions:
    """Positions of the axes as the master has last seen them at rest.

    Attributes:
        words: Each axis with its position, in words; empty before the first session.
        have_moved: True if a motion was begun.
        are_disabled: True if every drive has confirmed that it is disabled.
    """

    words: ClassVar[tuple[str, ...]] = ()
    have_moved: ClassVar[bool] = False
    are_disabled: ClassVar[bool] = True

    @classmethod
    def note(cls, words: tuple[str, ...], *, have_moved: bool, are_disabled: bool = True) -> None:
        """Note positions, and whether a motion has led to them."""
        cls.words, cls.have_moved, cls.are_disabled = words, have_moved, are_disabled

    @classmethod
    def rest(cls) -> str:
        """Return the state of the axes, for an error of the master alone, such as a full disk."""
        if not cls.are_disabled:
            return NOT_DISABLED
        return "; ".join((AT_REST if cls.have_moved else "nothing has moved", *cls.words))

    @classmethod
    def when(cls) -> str:
        """Return the place of an interrupt that comes now.

        No motion lasts: a session takes the signals itself, and ends its motion by a ramp.
        """
        state = () if cls.are_disabled else (NOT_DISABLED,)
        return "; ".join(("after the last motion" if cls.have_moved else "before anything moved", *state, *cls.words))
