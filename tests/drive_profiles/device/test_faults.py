"""What a drive says is wrong, in the words of its own profile."""

from drive_profiles.device.faults import clear_faults, read_faults
from drive_profiles.standard.cia402 import State
from tests.drive_profiles.world_bus import WorldBus, robot_with


def test_faults_are_in_the_maker_s_words_and_are_cleared_by_the_control_word():
    bus = WorldBus(robot_with(axis2={"profile": "maxon_epos4"}))
    device = bus.device(2, "maxon_epos4")
    assert read_faults(device).is_quiet
    bus.world.drives[2]._fault("position limit", 0x8A82)
    report = read_faults(device)
    assert report.state is State.FAULT
    assert ("603F", "0x8A82", "software position limit") in report.sentences
    assert [words for name, _, words in report.sentences if name == "1003:1"] == ["software position limit"]
    assert clear_faults(device) == []
    assert read_faults(device).is_quiet
