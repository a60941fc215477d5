"""Effect of a cancellation that follows on each order."""

from hil.results.base import ResultPart


class FollowedOrder(ResultPart):
    """An order of an axis over a motion.

    Attributes:
        turned_deg: How far φ_k was turned at the end.
        was_taken_back: True if it reached its bounds, and was reset to the identified value.
        time_s: Instants of the track; shape (n,).
        amplitude_arcsec: A_k then.
        phase_deg: φ_k then, not wrapped.
    """

    axis: int
    order: float
    amplitude_start_arcsec: float
    amplitude_end_arcsec: float
    phase_start_deg: float
    phase_end_deg: float
    turned_deg: float
    was_taken_back: bool
    time_s: tuple[float, ...]
    amplitude_arcsec: tuple[float, ...]
    phase_deg: tuple[float, ...]

    @property
    def words(self) -> str:
        """Start and end as a line."""
        back = "; it reached its bounds and was reset" if self.was_taken_back else ""
        return (
            f"axis {self.axis}, order {self.order:g}: A {self.amplitude_start_arcsec:.2f} to {self.amplitude_end_arcsec:.2f} "
            f"arcsec, φ {self.phase_start_deg:.1f} to {self.phase_end_deg:.1f}° (turned by {self.turned_deg:+.1f}°){back}"
        )


class FollowingPeak(ResultPart):
    """Tip peaks in one window: cancellation alone, and with following.

    Attributes:
        order: Order of the window; None for the whole motion.
    """

    order: float | None
    alone_mm: float
    following_mm: float
    error_mm: float


class FollowingBegin(ResultPart):
    """An order that is followed only if much of it is left.

    Less was left in the trial, and it did not come from the gear.

    Attributes:
        part: Least remaining part of it for following.
    """

    axis: int
    order: float
    part: float

    @property
    def words(self) -> str:
        """The same as a clause."""
        return f"axis {self.axis}, order {self.order:g} is followed if more than {100.0 * self.part:.0f} % of it remains"


class FollowingEntry(ResultPart):
    """A cancellation that follows, in a run and its trial.

    Attributes:
        words: Reason why it was not used; empty if it was.
        orders: Its effect on each order; empty if it was not used.
        begins: Orders that are followed only if more than the usual part of them is left.
    """

    is_used: bool
    peaks: tuple[FollowingPeak, ...]
    words: str = ""
    orders: tuple[FollowedOrder, ...] = ()
    begins: tuple[FollowingBegin, ...] = ()
