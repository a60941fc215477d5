"""What is refused before anything is written: another device, another node's identifiers, a moving scale, an unknown state."""

import pytest

from drive_profiles import eds
from drive_profiles.device.device import Device
from drive_profiles.device.sdo import SdoPort
from drive_profiles.errors import DriveProfileError, NodeError, OutOfRangeError, RefusedError
from drive_profiles.family.catalogue import Catalogue
from drive_profiles.family.profile import VENDORS, Profile
from drive_profiles.parameter_set.parameters import Header, Item, ParameterSet
from drive_profiles.upload import fleet
from drive_profiles.upload.result import UploadOptions
from drive_profiles.upload.upload import Upload
from plant_emulator.slave.dictionary import SdoAbort
from tests.drive_profiles import upload_rig as rig
from tests.drive_profiles.world_bus import WorldBus, robot_with


def upload(device, parameter_set, tmp_path, **options):
    made = Upload(device, parameter_set, UploadOptions(journals=tmp_path / "j", **options))
    fleet.prepare([made])
    return fleet.run([made])[0]


def with_eds(bus, node, file, profile="emulated_drive"):
    line = bus.line(node)
    known = Catalogue(None if profile is None else Profile.load(profile), eds.load(VENDORS / file, node_id=node))
    return Device(SdoPort(node, line, 0.5), known, bus.nmt)


@pytest.fixture
def bus():
    return WorldBus(robot_with())


@pytest.mark.parametrize("name", ["elmo_gold", "harmonic_drive_yukondrive"])
def test_what_a_step_is_worth_does_not_change_in_the_set_that_counts_in_it(name, tmp_path):
    bus = WorldBus(robot_with(axis2={"profile": name}))
    device = bus.device(2, name)
    dictionary = bus.world.drives[2].slave.dictionary
    rated, limit = dictionary.get(0x6076, 0), dictionary.get(0x6072, 0)
    moved = {"rated_torque_nm": Item(value=2 * rated / 1000, unit="N·m")}
    header = {"serial_number": device.identify().serial_number}
    both = ParameterSet(
        header=header, limits={"torque_limit_nm": Item(value=0.25, unit="N·m")}, commissioning=moved
    )  # fmt: skip
    with pytest.raises(RefusedError, match=r"rated_torque_nm.*changes the scaling of .*torque_limit_nm.*a set of its own"):
        upload(device, both, tmp_path, allow_unverified=True)
    assert (dictionary.get(0x6076, 0), dictionary.get(0x6072, 0)) == (rated, limit)
    alone = ParameterSet(header=header, commissioning=moved)
    assert upload(device, alone, tmp_path, allow_unverified=True).kind == "done"
    assert dictionary.get(0x6076, 0) == 2 * rated


@pytest.mark.parametrize("name", ["elmo_gold", "harmonic_drive_yukondrive"])
def test_a_torque_is_not_counted_in_a_rating_of_zero(name, tmp_path):
    bus = WorldBus(robot_with(axis2={"profile": name}))
    dictionary = bus.world.drives[2].slave.dictionary
    dictionary.cell(0x6076, 0).value = 0
    before = dictionary.get(0x6072, 0)
    wanted = ParameterSet(limits={"torque_limit_nm": Item(value=0.25, unit="N·m")})
    with pytest.raises(OutOfRangeError, match="must be positive"):
        upload(bus.device(2, name), wanted, tmp_path, allow_unverified=True)
    assert dictionary.get(0x6072, 0) == before


def test_pdo_identifiers_of_another_node_are_refused(bus, tmp_path):
    own, other = (with_eds(bus, node, "emulated_drive.eds") for node in (2, 3))
    pulled = own.pull().model_copy(update={"commissioning": {}})
    assert pulled.header.node_id == 2
    dictionary = bus.world.drives[3].slave.dictionary
    before = [dictionary.get(0x1400 + n, 1) for n in range(2)]
    with pytest.raises(RefusedError, match=r"identifiers of node 2, but this is node 3; leave communication out"):
        upload(other, pulled, tmp_path, allow_unverified=True)
    rest = ("tuning", "limits")
    assert upload(other, pulled, tmp_path, allow_unverified=True, classes=rest, other_device=True).kind == "done"
    assert [dictionary.get(0x1400 + n, 1) for n in range(2)] == before
    assert upload(own, pulled, tmp_path, allow_unverified=True).kind == "done"


def test_the_eds_of_another_device_is_refused(bus, tmp_path):
    device = with_eds(bus, 5, "emulated_accelerometer.eds", profile=None)
    wanted = ParameterSet(communication={"0x1017": Item(value=200, type="UNSIGNED16")})
    with pytest.raises(NodeError, match=r"product .*emulated_accelerometer\.eds says"):
        upload(device, wanted, tmp_path)


