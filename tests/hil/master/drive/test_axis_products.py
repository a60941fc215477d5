"""The master takes a drive for the product that it is: its identity decides, and what the bench file names is held against it."""

import pytest

from drive_profiles.family.profile import VENDORS, Profile
from hil.bench.bench import load_bench
from hil.errors import NodeError, WrongIdentityError
from hil.master.drive.axis import DriveAxis, check_identity
from hil.master.drive.needs import ProfileGapsError
from plant_emulator.robots.robot import load_robot, with_drives
from tests.hil.master.drive.test_axis_units import RigNetwork
from tests.plant_emulator.rig import AXIS, Rig

PRODUCTS = ["trinamic_tmcm16xx/tmcm-1670", "trinamic_tmcm16xx/tmcm-1617", "nanotec_cl4e/cl4-e-2-12", "nanotec_cl4e/pd4-e"]


def rig_of(profile):
    robot = with_drives(load_robot("reference"), {AXIS: profile})
    return Rig(robot.model_copy(update={"axis": {AXIS: robot.axis[AXIS]}, "geometry": None, "line_motion": None}), AXIS)


@pytest.mark.parametrize("label", PRODUCTS)
def test_a_bench_that_names_the_family_gets_the_product(label):
    found = check_identity(RigNetwork(rig_of(label)), AXIS, Profile.load(label.partition("/")[0]))
    assert found == Profile.load(label)
    assert (found.label, found.products) == (label, ())


@pytest.mark.parametrize("label", PRODUCTS)
def test_a_bench_that_names_the_product_gets_it(label):
    assert check_identity(RigNetwork(rig_of(label)), AXIS, Profile.load(label)).label == label


def test_another_product_than_the_named_one_is_refused():
    with pytest.raises(WrongIdentityError) as error:
        check_identity(RigNetwork(rig_of(PRODUCTS[0])), AXIS, Profile.load("trinamic_tmcm16xx/tmcm-1633"))
    assert (error.value.expected, error.value.found) == (0x0661, 0x0686)


def test_another_firmware_than_the_named_one_is_refused():
    with pytest.raises(NodeError, match=r"0x5B of revision 0x07210000, .*says 0x5B \(revision from 0x08A50000\)"):
        check_identity(RigNetwork(rig_of("nanotec_cl4e/cl4-e-2-12")), AXIS, Profile.load("nanotec_cl4e/cl4-e-2-12-v2213"))


def test_the_device_type_is_that_of_the_product():
    rig = rig_of(PRODUCTS[0])
    rig.drive.slave.dictionary.cell(0x1000, 0).value = 0x0046_0192  # the first product's
    with pytest.raises(WrongIdentityError, match=r"device type \(1000h\) is 0x460192; the profile says 0x420192"):
        check_identity(RigNetwork(rig), AXIS, Profile.load("trinamic_tmcm16xx"))


def test_what_the_product_lacks_is_said_once_it_is_known(tmp_path):
    """The first product knows how it counts, this one does not: no other scale is taken for it."""
    text = (VENDORS / "maxon_epos4.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(f"{text}[product.encoder]\nsource = 'none'\nevidence = 'eds'\n", encoding="utf-8")
    table = load_bench("reference").axis[AXIS].model_copy(update={"serial_number": None, "profile": f"{tmp_path}/mine.toml"})
    for product, has_scale in (("70-15", False), ("module-24-1.5", True)):
        axis = DriveAxis(RigNetwork(rig_of(f"maxon_epos4/{product}")), AXIS, table)
        if has_scale:
            axis.identify()
            assert axis.profile.label == f"maxon_epos4/{product}"
            continue
        with pytest.raises(ProfileGapsError, match="profile maxon_epos4/70-15 has no scale of positions"):
            axis.identify()


def test_a_product_that_the_profile_does_not_name_is_refused_with_those_that_it_does():
    rig = rig_of(PRODUCTS[0])
    rig.drive.slave.dictionary.cell(0x1018, 2).value = 0x0999
    with pytest.raises(NodeError, match=r"is 0x999, profile trinamic_tmcm16xx says 0x651 \(tmcm-1617\) or"):
        check_identity(RigNetwork(rig), AXIS, Profile.load("trinamic_tmcm16xx"))
