"""The `canopen` package as master on the local bus, by the wall clock: its services, and its CiA 402 node."""

import itertools
import time

import canopen
import pytest
from canopen.profiles.p402 import OperationMode

from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import VENDORS, Profile
from drive_profiles.parameter_set import formats
from drive_profiles.parameter_set.parameters import Item, ParameterSet
from drive_profiles.standard.cia402 import State
from drive_profiles.standard.units import Scaling
from plant_emulator.data_sheets import data_sheets
from tests.plant_emulator.bus.conftest import wait_for
from tests.strangers.conftest import forget_node_id

NODE = 3
LONG_TEXT = 0x2FF0
RESET_S = 5.0


@pytest.fixture
def served(start_served):
    return start_served(wall=True)


@pytest.fixture
def sheet(tmp_path):
    """The EDS file that `plant-emulator eds` writes for the drive."""
    [text] = [text for name, text in data_sheets().items() if "drive" in name]
    path = tmp_path / "drive.eds"
    path.write_text(text, encoding="ascii")
    return str(path)


@pytest.fixture
def network(served):
    network = canopen.Network()
    network.NOTIFIER_CYCLE = 0.05  # its thread is only joined so often
    network.connect(interface="hil_local", channel=served.path)
    yield network
    network.sync.stop()
    network.disconnect()


@pytest.fixture
def node(network, sheet):
    node = network.add_node(NODE, sheet)
    node.sdo.RESPONSE_TIMEOUT = 5.0  # its own 0.3 s are for a machine without other work
    return node


@pytest.fixture
def drive402(network, sheet):
    """A node of its CiA 402 profile, set up as its manual says, with TPDOs at each SYNC."""
    node = canopen.BaseNode402(NODE, sheet)
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 5.0
    for name in ("TIMEOUT_SWITCH_OP_MODE", "TIMEOUT_SWITCH_STATE_FINAL", "TIMEOUT_SWITCH_STATE_SINGLE", "TIMEOUT_CHECK_TPDO"):
        setattr(node, name, 5.0)
    node.nmt.state = "PRE-OPERATIONAL"
    node.tpdo.read()
    node.rpdo.read()
    for number, names in ((1, (0x6041, 0x6061)), (2, (0x6064, 0x606C))):
        node.tpdo[number].clear()
        for name in names:
            node.tpdo[number].add_variable(name)
        node.tpdo[number].trans_type = 1
        node.tpdo[number].enabled = True
    node.rpdo[1].clear()
    for name in (0x6040, 0x6060):
        node.rpdo[1].add_variable(name)
    node.rpdo[1].trans_type = 255
    node.rpdo[1].enabled = True
    node.pdo.save()
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    network.sync.start(0.01)
    return node


def rested(network, node):
    """Sends a heartbeat as node 112 once, which the drive then misses."""
    node.sdo[0x1016][1].raw = 112 << 16 | 100
    network.send_message(0x700 + 112, b"\x05")


# -- services ----------------------------------------------------------------------------------------------------------


def test_values_of_every_length_are_read_and_written(node, served):
    assert node.sdo[0x1000].raw == 0x0002_0192
    assert node.sdo["Manufacturer device name"].raw == "Emulated servo drive"
    node.sdo["Producer heartbeat time"].raw = 321
    assert node.sdo["Producer heartbeat time"].raw == 321
    assert node.sdo.upload(0x1017, 0) == b"\x41\x01"
    node.sdo.download(0x1017, 0, b"\x42\x01", force_segment=True)
    assert served.drive.slave.dictionary.get(0x1017) == 0x142


def test_what_cannot_be_written_is_aborted_with_the_standards_code(node):
    for place, data, code in (
        ((0x5FFF, 0), b"\0", 0x0602_0000),
        ((0x1018, 9), b"\0", 0x0609_0011),
        ((0x1000, 0), bytes(4), 0x0601_0002),
        ((0x1017, 0), bytes(3), 0x0607_0012),
        ((0x6060, 0), b"\x7f", 0x0609_0030),
    ):
        with pytest.raises(canopen.SdoAbortedError) as refused:
            node.sdo.download(*place, data)
        assert refused.value.code == code


