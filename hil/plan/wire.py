"""Duration of frames at a bit rate: classic CAN, or CAN FD."""

from dataclasses import dataclass

from hil.can.bits import NOMINAL_BITS, worst_case_bits

CLASSIC_MAX_BITRATE = 1_000_000
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Bytes of a CAN FD frame by its DLC."""


@dataclass(frozen=True)
class WireTiming:
    """Bit rates of a bus, and the durations of frames.

    Attributes:
        bitrate: Bit rate of the arbitration, in bit/s; on classic CAN of the whole frame.
        data_bitrate: Bit rate of the data phase of CAN FD; None: classic CAN.
    """

    bitrate: int
    data_bitrate: int | None = None

    @property
    def bit_ns(self) -> int:
        """Duration of one bit of the arbitration, in ns, rounded up."""
        return -(-1_000_000_000 // self.bitrate)

    @property
    def name(self) -> str:
        """The bit rates in words."""
        return rate_text(self.bitrate) + ("" if self.data_bitrate is None else f", data at {rate_text(self.data_bitrate)}")

    def worst_ns(self, length: int) -> int:
        """Longest duration of a frame with `length` bytes, in ns, rounded up."""
        if self.data_bitrate is None:
            return -(-worst_case_bits(length) * 1_000_000_000 // self.bitrate)
        slow, fast = fd_worst_bits(length)
        return -(-slow * 1_000_000_000 // self.bitrate) - (-fast * 1_000_000_000 // self.data_bitrate)

    def nominal_ns(self, length: int) -> int:
        """Return the shortest duration of such a frame in ns.

        Classic without stuff bits; for CAN FD a lower bound, its data alone.
        """
        if self.data_bitrate is None:
            return (NOMINAL_BITS + 8 * length) * 1_000_000_000 // self.bitrate
        return 30 * 1_000_000_000 // self.bitrate + 8 * length * 1_000_000_000 // self.data_bitrate


def fd_worst_bits(length: int) -> tuple[int, int]:
    """Return the most bits of a CAN FD frame by bit rate.

    At the arbitration's rate, and at the data's; the frame has an 11-bit identifier and bit rate switching. Layout and
    places of the rate changes: `hil.can.bits`. Stuff bits by contents at worst: one after the first five bits and one for
    every four more, ⌊(n − 1)/4⌋ of the n = 17 up to BRS; from there on, whatever the bits before, one for every four.

    Raises:
        ValueError: The length is not within 0 … 64.

    Source: ISO 11898-1:2015, 10.4, FD base frame format.
    """
    if not 0 <= length <= FD_LENGTHS[-1]:
        raise ValueError(f"a CAN FD frame carries 0 to 64 bytes, not {length}")
    padded = next(size for size in FD_LENGTHS if size >= length)
    slow = 17 + (17 - 1) // 4 + 2 + 7 + 3
    contents = 1 + 4 + 8 * padded
    checked = 4 + (17 if padded <= 16 else 21)
    return slow, contents + -(-contents // 4) + checked + 1 + (checked - 1) // 4 + 1


def rate_text(bitrate: int) -> str:
    """A bit rate as an address spells it, with its unit."""
    if bitrate >= 1_000_000:
        return f"{bitrate / 1e6:g} Mbit/s"
    return f"{bitrate / 1e3:g} kbit/s"
