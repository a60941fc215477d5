"""Bit rates of a bus; durations of bits and frames, rounded up."""

from hil.can.bits import TAIL_BITS, fd_bits, fd_sent_bits, frame_bits, sent_bits
from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_RTR_FLAG, Frame

SECOND = 1_000_000_000
INTERMISSION_BITS = 3


class Rates:
    """One bit rate, or two.

    With a data bit rate every data frame goes as a CAN FD frame with bit rate switching, of the same identifier and the same 0 to
    8 bytes; CAN FD has no remote frames, so those stay classic. The flag of an error-passive sender (ESI) is left out:
    it is sent as error-active, which changes no length by more than a stuff bit. Source: ISO 11898-1:2015, 10.4.

    Attributes:
        bitrate: Rate of classic frames, and of the arbitration and the end of CAN FD frames, in bit/s; None: no bit times.
        data_bitrate: Rate of the data in CAN FD frames, in bit/s; None: classic CAN.
        bit_ns: One bit, where that is a whole number of nanoseconds; else 0.
        fast_bit_ns: The same at the data bit rate; 0 without.
        is_exact: True if all bits take whole nanoseconds.
    """

    __slots__ = ("bit_ns", "bitrate", "data_bitrate", "fast_bit_ns", "is_exact")

    def __init__(self, bitrate: int | None, data_bitrate: int | None = None) -> None:
        """Keep the rates, and compute the bits' durations.

        Raises:
            ValueError: No bit rate, or a data bit rate that is lower than the other one or alone.
        """
        if bitrate is not None and bitrate <= 0:
            raise ValueError(f"{bitrate} bit/s is not a bit rate; expected more than 0")
        if data_bitrate is not None and (bitrate is None or data_bitrate < bitrate):
            below = "has no bit rate beside it" if bitrate is None else f"is below the bit rate, {bitrate} bit/s"
            raise ValueError(f"the data bit rate, {data_bitrate} bit/s, {below}; give a bit rate of at most {data_bitrate}")
        self.bitrate, self.data_bitrate = bitrate, data_bitrate
        self.bit_ns = SECOND // bitrate if bitrate and SECOND % bitrate == 0 else 0
        self.fast_bit_ns = SECOND // data_bitrate if data_bitrate and SECOND % data_bitrate == 0 else 0
        self.is_exact = bool(self.bit_ns) and (data_bitrate is None or bool(self.fast_bit_ns))

    def is_fd(self, can_id: int) -> bool:
        """Return True if a frame with this identifier uses CAN FD."""
        return self.data_bitrate is not None and not can_id & CAN_RTR_FLAG

    def ns(self, bits: int, fast_bits: int = 0) -> int:
        """Return the duration of bits at both rates, in ns."""
        if self.is_exact:
            return bits * self.bit_ns + fast_bits * self.fast_bit_ns
        bitrate, data_bitrate = self.bitrate or SECOND, self.data_bitrate or 1
        return -(-(bits * data_bitrate + fast_bits * bitrate) * SECOND // (bitrate * data_bitrate))

    def bits_in(self, duration_ns: int) -> int:
        """Return the whole arbitration bits that fit into a duration."""
        return duration_ns * (self.bitrate or 0) // SECOND

    def bits(self, frame: Frame) -> tuple[int, int]:
        """Return bits at either rate, with intermission; unstuffed without bit times.

        Raises:
            ValueError: `hil.can.bits.frame_bits` refuses the frame.
        """
        bits = frame_bits(frame, stuffed=self.bitrate is not None)  # refuses what is not a frame
        if not self.is_fd(frame.can_id):
            return bits, 0
        return fd_bits(frame.can_id & CAN_EFF_MASK, frame.data, extended=bool(frame.can_id & CAN_EFF_FLAG))

    def sent_bits(self, frame: Frame) -> str:
        """Return a frame's bits from SOF to CRC; "0" is dominant."""
        if not self.is_fd(frame.can_id):
            return sent_bits(frame)
        return fd_sent_bits(frame.can_id & CAN_EFF_MASK, frame.data, extended=bool(frame.can_id & CAN_EFF_FLAG))

    def split(self, frame: Frame, count: int) -> tuple[int, int]:
        """Split a frame's first bits between the two rates."""
        if not self.is_fd(frame.can_id):
            return count, 0
        slow = self.bits(frame)[0] - (TAIL_BITS - 1)  # the delimiter of the CRC is a fast one
        return min(count, slow), max(count - slow, 0)
