"""In which order objects are written: PDOs by CiA 301's rule, held against a model of it and against a slave that enforces it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drive_profiles.parameter_set.steps import pdo_of, steps, support
from drive_profiles.standard.cia301 import DataType
from plant_emulator.slave.dictionary import Access, Dictionary, Entry, SdoAbort
from plant_emulator.slave.node import Slave
from plant_emulator.slave.objects import PdoDefault, communication_entries, pdo_entries

INVALID = 1 << 31
RECORDS = (0x1400, 0x1403, 0x1800, 0x1803)
U8, U16, U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32


class BrokenRuleError(AssertionError):
    """A write that a device may refuse."""


class Model:
    """One device's PDOs by CiA 301, 7.5.2.35 to 7.5.2.38, and nothing else; written from the standard, not from our code.

    - bits 0 to 29 of the COB-ID do not change while the PDO exists (bit 31 is 0)
    - inhibit time and SYNC start value do not change while the PDO exists
    - the number of mapped objects changes only while the PDO does not exist, and from n to m only by way of 0
    - a mapping entry is written only while the PDO does not exist and the number is 0

    Args:
        held: What it holds.
        forgets: Whether it clears the mapping entries when the number becomes 0, as some devices do.
    """

    def __init__(self, held, *, forgets=False):
        self.held = dict(held)
        self.forgets = forgets
        self.written = []

    def write(self, place, data):
        index, subindex = place
        self.written.append(place)
        is_communication = index & 0xFE00 in {0x1400, 0x1800} and index < 0x1A00
        is_mapping = 0x1600 <= index < 0x1800 or 0x1A00 <= index < 0x1C00
        record = index if is_communication else index - 0x200
        if is_communication or is_mapping:
            cob_id = int.from_bytes(self.held[record, 1], "little")
            exists = not cob_id & INVALID
            if is_mapping and exists:
                raise BrokenRuleError(f"{index:04X}:{subindex} while the PDO exists")
            if is_mapping and subindex and self.held[index, 0] != b"\0":
                raise BrokenRuleError(f"{index:04X}:{subindex} while the number of mapped objects is not 0")
            if is_mapping and not subindex and data != b"\0" and self.held[index, 0] != b"\0":
                raise BrokenRuleError(f"{index:04X}:0 from a number to another, not by way of 0")
            new = int.from_bytes(data, "little")
            if is_communication and subindex == 1 and exists and not new & INVALID and new != cob_id:
                raise BrokenRuleError(f"{index:04X}:1 to another identifier while the PDO exists")
            if is_communication and subindex in {3, 6} and exists:
                raise BrokenRuleError(f"{index:04X}:{subindex} while the PDO exists")
            if is_mapping and not subindex and data == b"\0" and self.forgets:
                self.held |= {(index, position): bytes(4) for position in range(1, 9) if (index, position) in self.held}
        self.held[place] = data


def test_the_model_is_as_strict_as_the_standard():
    """Else the tests below would say nothing."""
    valid = {(0x1400, 1): bytes.fromhex("05020000"), (0x1400, 3): b"\0\0", (0x1600, 0): b"\1", (0x1600, 1): b"\0\0\0\0"}
    invalid = {**valid, (0x1400, 1): bytes.fromhex("05020080")}
    for held, place, data in (
        (valid, (0x1400, 1), bytes.fromhex("06020000")),
        (valid, (0x1400, 3), b"\1\0"),
        (valid, (0x1600, 0), b"\0"),
        (valid, (0x1600, 1), b"\1\0\0\0"),
        (invalid, (0x1600, 1), b"\1\0\0\0"),
        (invalid, (0x1600, 0), b"\2"),
    ):
        with pytest.raises(BrokenRuleError):
            Model(held).write(place, data)
    for held, place, data in (
        (valid, (0x1400, 1), bytes.fromhex("05020080")),
        (invalid, (0x1400, 1), bytes.fromhex("06020000")),
        (invalid, (0x1600, 0), b"\0"),
        ({**invalid, (0x1600, 0): b"\0"}, (0x1600, 1), b"\1\0\0\0"),
    ):
        Model(held).write(place, data)


def word(value, length=4):
    return value.to_bytes(length, "little")


@st.composite
def pdos(draw):
    """Everything that four PDOs hold, with identifiers and mappings of any kind."""
    held = {}
    for record in RECORDS:
        can_id = draw(st.sampled_from([0x181, 0x201, 0x385, 0x40000205]))
        held[record, 1] = word(can_id | draw(st.sampled_from([0, INVALID])))
        held[record, 2] = word(draw(st.sampled_from([0, 1, 254, 255])), 1)
        held[record, 3] = word(draw(st.integers(0, 2)), 2)
        held[record, 5] = word(draw(st.integers(0, 2)), 2)
        held[record + 0x200, 0] = word(draw(st.integers(0, 4)), 1)
        for position in range(1, 5):
            held[record + 0x200, position] = word(draw(st.sampled_from([0, 0x60400010, 0x60410010, 0x607A0020])))
    for place in ((0x2100, 1), (0x2101, 1), (0x6072, 0)):
        held[place] = word(draw(st.integers(0, 2)), 2)
    return held


def executed(goal, held, **how):
    model = Model(held, **how)
    for place, data in steps(goal, held):
        model.write(place, data)
    return model


@given(pdos(), pdos())
def test_any_configuration_becomes_any_other_without_breaking_the_rule(old, new):
    assert executed(new, old).held == new


@pytest.mark.ci
@given(pdos(), pdos(), st.data())
def test_a_part_of_a_configuration_is_changed_and_the_rest_stays_as_it_is(old, new, data):
    chosen = data.draw(st.sets(st.sampled_from(sorted(new))))
    goal = {place: new[place] for place in new if place in chosen}
    known = {place: old[place] for place in {*goal, *support(goal)}}  # steps must not ask for more than that
    model = Model(old)
    for place, value in steps(goal, known):
        model.write(place, value)
    assert model.held == {**old, **goal}


@given(pdos(), pdos())
def test_a_device_that_forgets_its_mapping_with_the_number_ends_with_the_objects_that_count(old, new):
    held = executed(new, old, forgets=True).held
    for place, data in new.items():
        counted = place[1] <= new[place[0], 0][0] if pdo_of(place) == place[0] - 0x200 and place[1] else True
        assert held[place] == data or not counted


@given(pdos())
def test_where_everything_is_there_already_nothing_is_written(held):
    assert steps(held, held) == []


@pytest.mark.ci
@given(pdos(), pdos())
def test_what_is_no_pdo_comes_first_once_each_and_in_the_order_of_the_set(old, new):
    found = [place for place, _ in steps(new, old)]
    others = [place for place in new if pdo_of(place) is None and new[place] != old[place]]
    assert found[: len(others)] == others
    assert all(pdo_of(place) is not None for place in found[len(others) :])


@pytest.mark.ci
@given(pdos(), pdos(), st.integers(0))
def test_a_pdo_does_not_exist_while_it_is_changed_and_a_run_that_is_cut_can_be_gone_back_from(old, new, at):
    forth = steps(new, old)
    model = Model(old)
    for place, data in forth[: at % (len(forth) + 1)]:
        model.write(place, data)
    for place, data in steps(old, dict(model.held)):
        model.write(place, data)
    assert model.held == old


@pytest.mark.ci
@given(pdos(), pdos())
def test_a_pdo_that_is_as_it_shall_be_is_not_touched(old, new):
    written = {pdo_of(place) for place, _ in steps(new, old)}
    for record in RECORDS:
        same = all(new[place] == old[place] for place in new if pdo_of(place) == record)
        assert (record in written) == (not same)


def test_the_procedure_is_the_standards():
    old = {
        (0x1401, 1): word(0x301),
        (0x1401, 2): b"\xff",
        (0x1601, 0): b"\1",
        (0x1601, 1): word(0x60400010),
        (0x1601, 2): word(0),
    }
    new = {(0x1401, 1): word(0x301), (0x1401, 2): b"\1", (0x1601, 0): b"\2", (0x1601, 1): word(0x60400010),
           (0x1601, 2): word(0x607A0020), (0x2100, 1): b"\1"}  # fmt: skip
    assert steps(new, {**old, (0x2100, 1): b"\0"}) == [
        ((0x2100, 1), b"\1"),
        ((0x1401, 1), word(0x301 | INVALID)),
        ((0x1601, 0), b"\0"),
        ((0x1601, 1), word(0x60400010)),
        ((0x1601, 2), word(0x607A0020)),
        ((0x1601, 0), b"\2"),
        ((0x1401, 2), b"\1"),
        ((0x1401, 1), word(0x301)),
    ]


def test_a_pdo_that_does_not_exist_is_not_made_invalid_once_more():
    held = {(0x1800, 1): word(0x181 | INVALID), (0x1800, 2): b"\xff", (0x1A00, 0): b"\0"}
    goal = {(0x1800, 1): word(0x185), (0x1800, 2): b"\1"}
    assert steps(goal, held) == [((0x1800, 2), b"\1"), ((0x1800, 1), word(0x185))]
    assert steps({(0x1800, 2): b"\1"}, held) == [((0x1800, 2), b"\1")]


@pytest.mark.parametrize(
    ("place", "record"),
    [((0x1400, 1), 0x1400), ((0x15FF, 2), 0x15FF), ((0x1600, 0), 0x1400), ((0x17FF, 8), 0x15FF), ((0x1800, 1), 0x1800),
     ((0x1A00, 0), 0x1800), ((0x1BFF, 1), 0x19FF), ((0x13FF, 0), None), ((0x1C00, 0), None), ((0x6040, 0), None)],
)  # fmt: skip
def test_an_object_belongs_to_the_pdo_of_its_number(place, record):
    assert pdo_of(place) == record


def test_what_must_be_known_of_a_pdo_is_whether_it_exists_and_how_much_it_carries():
    assert support([(0x1600, 3), (0x1801, 2), (0x6040, 0)]) == {(0x1400, 1), (0x1600, 0), (0x1801, 1), (0x1A01, 0)}
    assert support([(0x6040, 0)]) == set()


@given(st.binary(max_size=9), st.binary(max_size=3), st.binary(max_size=5))
def test_no_bytes_of_a_device_make_it_raise(cob_id, number, mapped):
    held = {(0x1400, 1): cob_id, (0x1600, 0): number, (0x1600, 1): mapped}
    for goal in ({(0x1600, 1): word(0x60400010)}, {(0x1600, 0): b"\1"}, {(0x1400, 1): word(0x201)}):
        assert all(isinstance(data, bytes) for _, data in steps(goal, held))


# The project's own slave, which enforces the rule with SDO aborts

OBJECTS = (
    Entry(0x6040, 0, "Control word", U16, Access.RW, 0, mappable=True),
    Entry(0x6041, 0, "Status word", U16, Access.RO, 0, mappable=True),
    Entry(0x6060, 0, "Mode", U8, Access.RW, 0, mappable=True),
    Entry(0x607A, 0, "Target position", U32, Access.RW, 0, mappable=True),
    Entry(0x6064, 0, "Position", U32, Access.RO, 0, mappable=True),
)
RPDO_MAPPABLE = (0x60400010, 0x60600008, 0x607A0020)
TPDO_MAPPABLE = (0x60410010, 0x60640020, 0x60600008)
SLAVE_RECORDS = tuple(base + number for base in (0x1400, 0x1800) for number in range(4))


def slave():
    entries = [
        *communication_entries(device_type=0, name="Device", vendor_id=1, product_code=2, revision=3, serial_number=4),
        *OBJECTS,
        *pdo_entries(
            rpdos=(PdoDefault(((0x6040, 0, 16), (0x607A, 0, 32)), 1), PdoDefault(((0x6060, 0, 8),))),
            tpdos=(PdoDefault(((0x6041, 0, 16), (0x6064, 0, 32)), 1), PdoDefault(((0x6041, 0, 16),), 255, 10, 5)),
        ),
    ]
    return Slave(5, Dictionary(entries))


def configuration_of(dictionary):
    places = [(entry.index, entry.subindex) for entry in dictionary if pdo_of((entry.index, entry.subindex)) is not None]
    return {place: dictionary.read(*place) for place in places if place[1] or place[0] != pdo_of(place)}


@st.composite
def possible(draw):
    """A configuration that the slave can take: mappable objects, at most 8 bytes, identifiers that are free."""
    goal = {}
    for number, record in enumerate(SLAVE_RECORDS):
        is_transmit = record >= 0x1800
        mapped = draw(st.lists(st.sampled_from(TPDO_MAPPABLE if is_transmit else RPDO_MAPPABLE), max_size=3))
        while sum(value & 0xFF for value in mapped) > 64:
            mapped.pop()
        unused = draw(st.sampled_from([0, 0x60600008]))
        goal[record, 1] = word(0x190 + 0x10 * number + draw(st.integers(0, 9)) | draw(st.sampled_from([0, INVALID])))
        goal[record, 2] = word(draw(st.sampled_from([0, 1, 240, 254, 255])), 1)
        if is_transmit:
            goal[record, 3] = word(draw(st.integers(0, 3)), 2)
            goal[record, 6] = word(draw(st.integers(0, 3)), 1)
        goal[record, 5] = word(draw(st.integers(0, 3)), 2)
        goal[record + 0x200, 0] = word(len(mapped), 1)
        values = [*mapped, *[unused] * (8 - len(mapped))]
        goal |= {(record + 0x200, position): word(value) for position, value in enumerate(values, 1)}
    return goal


@pytest.mark.slow
@given(possible(), possible())
def test_the_emulated_slave_accepts_every_step_forth_and_back(first, second):
    dictionary = slave().dictionary
    before = configuration_of(dictionary)
    for goal in (first, second, before):
        for place, data in steps(goal, configuration_of(dictionary)):
            dictionary.write(*place, data)  # SdoAbort would end the test
        assert configuration_of(dictionary) == goal


def test_the_emulated_slave_refuses_another_order():
    dictionary = slave().dictionary
    for place, data in (
        ((0x1600, 0), b"\0"),
        ((0x1600, 1), word(0x60600008)),
        ((0x1800, 1), word(0x199)),
        ((0x1800, 3), b"\1\0"),
    ):
        with pytest.raises(SdoAbort):
            dictionary.write(*place, data)
