"""Positions of axes after a refusal or stop, in words."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

from hil.errors import NOT_DISABLED

if TYPE_CHECKING:  # every command loads this module, and a bench loads scipy
    from hil.bench.bench import Limits

AWAY_REV: Final = 0.01
"""Last digit of a motor position in words, in which commands take it: nearer than that no command brings an axis."""


def rev_text(rev: float) -> str:
    """A motor position as text, valid for a command as well.

    >>> rev_text(10.987), rev_text(7.0), rev_text(-0.001)
    ('10.99', '7', '0')
    """
    return f"{round(rev, 2) + 0.0:.2f}".rstrip("0").rstrip(".")


def move_command(axis: int, to_rev: float) -> str:
    """The command that brings an axis to a position."""
    return f"hil move --axis {axis} --to {rev_text(to_rev)}"


def way_out(axis: int, stands_rev: float, limits: "Limits", low_rev: float, high_rev: float) -> str:
    """Return an axis' position, and the command to a better one."""
    lowest, highest = limits.position_min_rev - low_rev, limits.position_max_rev - high_rev
    here = f"it is at {rev_text(stands_rev)} rev"
    if lowest > highest:
        return f"{here}, and the motion is longer than the range of {name_range(limits)}"
    # to the hundredth of a turn, but never beyond
    lowest, highest = math.ceil(100.0 * lowest - 1e-6) / 100.0, math.floor(100.0 * highest + 1e-6) / 100.0
    return f"{here}; {move_command(axis, min(max(0.0, lowest), highest))} moves it to where the motion fits"


def name_range(limits: "Limits") -> str:
    """The position limits in words."""
    return f"{limits.position_min_rev:g} … {limits.position_max_rev:g} rev"


@dataclass(frozen=True)
class Whereabouts:
    """Position of an axis after a stop.

    Attributes:
        stands_rev: Position of its motor; None if it did not answer.
        began_rev: Position of the motor when the drive was enabled; None if it was not.
    """

    axis: int
    stands_rev: float | None
    began_rev: float | None

    @property
    def is_away(self) -> bool:
        """True if it is not where it began."""
        known = self.stands_rev is not None and self.began_rev is not None
        return known and abs((self.stands_rev or 0.0) - (self.began_rev or 0.0)) > AWAY_REV

    def __str__(self) -> str:
        if self.stands_rev is None:
            return f"the position of axis {self.axis} is not known"
        return f"axis {self.axis} is at {rev_text(self.stands_rev)} rev"


def stop_text(found: Sequence[Whereabouts]) -> str:
    """Return the axes' positions after a stop, and how to go on."""
    away = [each for each in found if each.is_away]
    lost = [each for each in found if each.stands_rev is None]
    said = [", ".join(map(str, found))] if found else []
    if away:
        commands = " and ".join(move_command(each.axis, each.began_rev or 0.0) for each in away)
        said.append(f"to bring {'it' if len(away) == 1 else 'them'} back: {commands}")
    if lost:
        commands = " and ".join(f"hil move --axis {each.axis} --back" for each in lost)
        said.append(f"once the bus answers again: {commands}")
    return "; ".join(said)


AT_REST: Final = "the axes are at rest, and their drives are disabled"
"""The words for the end of a motion that is followed by an error of the master alone."""


class LastPositions:
    """Positions of the axes as the master has last seen them at rest.

    Attributes:
        words: Each axis with its position, in words; empty before the first session.
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
