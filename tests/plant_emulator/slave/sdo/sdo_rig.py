"""A server over a small dictionary, and a block client of its own making: written from the standard, not from the server."""

import struct

from drive_profiles.standard.cia301 import DataType
from plant_emulator.slave.dictionary import Access, Dictionary, Entry
from plant_emulator.slave.sdo.server import SdoServer

NODE = 5
SECOND = 1_000_000_000
LIMITED = (0x00, 0x20, 0x00)
LABEL = (0x01, 0x20, 0x00)
STATUS = (0x02, 0x20, 0x00)
KEY = (0x03, 0x20, 0x00)
BLOB = (0x04, 0x20, 0x00)
WIDE = (0x05, 0x20, 0x00)
TEXT = "a label of 21 letters"


def make_server(**options):
    text = DataType.VISIBLE_STRING
    dictionary = Dictionary(
        [
            Entry(0x2000, 0, "Limited", DataType.INTEGER16, Access.RW, 10, low=-100, high=100),
            Entry(0x2001, 0, "Label", text, Access.RW, TEXT),
            Entry(0x2002, 0, "Status", DataType.UNSIGNED16, Access.RO, 1),
            Entry(0x2003, 0, "Key", DataType.UNSIGNED16, Access.WO, 1),
            Entry(0x2004, 0, "Blob", DataType.DOMAIN, Access.RW, b""),
            Entry(0x2005, 0, "Wide", DataType.UNSIGNED64, Access.RW, 0x0102030405060708),
        ]
    )
    return SdoServer(dictionary, 0x580 + NODE, **options), dictionary


def ask_all(server, *data, now=0):
    """Send a request, padded to 8 bytes; give the bytes of all answers."""
    frames = server.receive(bytes(data).ljust(8, b"\0"), now)
    assert all(frame.can_id == 0x585 and len(frame.data) == 8 for frame in frames)
    return [frame.data for frame in frames]


def ask(server, *data, now=0):
    """Send a request; give the bytes of its one answer, or None."""
    answers = ask_all(server, *data, now=now)
    assert len(answers) <= 1
    return answers[0] if answers else None


def abort(code, *address):
    return struct.pack("<B3sI", 0x80, bytes(address or (0, 0, 0)), code)


def crc16(data):
    """CRC-16-CCITT bit by bit, from its polynomial."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


class Wire:
    """Loses the segments whose number, counted over the whole transfer, is in a set."""

    def __init__(self, lost=()):
        self.lost = lost
        self.count = 0

    def passes(self):
        self.count += 1
        return self.count - 1 not in self.lost


class BlockClient:
    """Block transfers with a server, over a wire that loses segments."""

    def __init__(self, server, address=BLOB):
        self.server, self.address, self.now = server, address, 0
        self.sub_blocks = []

    def ask(self, *data):
        answer = ask(self.server, *data, now=self.now)
        assert answer is not None
        assert answer[0] != 0x80, answer.hex(" ")
        return answer

    def download(self, data, wire, *, announce=True, has_crc=True):
        answer = self.ask(0xC0 | has_crc << 2 | announce << 1, *self.address, *struct.pack("<I", len(data) if announce else 0))
        assert answer[:4] == bytes((0xA0 | has_crc << 2, *self.address))
        size = answer[4]
        assert 1 <= size <= 127
        segments = [data[i : i + 7] for i in range(0, len(data), 7)] or [b""]
        done = 0
        while done < len(segments):
            sent = min(size, len(segments) - done)
            passed = [wire.passes() for _ in range(sent)]
            passed[-1] |= not any(passed)  # a sub-block of which nothing comes ends the transfer by time-out
            answers = []
            for number in range(1, sent + 1):
                if passed[number - 1]:
                    first = number | (0x80 if done + number == len(segments) else 0)
                    answers += ask_all(self.server, first, *segments[done + number - 1].ljust(7, b"\0"), now=self.now)
            if not answers:
                self.now = self.server.due
                answers = [frame.data for frame in self.server.advance(self.now)]
            ((command, accepted, size, *_),) = answers
            assert command == 0xA2
            assert accepted == next((i for i, passes in enumerate(passed) if not passes), sent)
            assert 1 <= size <= 127
            done += accepted
            self.sub_blocks.append(accepted)
        unused = 7 - len(segments[-1])
        assert self.ask(0xC1 | unused << 2, *struct.pack("<H", crc16(data) if has_crc else 0)) == bytes((0xA1, *bytes(7)))

    def upload(self, wire, sizes, *, has_crc=True, patience=127):
        """Take at most `patience` segments of each sub-block, and ask for sub-blocks of these sizes in turn."""
        turn = 0
        answer = self.ask(0xA0 | has_crc << 2, *self.address, sizes[0], 0)
        assert answer[:4] == bytes((0xC2 | has_crc << 2, *self.address))
        length = int.from_bytes(answer[4:], "little")
        answers = ask_all(self.server, 0xA3, now=self.now)
        received, is_complete = [], False
        while not is_complete:
            assert len(answers) <= sizes[turn]
            assert [answer[0] & 0x7F for answer in answers] == list(range(1, len(answers) + 1))
            accepted = 0
            for answer in answers:
                if wire.passes() and answer[0] & 0x7F == accepted + 1 and accepted < patience:
                    accepted += 1
                    received.append(answer[1:])
                    is_complete = bool(answer[0] & 0x80)
            self.sub_blocks.append(accepted)
            turn = (turn + 1) % len(sizes)
            answers = ask_all(self.server, 0xA2, accepted, sizes[turn], now=self.now)
        ((first, crc),) = [struct.unpack_from("<BH", answer) for answer in answers]
        assert first & 0xE3 == 0xC1
        joined = b"".join(received)
        data = joined[: len(joined) - (first >> 2 & 7)]
        assert len(data) == length
        assert crc == (crc16(data) if has_crc else 0)
        assert ask_all(self.server, 0xA1, now=self.now) == []
        return data