@pytest.mark.ci
@pytest.mark.parametrize("size", [1, 7, 889, 1000])
def test_block_transfers_go_both_ways(node, size):
    text = b"0123456789abcdef" * 64
    with node.sdo.open(LONG_TEXT, 0, "wb", size=size, block_transfer=True) as file:
        file.write(text[:size])
    with node.sdo.open(LONG_TEXT, 0, "rb", block_transfer=True) as file:
        assert file.read() == text[:size]
    assert node.sdo.upload(LONG_TEXT, 0) == text[:size]


def test_a_block_upload_without_the_crc_is_given_too(node):
    with node.sdo.open(0x1008, 0, "rb", block_transfer=True, request_crc_support=False) as file:
        assert file.read() == b"Emulated servo drive"


def test_nmt_states_are_commanded_and_seen_in_the_heartbeat(node):
    node.sdo[0x1017].raw = 20
    for state in ("OPERATIONAL", "STOPPED", "PRE-OPERATIONAL"):
        node.nmt.state = state
        wait_for(lambda state=state: node.nmt.wait_for_heartbeat(RESET_S) == state)
    booted = []
    node.nmt.add_heartbeat_callback(booted.append)
    node.nmt.state = "RESET COMMUNICATION"
    wait_for(lambda: 0 in booted)
    assert node.sdo[0x1017].raw == 0


def test_node_guarding_is_answered_with_the_state_and_a_toggle(node, network):
    seen = []
    network.subscribe(0x700 + NODE, lambda _, data, __: seen.append(data[0]))
    node.nmt.start_node_guarding(0.02)
    wait_for(lambda: len(seen) > 4)
    node.nmt.stop_node_guarding()
    assert {state & 0x7F for state in seen} == {127}
    assert all(first ^ second == 0x80 for first, second in itertools.pairwise(seen))


def test_an_emergency_is_told_and_its_end_too(node, network):
    node.sdo[0x1029][1].raw = 1  # stay in the state
    rested(network, node)
    error = node.emcy.wait(0x8130, timeout=RESET_S)
    assert error.register & 0x11 == 0x11
    network.send_message(0x700 + 112, b"\x05")
    node.sdo[0x1016][1].raw = 0
    wait_for(lambda: node.emcy.log[-1].code == 0)
    assert node.emcy.active == []
    assert node.sdo[0x1003][1].raw & 0xFFFF == 0x8130


def test_parameters_are_stored_survive_a_reset_and_are_restored(node, network):
    def restart():
        booted = []
        node.nmt.add_heartbeat_callback(booted.append)
        node.nmt.state = "RESET"
        wait_for(lambda: 0 in booted)

    before = node.sdo[0x6083].raw
    node.sdo[0x6083].raw = before // 2
    node.store()
    restart()
    assert node.sdo[0x6083].raw == before // 2
    node.restore()
    restart()
    assert node.sdo[0x6083].raw == before
    with pytest.raises(canopen.SdoAbortedError):
        node.sdo.download(0x1010, 1, b"SAVE")


def test_pdos_are_saved_read_back_sent_and_received(node, network, served):
    node.nmt.state = "PRE-OPERATIONAL"
    node.tpdo.read()
    node.rpdo.read()
    heard, commanded = node.tpdo[4], node.rpdo[4]
    heard.clear()
    heard.add_variable(0x6064)
    heard.add_variable(0x6041)
    commanded.clear()
    commanded.add_variable(0x607A)
    for pdo, base, kind in ((heard, 0x480, 2), (commanded, 0x500, 255)):
        pdo.cob_id, pdo.trans_type, pdo.enabled = base + NODE, kind, True
        pdo.save()
    node.tpdo.read()
    assert [(variable.index, variable.length) for variable in node.tpdo[4]] == [(0x6064, 32), (0x6041, 16)]
    assert (node.tpdo[4].trans_type, node.tpdo[4].cob_id) == (2, 0x480 + NODE)
    node.nmt.state = "OPERATIONAL"
    times = []
    node.tpdo[4].add_callback(lambda pdo: times.append(pdo.timestamp))
    for _ in range(6):
        network.sync.transmit()
    wait_for(lambda: len(times) == 3)
    assert node.tpdo[4][0x6041].raw & 0x4F == 0x40
    commanded[0x607A].raw = 12_345
    commanded.transmit()
    wait_for(lambda: served.drive.slave.dictionary.get(0x607A) == 12_345)


