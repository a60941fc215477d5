"""The node as a whole: its contract with the caller, and any bytes whatever."""

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drive_profiles.standard.cia301 import NmtState
from drive_profiles.standard.cia305 import UNCONFIGURED
from hil.can.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, Frame
from plant_emulator.slave.dictionary import Dictionary
from plant_emulator.slave.node import Slave, SlaveNode
from plant_emulator.slave.objects import PdoDefault, communication_entries

MS = 1_000_000
PDOS = {
    "rpdos": [PdoDefault(((0x6040, 0, 16), (0x607A, 0, 32)), 1), PdoDefault(((0x2000, 0, 16), (0x2003, 1, 32)))],
    "tpdos": [PdoDefault(((0x6041, 0, 16), (0x6064, 0, 32)), 1), PdoDefault(((0x6077, 0, 16),), 255, 10, 5)],
}
GUARD = 0x705 | CAN_RTR_FLAG
IDS = [0x000, 0x080, 0x100, 0x205, 0x305, 0x605, 0x701, 0x702, 0x085, 0x185, 0x585, 0x705, GUARD, 0x7E5, 0x7FF]
ADDRESSES = [
    0x1000,
    0x1003,
    0x1005,
    0x1008,
    0x100C,
    0x100D,
    0x1012,
    0x1014,
    0x1015,
    0x1016,
    0x1017,
    0x1400,
    0x1600,
    0x1800,
    0x1A00,
    0x2000,
    0x2001,
    0x2004,
]

nmt_frames = st.builds(
    lambda c, n: Frame(0, bytes((c, n))), st.sampled_from([1, 2, 128, 129, 130, 7]), st.sampled_from([0, 5, 6])
)
sdo_frames = st.builds(
    lambda first, index, sub, rest: Frame(0x605, bytes((first, index & 0xFF, index >> 8, sub)) + rest),
    st.integers(0, 255),
    st.sampled_from(ADDRESSES),
    st.integers(0, 9),
    st.binary(min_size=4, max_size=4),
)
lss_frames = st.builds(
    lambda service, first: Frame(0x7E5, bytes((service, first)) + bytes(6)),
    st.sampled_from([0x04, 0x11, 0x17, 0x4C, 0x5E]),
    st.sampled_from([0, 1, 5, 255]),
)
any_frames = st.builds(Frame, st.sampled_from(IDS) | st.integers(0, 0xFFFFFFFF), st.binary(max_size=8))
pauses = st.integers(0, 20 * MS) | st.just(6000 * MS)
steps = st.lists(st.tuples(nmt_frames | sdo_frames | any_frames, pauses), max_size=60)
wild_steps = st.lists(
    st.tuples(
        nmt_frames | sdo_frames | lss_frames | any_frames,
        pauses,
        st.sampled_from(["", "", "", "fault", "clear", "power", "bus"]),
    ),
    max_size=40,
)


@pytest.mark.ci
@settings(max_examples=150)
@given(steps)
@example([(Frame(0x605, b"\x20\x04\x20\x00\x00\x00\x00\x00"), 0)] + [(Frame(0x605, bytes(8)), 0)] * 3)
def test_any_frames_at_any_times_make_no_exception_and_each_sdo_request_gets_its_answer(make_bench, steps):
    """Block transfers have silences and bursts, which the tests of the SDO server know; no request of theirs is judged here."""
    bench = make_bench(**PDOS)
    has_blocks = False
    for frame, pause in steps:
        bench.now += pause
        for sent in bench.slave.advance(bench.now):
            assert len(sent.data) <= 8
        hears_sdo = bench.slave.nmt_state in {NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL}
        is_sdo = frame.can_id == 0x605 and len(frame.data) == 8
        has_blocks |= is_sdo and frame.data[0] >> 5 in {5, 6}
        answers = [f for f in bench.slave.receive(frame, bench.now) if f.can_id == 0x585]
        if has_blocks:
            assert len(answers) <= 128
        else:
            assert len(answers) == (hears_sdo and is_sdo and frame.data[0] >> 5 != 4)
        assert all(len(answer.data) == 8 for answer in answers)
        assert all(server.buffered_bytes <= 1030 for server in bench.slave._sdo.servers.values())
        due = bench.slave.due
        assert due is None or due > bench.now
        assert bench.slave.take_frames() == []


