"""How long a classic CAN frame is on the wire, in bits, with the stuff bits that its very contents need.

Layout (ISO 11898-1, classic frames), most significant bit first:

- 11-bit identifier: SOF 1, identifier 11, RTR 1, IDE 1, r0 1, DLC 4, data 0 to 64, CRC 15
- 29-bit identifier: SOF 1, base identifier 11, SRR 1, IDE 1, extension 18, RTR 1, r1 1, r0 1, DLC 4, data 0 to 64, CRC 15
- not stuffed: CRC delimiter 1, ACK slot 1, ACK delimiter 1, EOF 7; then the intermission of 3 before the next frame

From SOF to the last bit of the CRC the sender inserts after five equal bits one of the other value, which itself counts for the
next five. SRR and IDE of a long frame are recessive (1), r0 and r1 dominant (0). A remote frame carries the DLC and no data.
"""

from hil.can.frame import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_ERR_FLAG, CAN_RTR_FLAG, CAN_SFF_MASK, MAX_DATA_LENGTH, Frame

CRC_POLYNOMIAL = 0x4599
"""x¹⁵ + x¹⁴ + x¹⁰ + x⁸ + x⁷ + x⁴ + x³ + 1, without its first term."""

CRC_BITS = 15
TAIL_BITS = 1 + 1 + 1 + 7 + 3
"""CRC delimiter, ACK slot and delimiter, end of frame, intermission."""

_HEADER_BITS = {False: 1 + 11 + 1 + 1 + 1 + 4, True: 1 + 11 + 1 + 1 + 18 + 1 + 1 + 1 + 4}
_STUFF_AFTER = 5


def frame_bits(frame: Frame, *, stuffed: bool = True) -> int:
    """Bits that a data or remote frame takes of the bus, intermission included.

    Args:
        frame: As it stands on the bus; the data of a remote frame only tell its DLC.
        stuffed: Count the stuff bits; else the frame as if none were needed.

    Raises:
        ValueError: An error message of the controller, which never was on the wire, more than 8 bytes, or no such identifier.
    """
    bits, length = _content(frame)
    bits, length = bits << CRC_BITS | crc15(bits, length), length + CRC_BITS
    return length + (stuff_bits(bits, length) if stuffed else 0) + TAIL_BITS


def worst_case_bits(data_length: int, extended: bool = False) -> int:
    """The most bits that a data frame of this length can take, intermission included.

    At worst the first five bits are equal and every four after them bring a further stuff bit: ⌊(n − 1)/4⌋ in n bits.

    Raises:
        ValueError: No length from 0 to 8.
    """
    if not 0 <= data_length <= MAX_DATA_LENGTH:
        raise ValueError(f"a CAN frame carries 0 to {MAX_DATA_LENGTH} bytes, not {data_length}")
    length = _HEADER_BITS[extended] + 8 * data_length + CRC_BITS
    return length + (length - 1) // (_STUFF_AFTER - 1) + TAIL_BITS


def crc15(bits: int, length: int) -> int:
    """The CRC of a sequence of bits, from SOF to the last of the data; the register starts at 0."""
    register = 0
    # zeros ahead of the sequence leave the register at 0, so whole bytes may be taken
    for byte in bits.to_bytes((length + 7) // 8, "big"):
        register = (register << 8 & _CRC_MASK) ^ _CRC_OF[register >> 7 ^ byte]
    return register


def stuff_bits(bits: int, length: int) -> int:
    """How many bits a sender inserts into a sequence; one that is inserted counts for the next five."""
    whole = length // 8
    inserted, state = _stuffed(bits >> 8 * whole, length - 8 * whole, _NOTHING_YET)
    for byte in (bits & (1 << 8 * whole) - 1).to_bytes(whole, "big"):
        more, state = _STUFFED_OF[state][byte]
        inserted += more
    return inserted


def _stuffed(bits: int, length: int, state: int) -> tuple[int, int]:
    """Bits inserted into a sequence, and the state after it: twice the run of equal bits so far, plus their value."""
    inserted, run, last = 0, state >> 1, state & 1
    for position in range(length - 1, -1, -1):
        bit = bits >> position & 1
        run, last = (run + 1 if bit == last else 1), bit
        if run == _STUFF_AFTER:
            inserted, run, last = inserted + 1, 1, 1 - bit
    return inserted, run << 1 | last


def _crc_of_byte(byte: int) -> int:
    register = byte << CRC_BITS - 8
    for _ in range(8):
        register = register << 1 ^ (CRC_POLYNOMIAL if register >> CRC_BITS - 1 & 1 else 0)
    return register & _CRC_MASK


_NOTHING_YET = 0
_CRC_MASK = (1 << CRC_BITS) - 1
_CRC_OF = tuple(_crc_of_byte(byte) for byte in range(256))
_STUFFED_OF = tuple(tuple(_stuffed(byte, 8, state) for byte in range(256)) for state in range(2 * _STUFF_AFTER))
"""Both a byte at a time: a bus counts every frame."""


def _content(frame: Frame) -> tuple[int, int]:
    """The bits from SOF to the last of the data, as a number, and how many they are."""
    can_id, data = frame
    if not 0 <= can_id <= 0xFFFF_FFFF or can_id & CAN_ERR_FLAG:
        raise ValueError(f"{can_id:#x} is no frame on the wire")
    if len(data) > MAX_DATA_LENGTH:
        raise ValueError(f"a CAN frame carries at most {MAX_DATA_LENGTH} bytes, not {len(data)}")
    remote = int(bool(can_id & CAN_RTR_FLAG))
    identifier = can_id & CAN_EFF_MASK
    if can_id & CAN_EFF_FLAG:
        header = (identifier >> 18) << 2 | 0b11  # SOF 0, base identifier, SRR, IDE
        header = header << 18 | identifier & 0x3FFFF
        header = header << 7 | remote << 6 | len(data)  # RTR, r1, r0, DLC
    elif identifier <= CAN_SFF_MASK:
        header = identifier << 7 | remote << 6 | len(data)  # RTR, IDE, r0, DLC
    else:
        raise ValueError(f"identifier {identifier:#x} needs 29 bits, but CAN_EFF_FLAG is not set")
    length = _HEADER_BITS[bool(can_id & CAN_EFF_FLAG)]
    if remote:
        return header, length
    return header << 8 * len(data) | int.from_bytes(data, "big"), length + 8 * len(data)
