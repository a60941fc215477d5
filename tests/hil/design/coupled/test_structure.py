"""Structures behind motors against what is known of a single axis, and poles against the turns of the Nyquist curve."""

import dataclasses
import math

import numpy as np
import pytest
from scipy import linalg

from hil.bench.bench import load_bench
from hil.design.coupled.loops import ArmCase, ArmLoops, Other
from hil.design.coupled.structure import Structure
from hil.design.modes.problem import ArmMode, modal_angle

BENCH = load_bench("reference")
LOOPS = [BENCH.axis[number].loop(250e-6, with_notch=False) for number in (2, 3)]
JOINTS = [loop.plant for loop in LOOPS]
HZ = np.geomspace(1.0, 400.0, 60)
COUPLED = np.array([[8.0, -1.71], [-1.71, 2.8]])


def test_one_joint_is_the_plant_of_a_single_axis():
    loop = LOOPS[0]
    one = Structure.of_arm(np.array([[loop.plant.arm_inertia_kg_m2]]), [loop.plant])
    np.testing.assert_allclose(one.receptance(HZ)[0, 0], loop.plant.motor_angle_per_torque(HZ), rtol=1e-9)
    assert one.dips_hz() == pytest.approx([loop.plant.antiresonance_hz])
    radius = one.pole_radius({0: loop.law_block()}, loop.period_s)
    assert radius == pytest.approx(float(np.abs(loop.closed_loop_poles()).max()), abs=1e-9)


def test_axes_that_do_not_feel_each_other_have_their_own_plants():
    both = Structure.of_arm(np.diag([plant.arm_inertia_kg_m2 for plant in JOINTS]), JOINTS)
    for row, plant in enumerate(JOINTS):
        found = ArmCase("closed", both, row, (Other(1 - row, LOOPS[1 - row]),)).angle_per_torque(HZ)
        np.testing.assert_allclose(found, plant.motor_angle_per_torque(HZ), rtol=1e-9)


def test_behind_one_motor_an_arm_is_the_modes_that_its_identification_finds():
    """Effective inertias (shapeᵀ H e)² of the modes with all motors held; dampers in proportion to the springs."""
    joints = [
        dataclasses.replace(plant, arm_damping_nm_s_rad=0.0, gear_damping_nm_s_rad=8e-4 * plant.gear_stiffness_nm_rad)
        for plant in JOINTS
    ]
    arm = Structure.of_arm(COUPLED, joints)
    squares, shapes = linalg.eigh(np.diag([plant.gear_stiffness_nm_rad for plant in joints]), COUPLED)
    for own in (0, 1):
        modes = [
            ((shape @ COUPLED)[own] ** 2, math.sqrt(square) / (2.0 * math.pi), 0.5 * 8e-4 * math.sqrt(square))
            for square, shape in zip(squares, shapes.T, strict=True)
        ]
        held = arm.held([1 - own])
        case = ArmCase("held", arm, own)
        by_modes = Structure.of_modes(joints[own], modes)
        known = modal_angle(joints[own], [ArmMode(*mode) for mode in modes], HZ)
        np.testing.assert_allclose(held.receptance(HZ)[0, 0], known, rtol=1e-9)
        np.testing.assert_allclose(case.angle_per_torque(HZ), known, rtol=1e-9)
        np.testing.assert_allclose(by_modes.receptance(HZ)[0, 0], known, rtol=1e-9)
    np.testing.assert_allclose(arm.stiffened(1.05).dips_hz(), 1.05 * arm.dips_hz(), rtol=1e-12)


def test_a_loop_among_closed_ones_is_the_whole_inverse():
    arm = Structure.of_arm(COUPLED, JOINTS)
    case = ArmCase("closed", arm, 0, (Other(1, LOOPS[1]),))
    law, found = LOOPS[1].controller(HZ), case.angle_per_torque(HZ)
    for i, hz in enumerate(HZ):
        s = 2j * math.pi * hz
        dynamic = arm.mass * s**2 + arm.damping * s + arm.stiffness
        dynamic[1, 1] += law[i]
        assert found[i] == pytest.approx(np.linalg.inv(dynamic)[0, 0], rel=1e-8)


@pytest.mark.parametrize(("factor", "is_stable"), [(1.0, True), (12.0, False)])
def test_closed_loops_that_are_unstable_are_seen_by_their_poles(factor, is_stable):
    """The gains of one axis multiplied until its own loop is unstable at this sampling time."""
    arm = Structure.of_arm(COUPLED, JOINTS)
    gains = dataclasses.replace(LOOPS[0].cascade, velocity_gain_nm_s_rad=factor * LOOPS[0].cascade.velocity_gain_nm_s_rad)
    own = dataclasses.replace(LOOPS[0], cascade=gains, delay_samples=1)
    laws = {0: own.law_block(), 1: LOOPS[1].law_block()}
    assert (arm.pole_radius(laws, 250e-6) < 1.0) == is_stable


@pytest.mark.ci
def test_a_filter_that_unstables_the_arm_turns_the_nyquist_curve_and_has_poles_outside():
    """Table 3's filter in a loop at 1 ms with a sample of delay."""
    arm, notch = Structure.of_arm(COUPLED, JOINTS), BENCH.axis[2].notch[0].notch()
    law = dataclasses.replace(LOOPS[0], period_s=1e-3, delay_samples=1)
    case = ArmCase("both closed", arm, 0, (Other(1, dataclasses.replace(LOOPS[1], period_s=1e-3)),))
    for factor, is_stable in ((0.5, True), (1.0, False)):
        gains = dataclasses.replace(
            law.cascade, velocity_gain_nm_s_rad=factor * law.cascade.velocity_gain_nm_s_rad,
            velocity_integral_gain_nm_rad=factor * law.cascade.velocity_integral_gain_nm_rad,
        )  # fmt: skip
        loops = ArmLoops(dataclasses.replace(law, cascade=gains), (case,))
        speeds = np.array([5.9])
        turns = loops.family(1.0 / 640.0, with_filtered=False).margins((notch,), speeds).turns
        filtered = dataclasses.replace(loops.law, notches=(notch,))
        assert (turns[0, 0] == 0.0) == is_stable
        assert (case.pole_radius(filtered, 5.9) < 1.0) == is_stable
