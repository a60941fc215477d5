"""One SDO client: what it takes for an answer, and what it makes of silence."""

from collections import deque

import pytest

from drive_profiles.device.sdo import MAX_STRANGERS, SdoPort
from drive_profiles.device.transfer import MAX_UPLOAD_BYTES
from drive_profiles.errors import NoAnswerError, SdoAbortedError
from tests.drive_profiles import upload_rig as rig

TEXT, P1 = (0x2100, 0), (0x2001, 1)


class Script:
    """A line whose answers the test gives; `answers` maps what is asked (as hexadecimal text) to what comes."""

    boots = 0

    def __init__(self, answers):
        self.script, self.sent, self.coming = answers, [], deque()

    def send(self, can_id, data):
        self.sent.append(data.hex(" "))
        given = self.script(data) if callable(self.script) else self.script.get(self.sent[-1], ())
        self.coming.extend(bytes.fromhex(each) for each in ([given] if isinstance(given, str) else given))

    def receive(self, timeout_s):
        return self.coming.popleft() if self.coming else None

    def clear(self):
        old = list(self.coming)
        self.coming.clear()
        return old


class Delayed(rig.Line):
    """The node's answers to requests whose numbers are in `late` come with those to the next but `later` requests."""

    def __init__(self, slave, late, later=1):
        super().__init__(slave)
        self.late, self.later, self.count, self.kept = late, later, 0, []

    def send(self, can_id, data):
        self.count += 1
        super().send(can_id, data)
        if self.count in self.late:
            self.kept = list(self._answers)
            self._answers.clear()
        elif self.kept and self.count >= max(self.late) + self.later:
            self._answers.extendleft(reversed(self.kept))
            self.kept = []


def port(slave=None, line=None):
    return SdoPort(rig.NODE, rig.Line(rig.node() if slave is None else slave) if line is None else line, 0.5)


@pytest.mark.parametrize("length", range(40))
def test_texts_of_every_length_go_there_and_back_and_leave_nothing_behind(length):
    slave = rig.node()
    line = rig.Line(slave)
    client = SdoPort(rig.NODE, line, 0.5)
    text = bytes(65 + n % 26 for n in range(length))
    client.write(TEXT, text)
    assert client.read(TEXT) == text
    assert not line.clear()


def test_after_silence_another_object_is_read_before_anything_else():
    line = Script({"40 01 20 01 00 00 00 00": [], "40 00 10 00 00 00 00 00": "43 00 10 00 92 01 00 00"})
    client = port(line=line)
    with pytest.raises(NoAnswerError, match="read of 2001h:1"):
        client.read(P1)
    line.script["40 01 20 01 00 00 00 00"] = "4b 01 20 01 0b 00 00 00"
    assert client.read(P1) == b"\x0b\x00"
    reads = [sent for sent in line.sent if sent.startswith("40")]
    assert reads == ["40 01 20 01 00 00 00 00", "40 00 10 00 00 00 00 00", "40 01 20 01 00 00 00 00"]
    client.read(P1)
    assert len([sent for sent in line.sent if sent.startswith("40")]) == 4  # once is enough


def test_an_abort_is_an_answer_behind_which_nothing_older_comes():
    line = Script({"40 00 10 00 00 00 00 00": "80 00 10 00 00 00 02 06"})
    client = port(line=line)
    with pytest.raises(NoAnswerError):
        client.read(P1)
    line.script["40 01 20 01 00 00 00 00"] = "4b 01 20 01 0b 00 00 00"
    assert client.read(P1) == b"\x0b\x00"


def test_a_node_that_answers_nothing_after_a_time_out_is_asked_six_times_and_then_given_up():
    line = Script({})
    client = port(line=line)
    for _ in range(2):
        with pytest.raises(NoAnswerError):
            client.read(P1)
    assert len([sent for sent in line.sent if sent.startswith("40")]) == 1 + 6


def test_a_late_answer_to_a_read_is_not_taken_for_that_of_the_next_read_of_the_same_object():
    slave = rig.node()
    line = Delayed(slave, {1})
    client = port(line=line)
    with pytest.raises(NoAnswerError):
        client.read(P1)
    slave.dictionary.cell(*P1).value = 99
    assert client.read(P1) == b"\x63\x00"


def test_a_late_confirmation_is_not_taken_for_that_of_the_next_write_of_the_same_object():
    slave = rig.node()
    line = Delayed(slave, {1}, later=2)  # behind the time-out's abort
    client = port(line=line)
    with pytest.raises(NoAnswerError):
        client.write(P1, b"\x63\x00")
    slave.dictionary.on_write(*P1, lambda value: 0x0609_0030)
    with pytest.raises(SdoAbortedError):
        client.write(P1, b"\x0b\x00")


def test_endless_answers_to_others_do_not_hang():
    line = Script(lambda data: [])
    line.receive = lambda timeout_s: bytes.fromhex("4b 41 60 00 00 00 00 00")
    taken = []
    line.receive = lambda timeout_s: taken.append(1) or bytes.fromhex("4b 41 60 00 00 00 00 00")
    with pytest.raises(NoAnswerError):
        port(line=line).read(P1)
    assert len(taken) == MAX_STRANGERS


def test_frames_that_are_no_sdo_are_passed_over():
    line = Script({"40 01 20 01 00 00 00 00": ["", "4b 01", "4b 01 20 01 0b 00 00 00"]})
    assert port(line=line).read(P1) == b"\x0b\x00"


def test_the_abort_code_of_a_segmented_write_is_the_drives_own_and_nothing_is_sent_after_it():
    def drive(data):
        return {1: "60 00 21 00 00 00 00 00", 0: "80 00 21 00 30 00 09 06"}.get(data[0] >> 5, "80 00 00 00 01 00 04 05")

    line = Script(drive)
    with pytest.raises(SdoAbortedError) as caught:
        port(line=line).write(TEXT, b"a text of more than fourteen bytes")
    assert caught.value.code == 0x0609_0030
    assert len(line.sent) == 2


def test_a_confirmed_write_that_nobody_has_asked_for_is_noted():
    line = Script({"40 01 20 01 00 00 00 00": ["60 02 20 01 00 00 00 00", "4b 01 20 01 0b 00 00 00"]})
    client = port(line=line)
    client.read(P1)
    assert client.strays == {(0x2002, 1)}
    client.forget()
    assert not client.strays


def test_a_read_that_is_taken_for_a_write_is_noted():
    client = port(line=Script({"40 01 20 01 00 00 00 00": "60 01 20 01 00 00 00 00"}))
    with pytest.raises(NoAnswerError):
        client.read(P1)
    assert client.strays == {P1}


def test_a_node_does_not_make_us_hold_what_it_likes():
    def endless(data):
        return "41 00 21 00 00 00 00 00" if data[0] >> 5 == 2 else f"{data[0] & 0x10:02x}" + " 41" * 7

    line = Script(endless)
    with pytest.raises(NoAnswerError):
        port(line=line).read(TEXT)
    assert len(line.sent) <= MAX_UPLOAD_BYTES // 7 + 4
