"""How many answers a client of an SDO server is owed, and of what form: written from CiA 301, 7.2.4.3, as a client sees it."""

import struct

MS = 1_000_000
SILENCE, TIME_OUT = 250 * MS, 5000 * MS
SAVE = b"save"


def _object(data):
    return struct.unpack_from("<xHB", data)


class SdoOracle:
    """One channel, followed by its requests and answers alone.

    Every request of 8 bytes is owed one answer. Owed none: the client's abort, a segment of a sub-block but the last, a last one
    that the bus repeats, the client's end of a block upload, and what comes while the server stores. Owed 1 to 127: the start of
    a block upload and an acknowledgement in it.

    Args:
        exists: Tells of an index and a sub-index whether the dictionary has it.
        store_ns: How long the server may be deaf when it stores.
    """

    def __init__(self, exists, store_ns):
        self._exists, self._store_ns = exists, store_ns
        self.visited = set()
        self.answered = 0
        self.reset()

    def reset(self):
        """The server has forgotten its transfer: NMT has stopped or reset the node."""
        self.state = "idle"
        self._place, self._toggle, self._left, self._deadline = (0, 0), 0, 0, None
        self._size, self._next, self._has_heard, self._ended_by = 0, 1, False, None
        self._value = b""
        self._sent, self._in_flight, self._is_complete = 0, 0, False

    def take(self, data, answers, now):
        """A request and what came at once."""
        self.answered += len(answers)
        before = self.state
        if len(data) != 8 or before == "deaf" or self._is_repetition(data):
            assert not answers, (before, data, answers)
            return
        if before == "block download" and not self._begins_anew(data):
            self._segment(data, answers)
        elif data[0] >> 5 == 4:
            assert not answers, (before, data, answers)
            self.reset()
        else:
            self._request(data, answers, now)
        if self.state == "idle":
            self._deadline = None
        elif self.state != "deaf":
            self._deadline = now + (SILENCE if self._has_heard else TIME_OUT)
        self.visited.add(self.state)

    def passed(self, answers, now):
        """Time has passed up to now, a little at a time, and brought this."""
        is_late = self._deadline is not None and now >= self._deadline
        assert len(answers) == is_late, (self.state, now, self._deadline, answers)
        if not answers:
            return
        self.answered += 1
        answer = answers[0]
        if self.state == "deaf":
            assert answer[0] in {0x60, 0x20, 0x30, 0xA1, 0x80}, answer
            self.reset()
        elif self._has_heard:
            self._acknowledged(answer)
            self._deadline = now + TIME_OUT if self.state != "idle" else None
        else:
            assert answer[0] == 0x80, answer
            assert answer[4:] == bytes.fromhex("00000405"), answer
            self.reset()

    # -- requests

    def _request(self, data, answers, now):
        service = self._service(data[0])
        if self._stores(service, data) and not answers:
            self.state, self._deadline = "deaf", now + self._store_ns
            return
        if service == "end block upload" and self.state == "block upload ends":
            assert not answers, (data, answers)
            self.reset()
            return
        if service == "start block upload" and self.state == "block upload ready":
            self._sub_block(answers)
            return
        if service == "acknowledge" and self.state == "block upload":
            self._upload_acknowledged(data, answers)
            return
        assert len(answers) == 1, (self.state, data, answers)
        answer = answers[0]
        assert len(answer) == 8, answer
        if service.startswith("initiate"):
            self.reset()
            self._place = _object(data)
            assert _object(answer) == self._place, (data, answer)
        if answer[0] == 0x80:
            if not service.startswith("initiate") and service not in self._known():
                assert answer[4:] == bytes.fromhex("01000405"), (self.state, data, answer)
            self.reset()
            return
        getattr(self, "_" + service.replace(" ", "_"))(data, answer)

    def _known(self):
        return {
            "download": {"download segment"},
            "upload": {"upload segment"},
            "block download ends": {"end block download"},
            "block upload ready": {"start block upload"},
            "block upload": {"acknowledge"},
            "block upload ends": {"end block upload"},
        }.get(self.state, set())

    @staticmethod
    def _service(first):
        match first >> 5:
            case 0:
                return "download segment"
            case 1:
                return "initiate download"
            case 2:
                return "initiate upload"
            case 3:
                return "upload segment"
            case 5:
                return ("initiate block upload", "end block upload", "acknowledge", "start block upload")[first & 3]
            case 6:
                return ("initiate block download", "end block download")[first & 1]
            case _:
                return "reserved"

    def _stores(self, service, data):
        """Whether a request may complete the writing of the command that takes its time."""
        if service == "initiate download":
            index, _ = _object(data)
            return bool(data[0] & 2) and index == 0x1010 and data[4:] == SAVE
        if self._place[0] != 0x1010:
            return False
        if service == "download segment" and self.state == "download":
            unused = data[0] >> 1 & 7
            return bool(data[0] & 1) and self._value + data[1 : 8 - unused] == SAVE
        return service == "end block download" and self._value.startswith(SAVE)

    def _initiate_download(self, data, answer):
        assert answer == b"\x60" + data[1:4] + bytes(4), (data, answer)
        if not data[0] & 2:
            self.state, self._toggle, self._value = "download", 0, b""

    def _download_segment(self, data, answer):
        assert self.state == "download"
        assert data[0] >> 4 & 1 == self._toggle, (data, answer)
        assert answer == bytes((0x20 | self._toggle << 4, *bytes(7))), (data, answer)
        self._value += data[1 : 8 - (data[0] >> 1 & 7)]
        self._toggle ^= 1
        if data[0] & 1:
            self.reset()

    def _initiate_upload(self, _data, answer):
        assert answer[0] in {0x41, 0x43, 0x47, 0x4B, 0x4F}, answer
        if answer[0] == 0x41:
            self.state, self._toggle, self._left = "upload", 0, int.from_bytes(answer[4:], "little")

    def _upload_segment(self, data, answer):
        assert self.state == "upload"
        assert data[0] >> 4 & 1 == self._toggle, (data, answer)
        carried = min(7, self._left)
        self._left -= carried
        assert answer[0] == self._toggle << 4 | (7 - carried) << 1 | (not self._left), (answer, self._left)
        self._toggle ^= 1
        if not self._left:
            self.reset()

    # -- block download

    def _begins_anew(self, data):
        """A first byte that no segment of this sub-block has, and an object that there is: a client that has given up."""
        begins = self._service(data[0]).startswith("initiate")
        return begins and data[0] & 0x7F > self._size and self._exists(*_object(data))

    def _is_repetition(self, data):
        if self.state not in {"block download", "block download ends"} or self._has_heard or data != self._ended_by:
            return False
        return self.state == "block download ends" or data[0] & 0x7F > 1

    def _initiate_block_download(self, data, answer):
        assert answer[0] == 0xA0 | data[0] & 4, answer
        assert 1 <= answer[4] <= 127, answer
        assert not any(answer[5:]), answer
        self.state, self._size, self._value = "block download", answer[4], b""

    def _segment(self, data, answers):
        if data[0] == 0x80:
            assert not answers, answers
            self.reset()
            return
        number, is_last = data[0] & 0x7F, bool(data[0] & 0x80)
        if not 1 <= number <= self._size:
            assert [a[0] for a in answers] == [0x80], (data, answers)
            self.reset()
            return
        self._has_heard = True
        if number == self._next:
            self._next += 1
            self._value += data[1:]
            self._is_complete = is_last
        if is_last or number == self._size:
            self._ended_by = data
            assert len(answers) == 1, (data, answers)
            self._acknowledged(answers[0])
        else:
            assert not answers, (data, answers)

    def _acknowledged(self, answer):
        if answer[0] == 0x80:
            self.reset()
            return
        assert answer[0] == 0xA2, answer
        assert answer[1] == self._next - 1, (answer, self._next)
        assert 1 <= answer[2] <= 127, answer
        self._size, self._next, self._has_heard = answer[2], 1, False
        if self._is_complete:
            self.state = "block download ends"

    def _end_block_download(self, _data, answer):
        assert self.state == "block download ends", self.state
        assert answer == b"\xa1" + bytes(7), answer
        self.reset()

    # -- block upload

    def _initiate_block_upload(self, data, answer):
        if answer[0] >> 5 == 2:
            self._initiate_upload(data, answer)  # the client lets a short value come without blocks
            return
        assert answer[0] == 0xC2 | data[0] & 4, answer
        self._left = max(1, -(-int.from_bytes(answer[4:], "little") // 7))
        self.state, self._size = "block upload ready", data[4]

    def _sub_block(self, answers):
        self._in_flight = min(self._size, self._left)
        numbers = [answer[0] & 0x7F for answer in answers]
        assert numbers == list(range(1, self._in_flight + 1)), (answers, self._in_flight)
        lasts = [bool(answer[0] & 0x80) for answer in answers]
        assert lasts == [False] * (self._in_flight - 1) + [self._in_flight == self._left], answers
        self.state = "block upload"

    def _upload_acknowledged(self, data, answers):
        number, size = data[1], data[2]
        left = self._left - number
        if number > self._in_flight or (left and not 1 <= size <= 127):
            assert [a[0] for a in answers] == [0x80], (data, answers)
            self.reset()
        elif left:
            self._left, self._size = left, size
            self._sub_block(answers)
        else:
            assert len(answers) == 1, answers
            assert answers[0][0] & 0xE3 == 0xC1, answers
            self.state = "block upload ends"