@pytest.mark.ci
@settings(max_examples=100)
@given(wild_steps)
def test_whatever_happens_each_reset_has_one_boot_up_message_and_no_queue_grows(make_bench, steps):
    bench = make_bench(**PDOS)
    slave, resets, sent = bench.slave, [], []
    slave.on_reset = lambda kind: resets.append(slave.node_id)
    for number, (frame, pause, event) in enumerate(steps):
        bench.now += pause
        resets.clear()
        sent = slave.advance(bench.now)
        sent += slave.receive(frame, bench.now)
        match event:
            case "fault":
                slave.emergencies.raise_cause(f"fault {number}", 0xFF00)
            case "clear":
                slave.emergencies.clear_cause(f"fault {number - 1}")
            case "bus":
                slave.bus_off()
                slave.bus_recovered()
            case "power":
                sent += slave.power_on(bench.now)
        sent += slave.take_frames()
        boots = [f.can_id for f in sent if 0x700 < f.can_id <= 0x77F and f.data == b"\x00"]
        assert boots == [0x700 + node_id for node_id in resets if node_id != UNCONFIGURED]
        assert len(slave.emergencies._waiting) <= 8
        assert len(sent) < 200
        due = slave.due
        assert due is None or due > bench.now


class Around(SlaveNode):
    """A node that adds nothing to its slave."""

    def __init__(self, slave):
        self.slave = slave


@settings(max_examples=20)
@given(steps)
def test_a_node_around_a_slave_does_as_the_slave_does(make_bench, steps):
    bare, around = make_bench(**PDOS), Around(make_bench(**PDOS).slave)
    now = bare.now
    for frame, pause in steps:
        now += pause
        assert around.advance(now) == bare.slave.advance(now)
        assert around.slave.receive(frame, now) == bare.slave.receive(frame, now)
        assert (around.node_id, around.slave.due) == (bare.slave.node_id, bare.slave.due)


@settings(max_examples=50)
@given(steps)
def test_equal_inputs_give_equal_outputs(make_bench, steps):
    def run():
        bench = make_bench(**PDOS)
        sent = []
        for frame, pause in steps:
            bench.now += pause
            sent += bench.slave.receive(frame, bench.now)
        return sent

    assert run() == run()


@pytest.mark.parametrize("flag", [CAN_EFF_FLAG, CAN_RTR_FLAG, CAN_ERR_FLAG])
@pytest.mark.parametrize("can_id", [0x000, 0x080, 0x205, 0x605, 0x706])
def test_extended_remote_and_error_frames_are_ignored(running, flag, can_id):
    data = b"\x81\x00" if can_id == 0 else bytes(8)
    assert running.send(can_id | flag, data) == []
    assert running.slave.nmt_state is NmtState.OPERATIONAL


def test_frames_of_other_nodes_are_ignored(running):
    for can_id in (0x606, 0x586, 0x206, 0x186, 0x706, 0x706 | CAN_RTR_FLAG, 0x086, 0x100):
        assert running.send(can_id, bytes(8)) == []


def test_time_that_goes_back_is_the_callers_mistake(bench):
    bench.slave.advance(10)
    for call in (
        lambda: bench.slave.advance(9),
        lambda: bench.slave.receive(Frame(0x80, b""), 9),
        lambda: bench.slave.power_on(9),
    ):
        with pytest.raises(ValueError, match="time went back"):
            call()
    assert bench.slave.advance(10) == []


@pytest.mark.parametrize("node_id", [0, 128, 254, 256, -1])
def test_a_node_id_out_of_range_is_refused(make_entries, node_id):
    with pytest.raises(ValueError, match="1 to 127"):
        Slave(node_id, Dictionary(make_entries()))


def test_a_dictionary_without_the_communication_entries_is_refused():
    entries = communication_entries(device_type=0, name="x")
    with pytest.raises(KeyError, match="1014h"):
        Slave(1, Dictionary([entry for entry in entries if entry.index != 0x1014]))


def test_a_node_without_pdos_is_a_node(make_bench):
    bench = make_bench(entries=communication_entries(device_type=0x194, name="Sensor"))
    assert bench.start() == []
    assert bench.sync() == []
    assert bench.read(0x1000) == b"\x94\x01\x00\x00"
    assert bench.read(0x1008) == b"Sensor"


@pytest.mark.parametrize("node_id", [1, 5, 127])
def test_the_identifiers_follow_the_node_id(make_bench, synchronous, node_id):
    bench = make_bench(node_id=node_id, **synchronous)
    assert bench.boot == [(0x700 + node_id, b"\x00")]
    bench.nmt(1, node_id)
    assert [frame.can_id for frame in bench.sync()] == [0x180 + node_id]
    bench.slave.emergencies.raise_cause("x", 0x1000)
    assert [frame.can_id for frame in bench.slave.take_frames()] == [0x080 + node_id]


def test_a_new_power_on_begins_anew(running):
    running.write_value(0x2000, 0, 77)
    running.slave.emergencies.raise_cause("x", 0x1000)
    running.now = 10 * MS
    assert running.slave.power_on(running.now) == [(0x705, b"\x00")]
    assert running.slave.nmt_state is NmtState.PRE_OPERATIONAL
    assert running.dictionary.get(0x2000) == 10
    assert running.slave.emergencies.causes == ()


