"""The encoder on the motor: its error recurs with the revolution, its noise is white, and the drive closes its loop by both."""

import math

import numpy as np
import pytest
from scipy import stats

from hil.control.angles import ARCSEC
from hil.robot_tables import TransmissionErrorTable
from plant_emulator.core import CORE
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.robots.encoders import MotorEncoder
from plant_emulator.robots.robot import load_robot
from tests.plant_emulator.rig import GAINS

ROBOT = load_robot("reference")
COUNTS = ROBOT.axis[2].encoder_counts_per_rev


def axes_with(**errors):
    axis = ROBOT.axis[2].model_copy(update={"encoder": MotorEncoder(**errors), "control": GAINS})
    return Axes(ROBOT.model_copy(update={"axis": {2: axis}, "geometry": None, "line_motion": None}))


def test_it_shows_the_motor_with_both_orders_and_nothing_at_home():
    axes = axes_with(error_1_arcsec=60.0, phase_1_deg=40.0, error_2_arcsec=90.0, phase_2_deg=-20.0)
    assert axes.counts(0) == 0
    for angle in np.linspace(-9.0, 9.0, 91):
        axes.plant_state[0]["motor_angle_rad"] = angle
        error = 60.0 * (math.cos(angle + math.radians(40.0)) - math.cos(math.radians(40.0)))
        error += 90.0 * (math.cos(2.0 * angle - math.radians(20.0)) - math.cos(math.radians(-20.0)))
        assert abs(axes.counts(0) - (angle + error * ARCSEC) * COUNTS / math.tau) <= 0.5 + 1e-6


def test_the_noise_is_gaussian_white_and_that_of_its_seed():
    def drawn(seed, count=20_000):
        rows = np.zeros(1, CORE.dtype("encoder"))
        MotorEncoder(noise_counts=0.5).write(rows[0], COUNTS, seed)
        found = np.empty(count)
        for i in range(count):
            CORE.call.draw_noise(CORE.pointer(rows, "encoder"))
            found[i] = rows[0]["present_rad"] * COUNTS / math.tau
        return found

    noise = drawn(7)
    assert stats.kstest(noise / 0.5, "norm").pvalue > 0.01
    assert abs(np.mean(noise[1:] * noise[:-1])) < 4.0 * 0.25 / math.sqrt(len(noise))
    assert np.array_equal(noise[:100], drawn(7, 100))
    assert abs(np.corrcoef(noise[:5000], drawn(8, 5000))[0, 1]) < 0.06


@pytest.mark.parametrize("order", [1, 2])
def test_the_motor_follows_the_error_so_that_the_arm_has_it_by_the_gear_ratio(order):
    """At constant speed, slow: E_k at the motor, turned round, and E_k/N at the joint, as an A_k would be."""
    found = {}
    for errors in ({}, {f"error_{order}_arcsec": 300.0, f"phase_{order}_deg": 50.0}):
        axes = axes_with(**errors)
        axes.open_brake(0, POSITION, 8)
        rows = []
        for i in range(2500):
            axes.set_point(0, round(0.5 * 0.002 * i * COUNTS))
            axes.advance(8)
            if i >= 500:
                rows.append([axes.plant_state[0][name] for name in ("motor_angle_rad", "arm_angle_rad")])
        found[bool(errors)] = np.array(rows)
    motor, arm = (found[True] - found[False]).T
    angle = found[False][:, 0]
    basis = np.stack([np.cos(order * angle), -np.sin(order * angle), np.ones_like(angle)], axis=1)
    for apart, ratio in ((motor, 1.0), (arm, ROBOT.axis[2].reduction_ratio)):
        cosine, sine, _ = np.linalg.lstsq(basis, apart * ratio, rcond=None)[0]
        assert complex(cosine, sine) == pytest.approx(
            -300.0 * ARCSEC * complex(math.cos(math.radians(50.0)), math.sin(math.radians(50.0))), abs=0.12 * 300.0 * ARCSEC
        )


@pytest.mark.parametrize("order", [1, 2])
def test_what_a_master_finds_is_the_gears_error_and_the_encoders(order):
    """Of a gear with the opposite error nothing is left; of one without any, the encoder's by the ratio."""
    axis, turned = ROBOT.axis[2], math.radians(50.0)
    encoder = MotorEncoder(**{f"error_{order}_arcsec": 300.0, f"phase_{order}_deg": 50.0})
    size = 300.0 / axis.reduction_ratio
    for gear, left in ((0.0, -size), (size, 0.0), (2.0 * size, size)):
        ate = TransmissionErrorTable.of({order: gear}, {order: 50.0})
        found = axis.model_copy(update={"ate": ate, "encoder": encoder}).apparent_ate
        phase = math.radians(found.phases_deg().get(order, 0.0)) - turned
        assert found.amplitudes_arcsec().get(order, 0.0) * math.cos(phase) == pytest.approx(left, abs=1e-9)
    assert axis.apparent_ate == axis.ate
