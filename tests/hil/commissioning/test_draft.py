"""A bench file from a scan holds what the bus says, and nothing that nobody has said."""

import tomllib
from pathlib import Path

import pytest

from drive_profiles.device.device import DeviceIdentity
from drive_profiles.errors import DriveProfileError
from drive_profiles.standard.units import Scaling
from hil.bench.bench import load_bench
from hil.commissioning.draft import ArmDrawing, draft, left_to_type
from hil.commissioning.scan import FoundNode
from hil.errors import NotPossibleError
from hil.robot_tables import Control

URDF = Path(__file__).parents[3] / "examples" / "arm.urdf"
GAINS = Control(position_gain_per_s=25.0, velocity_gain_nm_s_rad=0.1, velocity_integral_gain_nm_rad=2.0)


def drive(node: int, profile: str = "emulated_drive", **more: object) -> FoundNode:
    identity = DeviceIdentity(node, 0x00020192, 1, 1, 1, 1000 + node, "a drive")
    facts = {"scaling": Scaling(4096, 2.5), "knows_gains": True, "control": GAINS, "position_rev": 0.25, **more}
    return FoundNode(identity, (profile,), **facts)  # type: ignore[arg-type]


SENSOR = FoundNode(DeviceIdentity(16, 404, 1, 2, 1, None, "a sensor"), ("emulated_accelerometer",))


def test_what_the_bus_says_stands_there_and_the_rest_is_a_text():
    text = draft("mine", "socketcan:can0@1M", [drive(2), drive(3), SENSOR])
    document = tomllib.loads(text)
    axis = document["axis"]["2"]
    assert (axis["node_id"], axis["profile"], axis["serial_number"]) == (2, "emulated_drive", 1002)
    assert axis["limits"]["torque_nm"] == 2.5
    assert axis["control"]["velocity_gain_nm_s_rad"] == 0.1
    assert document["accelerometer"]["node_id"] == 16
    assert "4096 increments per motor revolution; its motor is at 0.250 rev" in text
    for key in ("reduction_ratio", "tip_lever_m"):
        assert axis[key].startswith("TYPE:")
    assert all(axis["limits"][key].startswith("TYPE:") for key in ("speed_rps", "position_min_rev", "position_max_rev"))


def test_the_period_is_the_shortest_that_the_bus_carries_and_none_where_its_rate_is_not_known():
    def period(address: str, axes: int) -> object:
        return tomllib.loads(draft("x", address, [*map(drive, range(1, axes + 1))]))["bus"]["sync_period_s"]

    assert period("socketcan:can0@1M", 2) == 0.001
    assert period("socketcan:can0@125k", 6) > period("socketcan:can0@500k", 6) >= 0.002  # type: ignore[operator]
    assert str(period("socketcan:can0", 2)).startswith("TYPE: the bit rate is not known")


def test_each_line_that_is_not_typed_is_refused_by_its_key(tmp_path):
    text = draft("mine", "socketcan:can0@1M", [drive(2), SENSOR])
    path = tmp_path / "bench.toml"
    path.write_text(text)
    left = left_to_type(text)
    with pytest.raises(DriveProfileError) as refused:
        load_bench(path)
    for line, key in left:
        assert f"bench.toml:{line}: {key}: found 'TYPE:" in str(refused.value)
    assert {key for _, key in left} >= {"axis.2.reduction_ratio", "axis.2.tip_lever_m", "axis.2.limits.speed_rps"}


def test_a_device_that_may_be_several_is_not_taken_for_one(tmp_path):
    node = FoundNode(drive(2).identity, ("maxon_epos4/70-15", "maxon_epos4/50-5"))
    text = draft("mine", "socketcan:can0@1M", [node, SENSOR])
    document = tomllib.loads(text)
    assert document["axis"]["2"]["profile"] == "TYPE: one of maxon_epos4/70-15, maxon_epos4/50-5"
    assert document["axis"]["2"]["limits"]["torque_nm"].startswith("TYPE:")
    path = tmp_path / "bench.toml"
    path.write_text(text)
    with pytest.raises(DriveProfileError, match=r"axis\.2\.profile.*is not filled in yet"):
        load_bench(path)


def test_gains_that_only_the_maker_sets_are_left_to_the_drive():
    text = draft("mine", "socketcan:can0@1M", [drive(2, control=None, knows_gains=False), SENSOR])
    assert tomllib.loads(text)["axis"]["2"]["control"] == "as found"


def test_what_a_drive_does_not_say_of_its_scale_is_asked_for(tmp_path):
    unsaid = ("encoder_counts_per_rev", "torque_constant_nm_a")
    node = drive(2, "maxon_epos2", scaling=None, unsaid=unsaid, control=None, knows_gains=False)
    text = draft("mine", "socketcan:can0@1M", [node, SENSOR])
    axis = tomllib.loads(text)["axis"]["2"]
    assert all(axis[key].startswith("TYPE:") for key in unsaid)
    assert {key for _, key in left_to_type(text)} >= {f"axis.2.{key}" for key in unsaid}
    assert "rated_torque_nm" not in axis


def test_gains_that_a_profile_knows_are_asked_for_where_the_scale_is_not_known():
    node = drive(2, scaling=None, unsaid=("encoder_counts_per_rev",), control=None)
    control = tomllib.loads(draft("mine", "socketcan:can0@1M", [node, SENSOR]))["axis"]["2"]["control"]
    assert all(value.startswith("TYPE:") for value in control.values())


def test_a_drawing_says_the_levers_and_its_joints_are_asked_for_by_name(tmp_path):
    drives = [drive(node) for node in range(1, 7)]
    asked = draft("mine", "socketcan:can0@1M", [*drives, SENSOR], ArmDrawing(URDF, tmp_path))
    names = ArmDrawing(URDF, tmp_path).names
    table = tomllib.loads(asked)
    assert table["axis"]["1"]["joint"] == f"TYPE: one of {', '.join(names)}"
    assert "tip_lever_m" not in table["axis"]["1"]
    assert (tmp_path / table["arm"]["urdf"]).resolve() == URDF.resolve()

    told = draft("mine", "socketcan:can0@1M", [*drives, SENSOR], ArmDrawing(URDF, tmp_path, names))
    assert [tomllib.loads(told)["axis"][str(node)]["joint"] for node in range(1, 7)] == list(names)


def test_joints_that_do_not_fit_the_drives_are_refused(tmp_path):
    names = ArmDrawing(URDF, tmp_path).names
    with pytest.raises(NotPossibleError, match="2 joints for 1 drives"):
        draft("mine", "socketcan:can0@1M", [drive(1)], ArmDrawing(URDF, tmp_path, names[:2]))
    with pytest.raises(NotPossibleError, match="has no turning joint elbow_of_another"):
        draft("mine", "socketcan:can0@1M", [drive(1)], ArmDrawing(URDF, tmp_path, ("elbow_of_another",)))


def test_a_bus_without_a_drive_gives_no_file():
    with pytest.raises(NotPossibleError, match="no drive answers"):
        draft("mine", "socketcan:can0@1M", [SENSOR])