def test_a_dcf_of_ours_is_loaded_and_every_value_is_there(network, sheet, tmp_path, served):
    catalogue = Catalogue(Profile.load("emulated_drive"))
    wanted = ParameterSet.model_validate(
        {"header": {"profile": "emulated_drive"},
         "tuning": {"position_gain_per_s": Item(value=21.5, unit="1/s"), "notch_1.zeta_rn": Item(value=0.028)},
         "limits": {"following_error_window_rad": Item(value=3.0, unit="rad")}}
    )  # fmt: skip
    writes = wanted.writes(catalogue, Scaling(131072, 2.367))
    path = tmp_path / "axis.dcf"
    formats.write(path, writes, VENDORS / "emulated_drive.eds", node_id=NODE)
    node = network.add_node(NODE, str(path))
    node.sdo.RESPONSE_TIMEOUT = 5.0
    node.nmt.state = "PRE-OPERATIONAL"
    node.load_configuration()
    assert len(writes) == 3
    for write in writes:
        assert node.sdo.upload(*write.address) == write.data
        assert served.drive.slave.dictionary.read(*write.address) == write.data


@pytest.mark.ci
def test_a_counted_sync_and_a_time_stamp_are_taken(node, network, served):
    node.sdo[0x1019].raw = 4
    node.nmt.state = "OPERATIONAL"
    for count in (1, 2, 3, 4, 1):
        network.sync.transmit(count)
    node.sdo[0x1012].raw = 0x8000_0100
    network.time.transmit(1_767_323_045.0)
    assert node.sdo[0x1000].raw == 0x0002_0192  # it has taken what came before
    assert served.drive.slave.time_of_day / 1e9 == pytest.approx(1_767_323_045 - 441_763_200, abs=5.0)
    assert node.emcy.log == []


@pytest.mark.slow
def test_its_fast_scan_finds_a_node_without_an_id(network, served):
    """128 questions, each zero bit answered, each one bit a time-out of the package."""
    dictionary = served.drive.slave.dictionary
    forget_node_id(served.join(), dictionary, NODE)
    wait_for(lambda: served.drive.node_id == 255)
    for network.lss.RESPONSE_TIMEOUT in (0.1, 0.4, 1.6):  # silence means a one: a busy machine may be late
        found, identity = network.lss.fast_scan()
        if found:
            break
    assert found
    assert identity == [dictionary.get(0x1018, subindex) for subindex in range(1, 5)]
    network.lss.configure_node_id(0x21)
    network.lss.send_switch_state_global(network.lss.WAITING_STATE)
    wait_for(lambda: served.drive.node_id == 0x21)


def test_a_node_selected_by_its_identity_is_asked_and_given_another_id(network, served):
    dictionary = served.drive.slave.dictionary
    identity = [dictionary.get(0x1018, subindex) for subindex in range(1, 5)]
    network.lss.RESPONSE_TIMEOUT = 5.0
    assert network.lss.send_switch_state_selective(*identity)
    assert network.lss.inquire_node_id() == NODE
    assert network.lss.inquire_lss_address(0x5D) == identity[3]
    network.lss.configure_node_id(0x22)
    network.lss.store_configuration()
    network.lss.send_switch_state_global(network.lss.WAITING_STATE)
    network.send_message(0x000, bytes((0x82, NODE)))
    wait_for(lambda: served.drive.node_id == 0x22)


# -- the CiA 402 node --------------------------------------------------------------------------------------------------


def test_its_state_machine_enables_and_disables_the_drive_by_pdo(drive402, served):
    drive402.op_mode = "PROFILED POSITION"
    assert drive402.op_mode == "PROFILED POSITION"
    drive402.state = "OPERATION ENABLED"
    assert served.drive.state is State.OPERATION_ENABLED
    drive402.sdo[0x607A].raw = 20_000
    drive402.controlword = 0x1F
    wait_for(lambda: abs(drive402.tpdo[2][0x6064].raw - 20_000) < 100)
    for state in ("SWITCHED ON", "READY TO SWITCH ON", "SWITCH ON DISABLED"):
        drive402.state = state
        assert served.drive.state.name == state.replace(" ", "_")


