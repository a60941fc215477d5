"""The device under test: its services, what its EDS says, and the way back to how it was found."""

import itertools
from dataclasses import dataclass, field

from canopen.objectdictionary import ODVariable

from drive_profiles.standard.cia301 import DataType, encode
from tests.conformance.sdo_client import DEVICE_STATE, Abort, SdoClient

START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
COMMANDS = (START, STOP, PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION)
INITIALISING, STOPPED, OPERATIONAL, PRE_OP = 0x00, 0x04, 0x05, 0x7F
STATE_AFTER = {START: OPERATIONAL, STOP: STOPPED, PRE_OPERATIONAL: PRE_OP, RESET_NODE: PRE_OP, RESET_COMMUNICATION: PRE_OP}
BEAT_MS = 40

COMMAND_OBJECTS = frozenset({0x1010, 0x1011, 0x1023, 0x1025, *range(0x1F50, 0x1F58), 0x1F80, 0x1F82, 0x6040, 0x60FE, 0x60F2})
"""Objects that do something when they are written: a test that is not about them leaves them alone on a real device."""
MANUFACTURER = range(0x2000, 0x6000)


@dataclass
class Device:
    """One node on a port.

    Attributes:
        name: For the name of a test.
        node_id: Its node-ID.
        port: The bus.
        description: Its EDS, as `drive_profiles.eds` reads it.
        patience_s: How long an answer may take.
        boot_s: How long it may take to start.
        permits: What the user has allowed on a real device: motion, store, lss, alone, factory, manufacturer.
    """

    name: str
    node_id: int
    port: object
    description: object
    patience_s: float = 1.0
    boot_s: float = 10.0
    permits: frozenset = frozenset()
    world: object = None
    eds_text: str = ""
    device_info: dict = field(default_factory=dict)
    is_touched: bool = False
    not_restored_words: list = field(default_factory=list)

    def __post_init__(self):
        self.sdo = SdoClient(self.port, self.node_id, self.patience_s)
        self.entries = {(v.index, v.subindex): v for v in variables(self.description.dictionary)}
        self.indices = {index for index, _ in self.entries}

    @property
    def is_emulated(self):
        return self.port.is_emulated

    def may(self, permit):
        """Whether something is allowed; an emulated device allows everything."""
        return self.is_emulated or permit in self.permits

    def refused(self, answer, *codes):
        """Whether an answer is one of these aborts; an emulated device must give the first, whatever else is tolerated."""
        return isinstance(answer, Abort) and answer in (codes[:1] if self.is_emulated else codes)

    @staticmethod
    def tolerated(answer, codes):
        """Whether an answer is one of these aborts, where the standard leaves open which."""
        return isinstance(answer, Abort) and answer in codes

    def is_about(self, count, expected):
        """Whether so many frames are as many as expected: on a bus with a clock of its own one more or less, and a fifth."""
        slack = 1 if self.is_emulated else 1 + expected // 5
        return abs(count - expected) <= slack

    def are_apart(self, frames, seconds):
        """Whether frames keep a distance; when they are read from a real bus says little of one gap, but much of all."""
        if self.is_emulated:
            return all(b.at_s - a.at_s >= seconds - 1e-6 for a, b in itertools.pairwise(frames))
        return len(frames) < 2 or len(frames) - 1 <= (frames[-1].at_s - frames[0].at_s) / seconds * 1.1 + 1

    # -- the dictionary

    def has(self, index, subindex=0):
        return (index, subindex) in self.entries

    def size(self, index, subindex=0):
        """Bytes of an entry of fixed size, or None."""
        data_type = self.entries[index, subindex].data_type
        return DataType(data_type).size if data_type in set(DataType) else None

    def read(self, index, subindex=0):
        """A whole number that must be readable."""
        data = self.sdo.upload(index, subindex)
        assert not isinstance(data, Abort), f"{index:04X}h:{subindex:02X}h: {data!r}"
        signed = self.has(index, subindex) and self.entries[index, subindex].data_type in {2, 3, 4, 0x15}
        return int.from_bytes(data, "little", signed=signed)

    def write(self, index, subindex, value, size=None):
        """Write a whole number; the abort, or None."""
        self.is_touched = True
        length = size or (self.size(index, subindex) if self.has(index, subindex) else None) or 4
        return self.sdo.download(index, subindex, (value & (1 << 8 * length) - 1).to_bytes(length, "little"))

    def set(self, index, subindex, value):
        """Write what must be accepted."""
        answer = self.write(index, subindex, value)
        assert answer is None, f"{index:04X}h:{subindex:02X}h = {value:#x}: {answer!r}"

    def is_untouchable(self, index):
        """Whether tests that are not about an object leave it alone: what it does when it is written is not known."""
        if self.is_emulated:
            return False
        return index in COMMAND_OBJECTS or (index in MANUFACTURER and not self.may("manufacturer"))

    # -- services

    def nmt(self, command, node=None):
        self.is_touched = True
        self.port.send(0x000, bytes((command, self.node_id if node is None else node)))

    def sync(self, data=b""):
        self.port.send(0x080, data)

    def emergencies(self, since=0):
        """(code, register) of every emergency since a place in what was seen."""
        can_id = 0x080 + self.node_id
        return [(int.from_bytes(f.data[:2], "little"), f.data[2]) for f in self.port.seen[since:] if f.can_id == can_id]

    def await_emergency(self, mark, seconds=1.0):
        """Error code of the next emergency after a place, or None."""
        heard = self.port.expect(0x080 + self.node_id, seconds, mark)
        return None if heard is None else int.from_bytes(heard.data[:2], "little")

    def error_control(self, since=0):
        """The bytes of the node's error control messages: 00 is the boot-up."""
        return [frame.data for frame in self.port.seen[since:] if frame.can_id == 0x700 + self.node_id]

    def beat(self, period_ms=BEAT_MS):
        """Let it send heartbeats."""
        self.set(0x1017, 0, period_ms)

    def state(self, beats=2, wanted=None):
        """The NMT state, by a heartbeat that was sent after this call: not the next, which may be on its way already.

        Of a real device later heartbeats count too where the state is not the wanted one: a computer may be slow.
        """
        self.port.pump(0.0)
        patience = (beats + 0.5 if self.is_emulated else 25) * BEAT_MS / 1000
        heard, can_id, deadline = [], 0x700 + self.node_id, self.port.now_s + patience
        mark = len(self.port.seen)
        while (len(heard) < beats or (wanted is not None and heard[-1] != wanted)) and (left := deadline - self.port.now_s) > 0.0:
            self.port.pump(left)
            heard = [frame.data[0] & 0x7F for frame in self.port.seen[mark:] if frame.can_id == can_id]
        return heard[-1] if heard else None

    def reset(self, command=RESET_NODE):
        """Reset, and wait for the boot-up message."""
        mark = len(self.port.seen)
        self.nmt(command)
        heard = self.port.expect(0x700 + self.node_id, self.boot_s, mark, b"\0")
        assert heard is not None, f"no boot-up message, one byte of 0, within {self.boot_s} s"

    # -- back to how it was

    def snapshot(self):
        """What all entries hold that a test may change, by place."""
        held = {}
        for (index, subindex), variable in self.entries.items():
            if variable.readable and variable.writable and index not in COMMAND_OBJECTS and index != 0x1003:
                data = self.sdo.upload(index, subindex)
                if not isinstance(data, Abort):
                    held[index, subindex] = data
        return held

    def put_back(self, held):
        """Reset, and write what differs from what was there before; note what cannot be."""
        self.reset()
        now = self.snapshot()
        differing = {place: data for place, data in held.items() if now.get(place) != data}
        records = {0x1400 + (i & 0x1FF) + (0x400 if i >= 0x1800 else 0) for i, _ in differing if 0x1400 <= i < 0x1C00}
        for record in records:
            self.put_back_pdo(record, held)
        for (index, subindex), data in differing.items():
            if 0x1400 <= index < 0x1C00:
                continue
            answer = self.sdo.download(index, subindex, data)
            if answer is not None:
                self.not_restored_words.append(f"{index:04X}h:{subindex:02X}h = {data.hex(' ')}: {answer!r}")

    def put_back_pdo(self, record, held):
        """Bring one PDO back, in the standard's order (CiA 301, 7.5.2.36 and 7.5.2.38)."""
        mapping, cob_id = record + 0x200, int.from_bytes(held.get((record, 1), bytes(4)), "little")
        steps = [(record, 1, (cob_id | 1 << 31).to_bytes(4, "little")), (mapping, 0, b"\0")]
        count = held.get((mapping, 0), b"\0")
        steps += [(mapping, s, held[mapping, s]) for s in range(1, count[0] + 1) if (mapping, s) in held]
        steps += [(mapping, 0, count)]
        steps += [(record, s, held[record, s]) for s in (2, 3, 5, 6) if (record, s) in held]
        steps += [(record, 1, cob_id.to_bytes(4, "little"))]
        for index, subindex, data in steps:
            answer = self.sdo.download(index, subindex, data) if self.has(index, subindex) else None
            if answer is not None and answer != DEVICE_STATE:
                self.not_restored_words.append(f"{index:04X}h:{subindex:02X}h = {data.hex(' ')}: {answer!r}")


def variables(dictionary):
    """Every entry of an EDS, dummies left out."""
    for index, thing in dictionary.items():
        if index >= 0x1000:
            yield from [thing] if isinstance(thing, ODVariable) else thing.values()


def default_bytes(variable, node_id):
    """The default as it crosses the bus, or None where the EDS states none or no fixed type."""
    if variable.default is None or variable.data_type not in set(DataType):
        return None
    try:
        return encode(DataType(variable.data_type), variable.default)
    except ValueError:
        return None
