"""Touch probes over CAN: which edge is caught, what it says of the position, and when a probe starts anew."""

import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode, Object
from tests.plant_emulator.drive.test_inputs import go, robot_with
from tests.plant_emulator.rig import COUNTS_PER_REV, Rig

FUNCTION, STATUS = (Object.TOUCH_PROBE_FUNCTION, 0), Object.TOUCH_PROBE_STATUS
LOW, HIGH = round(-1.0 * COUNTS_PER_REV), round(-0.5 * COUNTS_PER_REV)
"""Where touch probe 1 sees something, in counts."""
NEAR = 3


@pytest.fixture
def rig():
    rig = Rig(robot_with())
    rig.enable(Mode.PP)
    return rig


def positions(rig):
    return [rig.read(Object.TOUCH_PROBE_1_POSITIVE + i) for i in range(4)]


def test_the_first_positive_edge_is_kept_until_the_probe_is_enabled_anew(rig):
    rig.set(*FUNCTION, 0x0011)
    assert rig.read(STATUS) == 0x0001
    go(rig, -1.2)
    assert rig.read(STATUS) & 0x0007 == 0x0003
    assert abs(positions(rig)[0] - HIGH) <= NEAR  # from above it is entered at its upper end
    go(rig, 0.0)
    assert abs(positions(rig)[0] - HIGH) <= NEAR
    rig.set(*FUNCTION, 0x0000)
    assert rig.read(STATUS) == 0
    go(rig, -1.2)
    assert rig.read(STATUS) == 0
    rig.set(*FUNCTION, 0x0011)
    go(rig, 0.0)
    assert rig.read(STATUS) & 0x0007 == 0x0003
    assert abs(positions(rig)[0] - LOW) <= NEAR


def test_continuous_keeps_the_last_edge_and_shows_each_by_its_toggle(rig):
    rig.set(*FUNCTION, 0x0033)
    go(rig, -1.2)
    first = rig.read(STATUS)
    assert first & 0x0007 == 0x0007
    assert [abs(a - b) <= NEAR for a, b in zip(positions(rig)[:2], (HIGH, LOW), strict=True)] == [True, True]
    go(rig, 0.0)
    second = rig.read(STATUS)
    assert second ^ first == 0x00C0
    assert [abs(a - b) <= NEAR for a, b in zip(positions(rig)[:2], (LOW, HIGH), strict=True)] == [True, True]


def test_both_probes_catch_their_own(rig):
    rig.set(*FUNCTION, 0x1111)
    go(rig, -1.2)
    assert rig.read(STATUS) & 0x0707 == 0x0303
    one, _, two, _ = positions(rig)
    assert abs(one - HIGH) <= NEAR
    assert abs(two - round(-0.25 * COUNTS_PER_REV)) <= NEAR


def test_the_index_pulse_is_caught_as_one_edge(rig):
    rig.set(*FUNCTION, 0x0015)
    go(rig, -1.4)
    assert rig.read(STATUS) & 0x0007 == 0x0003
    assert positions(rig)[0] in {0, -COUNTS_PER_REV}  # at 0 it stood; the first pulse on the way
    rig.set(*FUNCTION, 0)
    rig.set(*FUNCTION, 0x0015)
    go(rig, 0.3)
    assert abs(positions(rig)[0] + COUNTS_PER_REV) <= NEAR


def test_the_source_object_chooses_another_input(rig):
    rig.set(Object.TOUCH_PROBE_SOURCE, 1, 2)  # probe 1 hears the input of probe 2
    rig.set(Object.TOUCH_PROBE_SOURCE, 2, -1)  # probe 2 hears the home switch
    rig.set(*FUNCTION, 0x1919)
    go(rig, -1.2)
    assert abs(positions(rig)[0] - round(-0.25 * COUNTS_PER_REV)) <= NEAR
    go(rig, 0.7)
    assert abs(positions(rig)[2] - round(0.5 * COUNTS_PER_REV)) <= NEAR
    assert rig.read(STATUS) & 0x0707 == 0x0303


def test_an_edge_that_is_enabled_later_starts_anew_without_the_other(rig):
    rig.set(*FUNCTION, 0x0011)
    go(rig, -1.2)
    held = positions(rig)[0]
    rig.set(*FUNCTION, 0x0031)
    go(rig, 0.0)
    assert rig.read(STATUS) & 0x0007 == 0x0007
    assert positions(rig)[0] == held
    assert abs(positions(rig)[1] - HIGH) <= NEAR


def test_what_is_no_source_is_refused_and_changes_nothing(rig):
    rig.set(*FUNCTION, 0x0011)
    for value in (0x001D, 0x1D00):
        assert rig.write(*FUNCTION, value) is SdoAbortCode.INVALID_VALUE
    assert rig.read(*FUNCTION) == 0x0011
    assert rig.write(Object.TOUCH_PROBE_SOURCE, 1, 4) is SdoAbortCode.INVALID_VALUE


def test_without_a_probe_nothing_is_watched():
    rig = Rig()
    rig.set(*FUNCTION, 0x0011)
    assert rig.motion["edge_mask"] != 0
    rig.set(*FUNCTION, 0)
    assert rig.motion["edge_mask"] == 0


def test_a_reset_puts_the_probes_back(rig):
    rig.set(*FUNCTION, 0x0011)
    go(rig, -1.2)
    rig.nmt(129)
    assert rig.read(STATUS) == 0
    assert rig.motion["edge_mask"] == 0


def test_positions_are_the_users_after_homing(rig):
    rig.wait(500)
    rig.set(Object.HOMING_METHOD, 0, 37)
    rig.set(Object.HOME_OFFSET, 0, 5000)
    rig.set(Object.MODES_OF_OPERATION, 0, Mode.HM)
    rig.word(0x0F, 0x1F)
    rig.wait(10)
    assert abs(rig.read(Object.POSITION_ACTUAL) - 5000) <= NEAR
    shift = rig.read(Object.POSITION_ACTUAL) - rig.read(Object.POSITION_ACTUAL_INTERNAL)
    rig.set(*FUNCTION, 0x0011)
    rig.set(Object.MODES_OF_OPERATION, 0, Mode.PP)
    rig.word(0x0F)
    go(rig, -1.2)
    assert abs(positions(rig)[0] - (HIGH + shift)) <= NEAR
