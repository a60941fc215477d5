"""Frames as no master would send them, weighted so that most of them reach something: seeded, without end."""

import random
import struct
from collections.abc import Iterator, Sequence

from drive_profiles.standard.cia402 import Object
from hil.can.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, Frame

CONTROL_WORDS = (0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x3F, 0x5F, 0x10F, 0x21F, 0x80, 0x86, 0x8F)
SYNC, EMERGENCY, TIME, LSS = 0x080, 0x080, 0x100, 0x7E5
TEXT, NAME = (0x2FF0, 0), (0x1008, 0)
"""Of our drive, and of every node: what takes more than a frame."""
STARTS_BLOCK_DOWNLOAD, STARTS_BLOCK_UPLOAD, GOES_ON = 0xC6, 0xA4, 0xA3
_BURSTS = (1, 1, 1, 2, 2, 10)

Place = tuple[int, int]


class RandomFrames:
    """Frames for the nodes of one bus.

    Args:
        seed: Equal seeds give equal frames.
        places: By node-ID, the places of its dictionary.
    """

    def __init__(self, seed: int, places: dict[int, Sequence[Place]]) -> None:
        self._chance = random.Random(seed)
        self._places = places
        self._nodes = tuple(places)
        self._kinds = (
            (self._sdo, 24), (self._written, 14), (self._download, 3), (self._upload, 3), (self._block_download, 2),
            (self._block_upload, 3), (self._store, 1), (self._pdo, 14), (self._sync, 16), (self._nmt, 4), (self._enable, 6),
            (self._home, 1), (self._lss, 3), (self._error_control, 5), (self._time, 1), (self._anything, 7),
        )  # fmt: skip

    def __iter__(self) -> Iterator[Frame]:
        """Give frames, without end."""
        kinds, weights = zip(*self._kinds, strict=True)
        while True:
            for kind in self._chance.choices(kinds, weights, k=256):
                yield from kind(self._chance.choice(self._nodes))

    def _bytes(self, length: int) -> bytes:
        return self._chance.randbytes(length)

    def _place(self, node: int) -> Place:
        if self._chance.random() < 0.9:
            return self._chance.choice(self._places[node])
        return self._chance.getrandbits(16), self._chance.getrandbits(8)

    def _number(self) -> bytes:
        """Four bytes: small and large numbers, the limits of types, and anything."""
        small = self._chance.choice((0, 1, 2, 3, 4, 5, 6, 8, 16, 127, 128, 255, 32767, 65535, 2**31 - 1, 2**31, 2**32 - 1))
        return struct.pack("<I", small) if self._chance.random() < 0.5 else self._bytes(4)

    def _sdo(self, node: int) -> Iterator[Frame]:
        first = self._chance.getrandbits(8)
        yield Frame(0x600 + node, struct.pack("<BHB", first, *self._place(node)) + self._number())

    def _written(self, node: int) -> Iterator[Frame]:
        yield self._write(node, self._place(node), self._number()[: self._chance.choice((1, 2, 4))])

    def _write(self, node: int, place: Place, data: bytes) -> Frame:
        return Frame(0x600 + node, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, *place) + data.ljust(4, b"\0"))

    def _download(self, node: int) -> Iterator[Frame]:
        """Segments in their order, now and then with a wrong toggle bit, or without an end."""
        place, length = self._chance.choice((TEXT, self._place(node))), self._chance.choice((0, 1, 4, 8, 20, 21))
        first = self._chance.choice((0x20, 0x21))
        yield Frame(0x600 + node, struct.pack("<BHBI", first, *place, length if first & 1 else 0))
        for start in range(0, max(1, length), 7):
            unused = 7 - min(7, length - start)
            toggle = (start // 7 + (self._chance.random() < 0.03)) % 2
            is_last = start + 7 >= length and self._chance.random() < 0.9
            yield Frame(0x600 + node, bytes((toggle << 4 | unused << 1 | is_last,)) + self._bytes(7))

    def _upload(self, node: int) -> Iterator[Frame]:
        yield Frame(0x600 + node, struct.pack("<BHB4x", 0x40, *self._chance.choice((TEXT, NAME, self._place(node)))))
        for step in range(self._chance.randrange(5)):
            yield Frame(0x600 + node, bytes((0x60 | (step % 2) << 4,)) + bytes(7))

    def _store(self, node: int) -> Iterator[Frame]:
        index = self._chance.choice((0x1010, 0x1010, 0x1011, 0x1018, 0x1018, 0x1018))
        yield self._write(node, (index, self._chance.randrange(1, 5)), b"load" if index == 0x1011 else b"save")

    def _block_download(self, node: int) -> Iterator[Frame]:
        length = self._chance.choice((1, 4, 7, 8, 100, 889, 890, 1000))
        place = self._chance.choice((TEXT, self._place(node)))
        yield Frame(0x600 + node, struct.pack("<BHBI", STARTS_BLOCK_DOWNLOAD, *place, length))
        count = -(-length // 7)
        for number in range(1, min(count, 127) + 1):
            if self._chance.random() < 0.98:
                yield Frame(0x600 + node, bytes((number | (number == count) << 7,)) + self._bytes(7))
        yield Frame(0x600 + node, bytes((0xC1 | (7 * count - length) << 2,)) + self._bytes(7))

    def _block_upload(self, node: int) -> Iterator[Frame]:
        size = self._chance.choice((1, 2, 127, 128, 0))
        yield Frame(
            0x600 + node,
            struct.pack("<BHBBB2x", STARTS_BLOCK_UPLOAD, *self._chance.choice((TEXT, NAME, self._place(node))), size, 0),
        )
        yield Frame(0x600 + node, bytes((GOES_ON,)) + bytes(7))
        for _ in range(self._chance.randrange(4)):
            number = self._chance.choice((0, 1, 2, 3, 4, self._chance.getrandbits(7)))
            yield Frame(0x600 + node, bytes((0xA2, number, self._chance.choice((1, 7, 127)))) + bytes(5))
        yield Frame(0x600 + node, bytes((0xA1,)) + bytes(7))

    def _pdo(self, node: int) -> Iterator[Frame]:
        can_id = self._chance.choice((0x200, 0x300, 0x400, 0x500, 0x180)) + node
        word = struct.pack("<H", self._chance.choice(CONTROL_WORDS))
        yield Frame(can_id, (word + self._bytes(6))[: self._chance.choice((0, 1, 2, 6, 6, 8, 8))])

    def _sync(self, _node: int) -> Iterator[Frame]:
        yield from [Frame(SYNC, self._bytes(self._chance.choice((0, 0, 0, 0, 0, 0, 0, 1, 2))))] * self._chance.choice(_BURSTS)

    def _nmt(self, node: int) -> Iterator[Frame]:
        command = self._chance.choice((1, 1, 1, 1, 2, 128, 129, 130, self._chance.getrandbits(8)))
        yield Frame(0x000, bytes((command, self._chance.choice((0, node, node, 126)))))

    def _enable(self, node: int, mode: int | None = None) -> Iterator[Frame]:
        """What a master does, so that what follows meets a drive under torque."""
        if mode is None:
            mode = self._chance.choice((1, 3, 4, 6, 7, 8, 9, 10))
        yield Frame(0x000, bytes((1, node)))
        yield self._write(node, (Object.MODES_OF_OPERATION, 0), bytes((mode,)))
        for word in (0x00, 0x80, 0x06, 0x07, 0x0F):
            yield self._write(node, (Object.CONTROL_WORD, 0), struct.pack("<H", word))

    def _home(self, node: int) -> Iterator[Frame]:
        """Enabled for homing, with speeds at which the motor moves, and started."""
        yield from self._enable(node, 6)
        yield self._write(node, (0x6098, 0), bytes((self._chance.choice((17, 18, 33, 34, 37)),)))
        for subindex in (1, 2):
            yield self._write(node, (0x6099, subindex), struct.pack("<I", self._chance.choice((100, 5_000, 100_000))))
        yield self._write(node, (Object.CONTROL_WORD, 0), b"\x1f\0")

    def _lss(self, _node: int) -> Iterator[Frame]:
        service = self._chance.choice(
            (0x04, 0x11, 0x13, 0x15, 0x17, 0x40, 0x43, 0x4C, 0x51, 0x5A, 0x5E, self._chance.getrandbits(8))
        )
        # never into the configuration state for long: a node with a new number would be out of reach
        yield Frame(LSS, bytes((service,)) + self._number() + self._bytes(3))
        yield Frame(LSS, bytes(8).replace(b"\0", b"\4", 1))

    def _error_control(self, node: int) -> Iterator[Frame]:
        remote = self._chance.random() < 0.3
        number = self._chance.choice((node, 127, self._chance.randrange(128)))
        yield Frame(
            0x700 + number | (CAN_RTR_FLAG if remote else 0), b"" if remote else self._bytes(self._chance.choice((0, 1, 1, 1, 2)))
        )

    def _time(self, _node: int) -> Iterator[Frame]:
        yield Frame(TIME, self._bytes(self._chance.choice((5, 6, 6, 8))))

    def _anything(self, _node: int) -> Iterator[Frame]:
        flags = self._chance.choice((0, 0, 0, CAN_RTR_FLAG, CAN_EFF_FLAG, self._chance.getrandbits(32)))
        yield Frame(self._chance.getrandbits(11) | flags, self._bytes(self._chance.randrange(9)))