def test_the_bounds_of_the_sdo_server_are_the_owners(make_bench):
    bench = make_bench(slave={"sdo_max_bytes": 10, "sdo_timeout_ns": 7 * MS})
    assert bench.write(0x2004, 0, bytes(10)) is None
    assert bench.write(0x2004, 0, bytes(11)).name == "OUT_OF_MEMORY"
    bench.request(0x40, 0x08, 0x10, 0)
    assert [(time, frame.data[:1]) for time, frame in bench.wait(10)] == [(7 * MS, b"\x80")]


# -- what a caller may rely on who does not give it every frame --------------------------------------------------------


def told(slave):
    calls = []
    slave.on_routes, slave.on_due = (lambda: calls.append("routes")), (lambda: calls.append("due"))
    return calls


def test_it_listens_to_what_its_state_and_its_parameters_say(make_bench):
    bench = make_bench(**PDOS)
    slave = bench.slave
    assert [can_id for can_id in range(0x800) if slave.listens(can_id)] == [0x000, 0x080, 0x100, 0x605, 0x7E5]
    calls = told(slave)
    slave.receive(Frame(0, b"\x01\x00"), slave.due or 0)
    assert "routes" in calls
    assert [can_id for can_id in range(0x800) if slave.listens(can_id)] == [0x000, 0x080, 0x100, 0x205, 0x305, 0x605]
    calls.clear()
    for cob_id in (0x8000_0205, 0x234):
        slave.receive(Frame(0x605, b"\x23\x00\x14\x01" + cob_id.to_bytes(4, "little")), 0)
    assert "routes" in calls
    assert slave.listens(0x234)
    assert not slave.listens(0x205)
    calls.clear()
    slave.receive(Frame(0, b"\x02\x00"), 0)
    assert "routes" in calls
    assert [can_id for can_id in range(0x800) if slave.listens(can_id)] == [0x000, 0x7E5]


def test_it_tells_when_its_due_is_another(make_bench):
    slave = make_bench().slave
    calls = told(slave)
    slave.receive(Frame(0x605, b"\x2b\x17\x10\x00\xc8\0\0\0"), 0)
    assert "routes" in calls  # heartbeats begin, so that node guarding ends
    calls.clear()
    slave.receive(Frame(0x605, b"\x2b\x17\x10\x00\x64\0\0\0"), 0)
    assert calls == ["due"]
    assert slave.due == 100 * MS
    calls.clear()
    slave.receive(Frame(0x605, b"\x40\x17\x10\x00\0\0\0\0"), 1)
    slave.receive(Frame(0x080, b""), 2)
    assert calls == []
    slave.emergencies.raise_cause("owner", 0x5000)
    assert calls == ["due"]
    assert slave.due == 2


def test_a_list_of_answers_is_the_callers(make_bench):
    slave = make_bench().slave
    first = slave.receive(Frame(0x605, b"\x40\x00\x10\x00\0\0\0\0"), 0)
    kept = list(first)
    slave.receive(Frame(0x605, b"\x40\x17\x10\x00\0\0\0\0"), 0)
    assert first == kept


# -- what else may happen to a node ------------------------------------------------------------------------------------


def test_a_node_that_starts_by_itself_is_operational_after_its_boot_up_message(make_bench):
    bench = make_bench(slave={"autostart": True}, **PDOS)
    assert bench.boot[0] == (0x705, b"\x00")
    assert bench.slave.nmt_state is NmtState.OPERATIONAL
    seen = []
    bench.slave.on_nmt = lambda old, new: seen.append(new)
    assert (0x705, b"\x00") in bench.nmt(0x82)
    assert seen == [NmtState.INITIALISING, NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL]


@pytest.mark.parametrize(("behaviour", "after"), [(0, "PRE_OPERATIONAL"), (1, "OPERATIONAL"), (2, "STOPPED")])
def test_a_bus_that_is_off_leads_where_1029h_says_and_its_return_is_told(running, behaviour, after):
    lost = []
    running.slave.on_heartbeat_lost = lost.append
    running.write_value(0x1029, 1, behaviour)
    running.slave.bus_off()
    assert lost == [0]
    assert running.slave.nmt_state is NmtState[after]
    running.slave.bus_recovered()
    told = [(0x085, b"\x40\x81\x11" + bytes(5)), (0x085, bytes(8))]
    assert running.slave.take_frames() == ([] if after == "STOPPED" else told)
    assert running.dictionary.get(0x1003, 1) == 0x8140


def test_without_1029h_a_communication_error_leads_to_pre_operational(make_bench, make_entries):
    bench = make_bench(entries=[entry for entry in make_entries() if entry.index != 0x1029])
    bench.start()
    bench.slave.bus_off()
    assert bench.slave.nmt_state is NmtState.PRE_OPERATIONAL
