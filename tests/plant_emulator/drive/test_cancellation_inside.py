"""The drive's own cancellation, 2114h: when it may be changed, that it fades, and what it does to arm and motor."""

import math

import numpy as np
import pytest

from drive_profiles.standard.cia301 import SdoAbortCode
from drive_profiles.standard.cia402 import Mode
from tests.plant_emulator.rig import AXIS, COUNTS_PER_REV, ONE_AXIS, Rig

CANCELLATION = 0x2114
MODE, A2, PHI2, A4, PHI4, INERTIA, DAMPING, A1, PHI1 = range(1, 10)
SPEED_RPS = 5.7
ARCSEC = math.pi / 180.0 / 3600.0
AXIS_FILE = ONE_AXIS.axis[AXIS]
VALUES = {
    A2: AXIS_FILE.reduction_ratio * AXIS_FILE.ate.a2_arcsec * ARCSEC,
    PHI2: math.radians(AXIS_FILE.ate.phi2_deg),
    A4: AXIS_FILE.reduction_ratio * AXIS_FILE.ate.a4_arcsec * ARCSEC,
    PHI4: math.radians(AXIS_FILE.ate.phi4_deg),
    INERTIA: AXIS_FILE.motor_inertia_kg_m2,
    DAMPING: AXIS_FILE.motor_damping_nm_s_rad,
    A1: AXIS_FILE.reduction_ratio * AXIS_FILE.ate.a1_arcsec * ARCSEC,
    PHI1: math.radians(AXIS_FILE.ate.phi1_deg),
}


def configure(rig):
    for sub, value in VALUES.items():
        rig.set(CANCELLATION, sub, value)


def vibration(rig, target, periods):
    """Root mean square of the arm's acceleration in the last 250 SYNCs at a constant speed, and where that has led."""
    found = []
    for _ in range(periods):
        target += SPEED_RPS * 0.002 * COUNTS_PER_REV
        rig.cycle(round(target))
        found.append(float(rig.plant["arm_acceleration_rad_s2"]))
    return float(np.std(found[-250:])), target


def test_the_arm_of_a_turning_motor_comes_to_rest(rig):
    configure(rig)
    rig.cyclic(Mode.CSP)
    before, target = vibration(rig, rig.turn(SPEED_RPS, 0.6), 600)
    rig.set(CANCELLATION, MODE, 1)
    after, target = vibration(rig, target, 600)
    assert after < 0.03 * before
    rig.set(CANCELLATION, MODE, 0)
    again, _ = vibration(rig, target, 600)
    assert again == pytest.approx(before, rel=0.05)


def test_it_may_be_switched_while_the_motor_is_under_torque_but_not_changed(rig):
    configure(rig)
    rig.cyclic(Mode.CSP)
    for sub, value in VALUES.items():
        assert rig.write(CANCELLATION, sub, value) is SdoAbortCode.DEVICE_STATE
    rig.set(CANCELLATION, MODE, 1)
    rig.set(CANCELLATION, MODE, 0)


def test_it_fades_in_and_out_and_begins_anew_behind_a_closed_brake(rig):
    configure(rig)
    rig.set(CANCELLATION, MODE, 1)
    rig.cyclic(Mode.CSP)
    rig.world.axes.advance(400)  # half of 0.2 s
    assert 0.4 < rig.motion["cancel_fraction"] < 0.7
    rig.world.axes.advance(800)
    assert rig.motion["cancel_fraction"] == 1.0
    rig.set(CANCELLATION, MODE, 0)
    rig.world.axes.advance(900)
    assert rig.motion["cancel_fraction"] == 0.0
    rig.set(CANCELLATION, MODE, 1)
    rig.world.axes.advance(900)
    rig.word(0)
    rig.world.axes.advance(4)
    assert rig.motion["cancel_fraction"] == 0.0


@pytest.mark.parametrize(("sub", "value"), [(A2, 0.06), (PHI4, 8.0), (INERTIA, 2.0), (A1, 0.06), (PHI1, 8.0)])
def test_what_is_beyond_its_range_is_refused(rig, sub, value):
    assert rig.write(CANCELLATION, sub, value) is SdoAbortCode.VALUE_TOO_HIGH
    assert rig.write(CANCELLATION, sub, -value) is SdoAbortCode.VALUE_TOO_LOW


def test_with_nothing_in_it_nothing_changes():
    positions = []
    for mode in (0, 1):
        rig = Rig()
        rig.set(CANCELLATION, MODE, mode)
        rig.cyclic(Mode.CSP)
        rig.turn(5.9, 0.5)
        positions.append(rig.position_rev)
    assert positions[0] == pytest.approx(positions[1], abs=1e-9)