def test_an_eds_that_contradicts_itself_does_not_make_the_right_device_a_wrong_one(bus, tmp_path):
    text = (VENDORS / "emulated_drive.eds").read_text().replace("ProductNumber=0x00000402", "ProductNumber=0x999")
    (tmp_path / "a.eds").write_text(text)
    known = Catalogue(Profile.load("emulated_drive"), eds.load(tmp_path / "a.eds", node_id=2))
    assert known.description.product_codes == (0x999, 0x402)
    device = Device(SdoPort(2, bus.line(2), 0.5), known, bus.nmt)
    assert upload(device, ParameterSet(tuning={"position_gain_per_s": Item(value=9, unit="1/s")}), tmp_path).kind == "done"


def test_a_serial_number_of_zero_is_none(bus, tmp_path):
    for node in (2, 3):
        bus.world.drives[node].slave.dictionary.cell(0x1018, 4).value = 0
    header = bus.device(2, "emulated_drive").pull().header
    wanted = ParameterSet(header=header, commissioning={"0x6065": Item(value=1000, type="UNSIGNED32")})
    with pytest.raises(RefusedError, match="commissioning values, and no serial number shows"):
        upload(bus.device(3, "emulated_drive"), wanted, tmp_path)


def refusing(code):
    def refuse():
        raise SdoAbort(code)

    return refuse


def test_a_drive_that_does_not_tell_its_state_is_not_written_to(bus, tmp_path):
    bus.world.drives[2].slave.dictionary.on_read(0x6041, 0, refusing(0x0800_0022))
    with pytest.raises(NodeError, match=r"its state cannot be read .*0x08000022"):
        upload(bus.device(2, "emulated_drive"), ParameterSet(tuning={"position_gain_per_s": Item(value=9, unit="1/s")}), tmp_path)


def test_a_device_that_is_no_drive_needs_no_state_but_does_not_hide_one(tmp_path):
    slave = rig.node(rig.OPERATION_ENABLED)
    slave.dictionary.on_read(0x6041, 0, refusing(0x0800_0022))
    with pytest.raises(NodeError, match="its state cannot be read"):
        rig.upload(slave, tmp_path, rig.wanted())
    slave = rig.node()
    slave.dictionary.on_read(0x6041, 0, refusing(0x0602_0000))
    assert rig.fleet.run([rig.upload(slave, tmp_path, rig.wanted())])[0].kind == "done"


def test_a_status_word_that_is_no_state_is_refused(tmp_path):
    with pytest.raises(NodeError, match="not a state of CiA 402"):
        rig.upload(rig.node(0xFFFF), tmp_path, rig.wanted())


def test_a_drive_that_is_enabled_while_the_user_thinks_is_not_written_to(tmp_path):
    slave = rig.node()
    before = rig.contents(slave)
    made = rig.upload(slave, tmp_path, rig.wanted())
    slave.dictionary.cell(0x6041, 0).value = rig.OPERATION_ENABLED
    with pytest.raises(NodeError, match="operation enabled"):
        rig.fleet.run([made])
    assert rig.contents(slave) == before
    assert not list(tmp_path.glob("*.jsonl"))


def test_values_that_change_while_the_user_thinks_are_not_written_over(tmp_path):
    slave = rig.node()
    made = rig.upload(slave, tmp_path, rig.wanted())
    slave.dictionary.cell(0x2003, 1).value = 55
    with pytest.raises(NodeError, match=r"2003:1 \(p3\) changed since they were read; start again"):
        rig.fleet.run([made])
    assert slave.dictionary.get(0x2003, 1) == 55
    assert slave.dictionary.get(0x2000, 1) == rig.old_value(0)


def test_another_device_that_answers_after_the_question_is_not_written_to(tmp_path):
    slave = rig.node()
    made = rig.upload(slave, tmp_path, rig.wanted())
    slave.dictionary.cell(0x1018, 4).value = 8
    with pytest.raises(DriveProfileError, match="another device answers now"):
        rig.fleet.run([made])
    assert slave.dictionary.get(0x2000, 1) == rig.old_value(0)


def test_values_made_of_facts_that_nobody_has_verified_are_refused_unless_asked(tmp_path):
    doubtful = rig.wanted().model_copy(update={"header": Header(unverified="the paper says so")})
    with pytest.raises(RefusedError, match=r"the paper says so\); give --allow-unverified"):
        rig.upload(rig.node(), tmp_path, doubtful)
    assert rig.upload(rig.node(), tmp_path, doubtful, allow_unverified=True).changes
