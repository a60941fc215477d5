"""Bit packing of values in a PDO (CiA 301, 7.5.2.36).

Fields need not begin at byte boundaries.
"""

from collections.abc import Sequence

from drive_profiles.standard.cia301 import DataType, Value, decode, encode

Field = tuple[DataType | None, int]
"""A data type, or None for a gap, and the bits that it takes."""


def bits_of(data_type: DataType) -> int:
    """Return the number of bits that a value takes in a PDO.

    It is 1 for a BOOLEAN, else the bits of its bytes (CiA 301, 7.4.7).
    """
    return 1 if data_type is DataType.BOOLEAN else 8 * (data_type.size or 0)


class BitPacker:
    """Packer for fields of any number of bits.

    It has the methods of `struct.Struct` that a PDO uses.

    The first field lies in the least significant bits of the first byte, the next one above it, and so on through the
    bytes, as a little-endian number; the bits above the last field are 0. Made of whole bytes, this is what `struct` gives.

    Attributes:
        size: Bytes that the fields take, the last one perhaps in part.
    """

    def __init__(self, fields: Sequence[Field]) -> None:
        self._fields: list[tuple[DataType, int, int]] = []
        end = 0
        for data_type, bits in fields:
            if data_type is not None:
                self._fields.append((data_type, end, bits))
            end += bits
        self.size = -(-end // 8)

    def pack(self, *values: Value) -> bytes:
        """Pack one value for each field that is not a gap.

        Raises:
            ValueError: A value is not of its field's type, or there are more or fewer values than fields.
        """
        number = 0
        for (data_type, offset, _), value in zip(self._fields, values, strict=True):
            number |= int.from_bytes(encode(data_type, value), "little") << offset
        return number.to_bytes(self.size, "little")

    def unpack_from(self, data: bytes) -> tuple[Value, ...]:
        """Unpack the values of the fields that are not gaps.

        Bytes after the last field are ignored.
        """
        number = int.from_bytes(data, "little")
        return tuple(
            decode(data_type, (number >> offset & (1 << bits) - 1).to_bytes(-(-bits // 8), "little"))
            for data_type, offset, bits in self._fields
        )
