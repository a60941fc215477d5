"""The transcripts beside this file, frame by frame; transcripts/README.md says how they are written."""

import re
from pathlib import Path

import pytest

from tests.conformance.sdo_client import UNKNOWN_COMMAND

FILES = sorted((Path(__file__).parent / "transcripts").glob("*.txt"))
QUIET_S = 0.1


def number(text, node_id):
    """`200+n|80000000`: hexadecimal, with the node-ID and more bits."""
    base, *bits = text.split("|")
    value = sum(node_id if part == "n" else int(part, 16) for part in base.split("+"))
    for more in bits:
        value |= int(more, 16)
    return value


def sent_bytes(words, node_id):
    data = b""
    for word in words:
        if word.startswith("@"):
            data += number(word[1:], node_id).to_bytes(4, "little")
        elif word != "-":
            data += bytes((node_id,)) if word == "nn" else bytes.fromhex(word)
    return data


def is_like(data, words, node_id):
    """Whether bytes are those of a line, with its `..` and `*`."""
    exact = [word for word in words if word != "*"]
    if len(data) < len(exact) or (len(data) > len(exact) and "*" not in words):
        return False
    return all(w == ".." or byte == (node_id if w == "nn" else int(w, 16)) for byte, w in zip(data, exact, strict=False))


class Replay:
    """One transcript on one device."""

    def __init__(self, device, permit, needs, *, hears_heartbeats):
        self.device, self.permit, self.needs = device, permit, needs
        self.hears_heartbeats = hears_heartbeats
        self.mark = 0

    def line(self, text):
        sign, _, rest = text.partition(" ")
        words, node = rest.split(), self.device.node_id
        match sign:
            case "#":
                return
            case "?":
                index, sub = re.fullmatch(r"([0-9A-F]{4})h:([0-9A-F]{2})h", rest).groups()
                self.needs((int(index, 16), int(sub, 16)))
            case "!":
                self.permit(rest)
            case "=":
                self.has_block_transfer()
            case ".":
                self.device.port.during(float(rest))
            case ">R":
                self.device.port.send(number(words[0], node), bytes(int(words[1])), remote=True)
            case ">":
                data = sent_bytes(words[1:], node)
                is_sdo = words[0] == "600+n"
                self.device.port.send(number(words[0], node), data.ljust(8, b"\0") if is_sdo else data)
            case "<" if rest == "-":
                self.is_quiet(text)
            case "<":
                self.expect(words, text)
            case _:
                raise ValueError(f"no line of a transcript: {text!r}")

    def has_block_transfer(self):
        answer = self.device.sdo.request(b"\xa4\x00\x10\x00\x7f\x00")
        if answer[0] == 0x80 and int.from_bytes(answer[4:], "little") == UNKNOWN_COMMAND:
            pytest.skip("the device has no block transfer")
        self.device.sdo.abort(0x1000, 0)
        self.mark = len(self.device.port.seen)

    def expect(self, words, text):
        can_id, seen = number(words[0], self.device.node_id), self.device.port.seen
        heard = self.device.port.expect(can_id, self.device.boot_s, self.mark)
        assert heard is not None, f"{text}: nothing came"
        self.mark = seen.index(heard, self.mark) + 1
        # a heartbeat of the state before may still have been on its way
        while can_id == 0x700 + self.device.node_id and not is_like(heard.data, words[1:], self.device.node_id):
            heard = self.device.port.expect(can_id, 0.2, self.mark)
            assert heard is not None, f"{text}: it did not come"
            self.mark = seen.index(heard, self.mark) + 1
        assert is_like(heard.data, words[1:], self.device.node_id), f"{text}: {heard.data.hex(' ')} came"

    def is_quiet(self, text):
        self.device.port.during(QUIET_S)
        own = {base + self.device.node_id for base in (0x080, 0x580, 0x700)}
        came = [f for f in self.device.port.seen[self.mark :] if f.can_id in own and not self.is_passed_over(f)]
        assert [f"{f.can_id:03X} {f.data.hex(' ')}" for f in came] == [], text

    def is_passed_over(self, frame):
        """A device may have a heartbeat of its own, which falls where it falls; a boot-up message is none."""
        is_heartbeat = frame.can_id == 0x700 + self.device.node_id and any(frame.data)
        return is_heartbeat and not self.hears_heartbeats


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_transcript_is_what_crosses_the_bus(device, permit, needs, path):
    device.is_touched = True
    replay = Replay(device, permit, needs, hears_heartbeats=path.stem == "heartbeat")
    for line in path.read_text(encoding="ascii").splitlines():
        if line:
            replay.line(line)


def test_there_are_transcripts():
    assert len(FILES) >= 9