def test_its_quick_stop_is_a_quick_stop(drive402, served):
    drive402.op_mode = "PROFILED POSITION"
    drive402.sdo[0x605A].raw = 6  # the quick-stop ramp, and stay: what disable voltage never does
    drive402.state = "OPERATION ENABLED"
    drive402.state = "QUICK STOP ACTIVE"
    assert served.drive.state is State.QUICK_STOP_ACTIVE
    drive402.controlword = 0x00
    wait_for(lambda: drive402.state == "SWITCH ON DISABLED")


def test_its_quick_stop_ends_on_the_ramp_that_the_drive_is_told(drive402, served):
    states = []
    served.drive.on_state = lambda before, after: states.append((before, after))
    drive402.op_mode = "PROFILED VELOCITY"
    drive402.sdo[0x605A].raw = 2
    drive402.sdo[0x60FF].raw = 2 * 131072
    drive402.state = "OPERATION ENABLED"
    wait_for(lambda: drive402.tpdo[2][0x606C].raw > 131072)
    drive402.controlword = 0x02
    wait_for(lambda: drive402.state == "SWITCH ON DISABLED")
    ramp = [State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED]
    assert states[-2:] == list(itertools.pairwise(ramp))


@pytest.mark.slow
@pytest.mark.parametrize(
    "mode",
    ["PROFILED POSITION", "PROFILED VELOCITY", "PROFILED TORQUE", "HOMING", "INTERPOLATED POSITION",
     "CYCLIC SYNCHRONOUS POSITION", "CYCLIC SYNCHRONOUS VELOCITY", "CYCLIC SYNCHRONOUS TORQUE"],
)  # fmt: skip
def test_every_mode_is_told_supported_set_and_shown(drive402, served, mode):
    assert drive402.is_op_mode_supported(mode)
    drive402.op_mode = mode
    wait_for(lambda: drive402.op_mode == mode)
    drive402.state = "OPERATION ENABLED"
    assert served.drive.state is State.OPERATION_ENABLED
    assert drive402.sdo[0x6061].raw == OperationMode.NAME2CODE[mode]


def test_a_fault_is_seen_and_reset(drive402, network, served):
    drive402.op_mode = "PROFILED POSITION"
    drive402.state = "OPERATION ENABLED"
    drive402.sdo[0x1029][1].raw = 1
    drive402.sdo[0x6007].raw = 1  # a lost connection is a fault
    rested(network, drive402)
    wait_for(drive402.is_faulted)
    assert served.drive.state is State.FAULT
    drive402.sdo[0x1016][1].raw = 0
    drive402.reset_from_fault()
    assert served.drive.state is State.OPERATION_ENABLED


@pytest.mark.wall
def test_its_homing_is_carried_out(drive402):
    drive402.op_mode = "PROFILED POSITION"
    drive402.sdo[0x6098].raw = 37  # where it stands
    drive402.sdo[0x607C].raw = 50_000
    assert drive402.homing(timeout=20)
    assert drive402.is_homed(restore_op_mode=True)
    wait_for(lambda: abs(drive402.tpdo[2][0x6064].raw - 50_000) < 2_000)


@pytest.mark.wall
def test_a_velocity_is_reached_in_profile_velocity(drive402):
    drive402.op_mode = "PROFILED VELOCITY"
    drive402.state = "OPERATION ENABLED"
    drive402.sdo[0x60FF].raw = 50_000
    deadline = time.monotonic() + 10.0
    while abs(drive402.tpdo[2][0x606C].raw - 50_000) > 5_000:
        assert time.monotonic() < deadline, drive402.tpdo[2][0x606C].raw
        time.sleep(0.01)
    drive402.sdo[0x60FF].raw = 0
    wait_for(lambda: abs(drive402.tpdo[2][0x606C].raw) < 5_000)
