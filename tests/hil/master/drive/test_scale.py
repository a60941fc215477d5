"""What a drive does not say of how it counts is asked of its user, by the key of the bench file; nothing else is."""

import pytest

from drive_profiles.family.profile import Profile
from hil.bench.bench import load_bench
from hil.master.drive.scale import NothingStated, Questions, keys_to_state, read_scaling
from plant_emulator.robots.robot import load_robot, part_of, with_drives
from tests.hil.master.drive.test_axis_units import RigNetwork
from tests.plant_emulator.rig import AXIS, Rig

STATED = {"encoder_counts_per_rev": 131072, "rated_torque_nm": 2.367, "torque_constant_nm_a": 1.0}


@pytest.mark.parametrize(
    ("family", "keys"),
    [
        ("maxon_epos4", ()),
        ("maxon_epos2", ("encoder_counts_per_rev", "torque_constant_nm_a")),
        ("schunk_pilz_prbt", ("encoder_counts_per_rev", "rated_torque_nm")),
        ("elmo_gold", ("encoder_counts_per_rev",)),
    ],
)
def test_the_keys_that_are_asked_are_those_with_which_the_drive_counts(family, keys):
    rig, profile = Rig(with_drives(part_of(load_robot("reference"), [AXIS]), {AXIS: family}), AXIS), Profile.load(family)
    asked = Questions(RigNetwork(rig), AXIS)
    assert keys_to_state(asked, AXIS, profile) == keys
    assert (read_scaling(asked, AXIS, NothingStated(), profile) is None) == bool(keys)
    table = load_bench("reference").axis[AXIS].model_copy(update={key: STATED[key] for key in keys})
    assert read_scaling(asked, AXIS, table, profile) is not None
