"""The master counts as the drive says: by its feed constant and gear; other units it refuses before anything moves."""

import math

import pytest

from drive_profiles.standard import unit_codes
from drive_profiles.standard.cia301 import decode
from drive_profiles.standard.cia402 import Object
from hil.bench.bench import load_bench
from hil.errors import NoAnswerError, NodeError
from hil.master.drive.axis import DriveAxis
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, Rig


class RigNetwork:
    """SDO to a drive in this process."""

    timeout_s = 1.0

    def __init__(self, rig):
        self.rig = rig

    def read_raw(self, node, index, subindex=0, name=""):
        return self.rig.upload(index, subindex)

    def read(self, node, index, subindex, kind, name=""):
        return decode(kind, self.read_raw(node, index, subindex))


@pytest.fixture
def rig():
    return Rig()


@pytest.fixture
def axis(rig):
    return DriveAxis(RigNetwork(rig), AXIS, load_bench("reference").axis[AXIS].model_copy(update={"serial_number": None}))


def test_a_drive_from_the_factory_counts_increments(axis):
    axis.identify()
    assert axis.scaling.position_counts(2.0 * math.pi) == COUNTS_PER_REV
    assert axis.scaling.counts_are_increments


def test_a_gear_and_a_feed_constant_are_followed(rig, axis):
    rig.set(Object.GEAR_RATIO, 1, 100)
    rig.set(Object.FEED_CONSTANT, 1, 36000)
    axis.identify()
    assert axis.scaling.position_counts(2.0 * math.pi) == 360
    rig.plant["motor_angle_rad"] = 3.0
    assert axis.position_rad() == pytest.approx(3.0, abs=2.0 * math.pi / 360)


@pytest.mark.parametrize(
    ("index", "value"),
    [
        (Object.POLARITY, 0x80),
        (Object.SI_UNIT_POSITION, unit_codes.code(unit_codes.DEGREE, prefix=-3)),
        (Object.SI_UNIT_VELOCITY, unit_codes.code(unit_codes.REVOLUTION, unit_codes.MINUTE)),
        (Object.SI_UNIT_ACCELERATION, unit_codes.code(unit_codes.RPM, unit_codes.SECOND)),
    ],
)
def test_units_in_which_the_profiles_scales_do_not_hold_are_refused(rig, axis, index, value):
    rig.set(index, 0, value)
    with pytest.raises(NodeError, match=f"units of its own: {index:04X}h:00h is {value:X}h"):
        axis.identify()


def test_a_drive_that_falls_silent_while_its_feed_constant_is_read_is_silent_and_not_nonsensical(rig):
    class Silent(RigNetwork):
        def read_raw(self, node, index, subindex=0, name=""):
            if index == Object.FEED_CONSTANT:
                raise NoAnswerError(node, "the feed constant", self.timeout_s)
            return super().read_raw(node, index, subindex, name)

    table = load_bench("reference").axis[AXIS].model_copy(update={"serial_number": None})
    with pytest.raises(NoAnswerError, match="no answer to the feed constant"):
        DriveAxis(Silent(rig), AXIS, table).identify()
