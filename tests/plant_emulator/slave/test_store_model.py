"""Whatever a master writes, stores, restores and resets, and whenever the supply fails: the dictionary is a simple model's."""

import struct

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from drive_profiles.standard.cia301 import DataType, NmtCommand, SdoAbortCode, encode
from hil.can.frame import Frame
from plant_emulator.drive.dictionary.manufacturer_objects import drive_entries
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.node import Slave
from plant_emulator.slave.store import GROUPS

NODE = 9
STORE_NS = 400_000_000
ADDRESSES = [(0x1017, 0), (0x1016, 1), (0x1029, 1), (0x2100, 1), (0x2101, 3), (0x2110, 2), (0x6065, 0), (0x607D, 1), (0x6085, 0)]
VOLATILE = [(0x607A, 0), (0x6060, 0), (0x60B0, 0)]
VALUES = {
    DataType.REAL32: st.sampled_from([1.0, 2.5, 300.0]),
    DataType.UNSIGNED8: st.integers(0, 2),
    DataType.INTEGER8: st.integers(0, 9),
    DataType.UNSIGNED16: st.integers(0, 60_000),
    DataType.UNSIGNED32: st.integers(0, 60_000),
    DataType.INTEGER32: st.integers(-1000, 1000),
}


class StoreMachine(RuleBasedStateMachine):
    """RAM, store and factory as three dictionaries; a storing is pending until its time is over."""

    def __init__(self):
        super().__init__()
        self.dictionary = Dictionary(drive_entries())
        self.slave = Slave(NODE, self.dictionary, store_time_ns=STORE_NS)
        self.now = 0
        self.slave.power_on(0)
        self.factory = {address: self.dictionary.get(*address) for address in ADDRESSES + VOLATILE}
        self.ram, self.stored, self.pending = dict(self.factory), {}, None

    def request(self, *data):
        frames = self.slave.receive(Frame(0x600 + NODE, bytes(data).ljust(8, b"\0")), self.now)
        return [frame.data for frame in frames if frame.can_id == 0x580 + NODE]

    @initialize()
    def starts_with_the_factory(self):
        assert self.slave.store.stored == {}

    @rule(data=st.data(), address=st.sampled_from(ADDRESSES + VOLATILE))
    def write(self, data, address):
        entry = self.dictionary.cell(*address).entry
        value = data.draw(VALUES[entry.data_type])
        raw = encode(entry.data_type, value)
        answers = self.request(0x23 | (4 - len(raw)) << 2, *struct.pack("<HB", *address), *raw)
        if self.pending is not None:
            assert answers == []
        elif answers[0][0] == 0x60:
            self.ram[address] = value

    @rule(group=st.integers(1, len(GROUPS)), fails=st.booleans())
    def save(self, group, fails):
        self.slave.store.fails = (fails and self.pending is None) or (self.pending is not None and self.slave.store.fails)
        answers = self.request(0x23, 0x10, 0x10, group, *b"save")
        assert answers == []
        if self.pending is None:
            indices = GROUPS[group - 1][1]
            values = {p: v for p, v in self.ram.items() if p[0] in indices and p not in VOLATILE}
            self.pending = self.now + STORE_NS, values, fails

    @rule(group=st.integers(1, len(GROUPS)))
    def restore(self, group):
        answers = self.request(0x23, 0x11, 0x10, group, *b"load")
        if self.pending is None:
            assert answers[0][0] == 0x60
            self.stored = {p: v for p, v in self.stored.items() if p[0] not in GROUPS[group - 1][1]}

    @rule(
        word=st.binary(min_size=4, max_size=4).filter(lambda word: word not in {b"save", b"load"}),
        index=st.sampled_from([0x10, 0x11]),
    )
    def wrong_signature(self, word, index):
        answers = self.request(0x23, index, 0x10, 1, *word)
        if self.pending is None:
            assert struct.unpack("<I", answers[0][4:])[0] == SdoAbortCode.NOT_STORED

    @rule(nanoseconds=st.sampled_from([1, STORE_NS // 2, STORE_NS - 1, STORE_NS]))
    def wait(self, nanoseconds):
        end, answers = self.now + nanoseconds, []
        while (due := self.slave.due) is not None and due <= end:
            self.now = max(self.now, due)
            answers += [f.data for f in self.slave.advance(self.now) if f.can_id == 0x580 + NODE]
        self.now = end
        if self.pending is not None and self.pending[0] <= end:
            _, values, fails = self.pending
            assert len(answers) == 1
            assert answers[0][0] == (0x80 if fails else 0x60)
            if not fails:
                self.stored |= values
            self.pending = None
        else:
            assert answers == []

    @rule()
    def power_cycle(self):
        self.pending = None
        self.slave.power_on(self.now)
        self.ram = self.factory | self.stored

    @rule()
    def reset_node(self):
        self.pending = None
        self.slave.receive(Frame(0, bytes((NmtCommand.RESET_NODE, NODE))), self.now)
        self.ram = self.factory | self.stored

    @rule()
    def reset_communication(self):
        self.pending = None
        self.slave.receive(Frame(0, bytes((NmtCommand.RESET_COMMUNICATION, NODE))), self.now)
        self.ram |= {p: v for p, v in (self.factory | self.stored).items() if p[0] < 0x2000}

    @invariant()
    def the_dictionary_is_the_model(self):
        assert {address: self.dictionary.cell(*address).value for address in self.ram} == self.ram

    @invariant()
    def the_store_is_the_model(self):
        kept = self.slave.store.stored
        assert {address: kept[address] for address in self.stored} == self.stored
        assert not set(kept) & set(VOLATILE)
        assert {address for address in kept if address in self.ram} == set(self.stored)


TestStore = pytest.mark.ci(StoreMachine.TestCase)
TestStore.settings = settings(max_examples=60, stateful_step_count=40)
