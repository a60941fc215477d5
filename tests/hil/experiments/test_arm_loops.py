"""Margins of a loop on the reference arm: against another calculation, against the emulated arm, and what is said of them."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from hil.arm.line import arm_line
from hil.arm.masses import mass_matrix
from hil.bench.bench import Model, load_bench
from hil.bench.model import Identified, IdentifiedAxis, IdentifiedMode, IdentifiedPlant
from hil.control.notch import NOTCH_SWITCHED, NOTCH_TRAPEZOID, FixedFilter, Notch, notch_coefficients
from hil.control.servo import Servo, ServoConfig
from hil.experiments.arm_loops import arm_loops, gear_of
from hil.experiments.arm_masses import identify_arm
from hil.experiments.notch_design import design, result_of
from hil.experiments.notch_problem import NotchDesignRequest, problem_of
from hil.report.pages.design import write_design_report
from hil.robot_tables import Control, PlantTable, TransmissionErrorTable
from plant_emulator.robots.robot import load_robot
from tests.hil.experiments.test_arm_masses import model_file
from tests.plant_emulator.physics.flexible_rig import FREE, FlexibleArm, changed

BENCH, ROBOT = load_bench("reference-arm"), load_robot("reference-arm")
PERIOD_S = 250e-6
TABLE_3 = {number: BENCH.axis[number].notch[0].notch() for number in (2, 3)}
DESIGNED = Notch(
    mode=NOTCH_TRAPEZOID, start_rps=4.375, end_rps=8.502, offset_hz=0.66, zeta_rn=0.355, zeta_rdth=0.602, speed_lowpass_hz=34.0,
    ramp_rps=0.824,
)  # fmt: skip
"""What `hil design notch --axis 2` gives on a bench with the arm's true bodies and the true plants of all axes."""


def believed(numbers=(2, 3, 5), arm=ROBOT.arm):
    """The reference arm's bench with the true plants of some axes, and the true bodies."""
    inertias = np.diag(mass_matrix(ROBOT.arm, ROBOT.arm.home_rad()))
    axes = dict(BENCH.axis)
    for number in numbers:
        truth = ROBOT.axis[number]
        names = [name for name in PlantTable.model_fields if name != "arm_inertia_kg_m2"]
        plant = {name: getattr(truth, name) for name in names}
        inertia = float(inertias[ROBOT.arm.axes.index(number)])
        axes[number] = axes[number].model_copy(update={"model": Model(**plant, arm_inertia_kg_m2=inertia, ate=truth.ate)})
    return BENCH.model_copy(update={"axis": axes, "arm": arm})


def loops_of(bench, number, percent=0.0, identified=None):
    problem, _ = problem_of(bench, NotchDesignRequest(number, uncertainty_percent=percent))
    law = problem.loop(problem.members[0])
    return arm_loops(bench, number, law, problem.members, identified)


def worst(loops, notches, words, speeds):
    """Largest M_s of the cases whose label has some words, and least phase margin."""
    family = loops.family(1.0 / 640.0, with_filtered=True)
    found = family.margins(notches, speeds)
    rows = [row for row, case in enumerate(family.cases) if all(word in case.label for word in words)]
    assert rows
    return float(found.sensitivity_peak[rows].max()), float(found.phase_margin_deg[rows].min())


@pytest.mark.ci
@pytest.mark.parametrize(
    ("number", "words", "m_s", "phase_deg"),
    [
        (2, ("at the start of the line", "motors held"), 1.63, 35.0),
        (2, ("at the end of the line", "motors held"), 2.13, 27.0),
        (2, ("at the start of the line", "other loops closed"), 1.40, None),
        (2, ("at the end of the line", "other loops closed"), 1.61, None),
        (3, ("at the end of the line", "motors held"), 1.42, 42.0),
    ],
)
def test_table_3_has_the_margins_that_another_calculation_of_a_planar_arm_gave(number, words, m_s, phase_deg):
    """Of a planar arm with these inertias, frozen at both ends; the filter within its range, no hysteresis."""
    notch = replace(TABLE_3[number], hysteresis_rps=0.0)
    bench = believed()
    bare = {each: table.model_copy(update={"notch": ()}) for each, table in bench.axis.items()}
    loops = loops_of(bench.model_copy(update={"axis": bare}), number).loops
    found = worst(loops, (notch,), words, np.arange(4.0, 9.01, 0.05))
    assert found[0] == pytest.approx(m_s, abs=0.01)
    if phase_deg is not None:
        assert found[1] == pytest.approx(phase_deg, abs=1.0)


def sensitivity_of_the_emulated_arm(notch, speed_rps, lines_hz, others):
    """|S| of axis 2 at the end of the line, measured: sines into its torque, filters frozen as at a motor speed.

    The gears are without error and the motors without friction, gravity is off: what is linear is left.
    """
    arm = ROBOT.arm.model_copy(update={"gravity_m_s2": (0.0, 0.0, 0.0)})
    quiet = ROBOT.model_copy(update={"arm": arm}).with_links_read(Path())
    robot = changed(quiet, **{name: 0.0 for name in FREE if "friction" in name}, ate=TransmissionErrorTable.of({}, {}))
    closed = (2,) if others == "held" else (2, 3, 5)
    elastic = FlexibleArm(robot, braked=[number for number in robot.axis if number not in closed])
    turned = arm_line(arm, BENCH.line_motion).line.joints_along[1][-1] - arm.home_rad()
    state = elastic.state
    state[:, 0] = turned * [robot.axis[number].reduction_ratio for number in arm.axes]
    state[:, 2] = turned
    elastic.put(state)
    zero_hz = notch.order * speed_rps
    frozen = FixedFilter(*notch_coefficients(zero_hz, zero_hz + notch.offset_hz, notch.zeta_rn, notch.zeta_rdth, PERIOD_S))
    servos = {}
    for row, number in enumerate(arm.axes):
        if number in closed:
            gains = Control(**BENCH.axis[number].control.model_dump()).cascade()
            servos[row] = Servo(ServoConfig(gains, 1e3, (frozen,) if number == 2 else ()), PERIOD_S)
            servos[row].start(state[row, 0])
    count, settle = round(2.0 / PERIOD_S), round(3.0 / PERIOD_S)
    time = PERIOD_S * np.arange(settle + count)
    added = 0.01 * np.sum([np.sin(2.0 * math.pi * hz * time + 1.7 * k**2) for k, hz in enumerate(lines_hz)], axis=0)
    torques, start, shown = np.zeros(len(arm.axes)), state[:, 0].copy(), np.zeros(len(time))
    for i, extra in enumerate(added):
        for row, servo in servos.items():
            torques[row] = servo.step(start[row], state[row, 0], torque_offset=extra if arm.axes[row] == 2 else 0.0)
        shown[i] = torques[arm.axes.index(2)]
        state = elastic.run(torques, 1)
    spectra = [np.fft.rfft(each[settle:]) for each in (shown, added)]
    at = np.rint(np.array(lines_hz) * count * PERIOD_S).astype(int)
    return np.abs(spectra[0][at] / spectra[1][at])


@pytest.mark.slow
@pytest.mark.parametrize("others", ["held", "closed"])
@pytest.mark.parametrize(("notch", "speed"), [(TABLE_3[2], 4.0), (DESIGNED, 5.6)])
def test_the_emulated_arm_shows_the_sensitivity_that_is_reckoned(notch, speed, others):
    lines = np.array([6.0, 7.0, 7.5, 8.0, 8.5, 9.0, 9.5, 10.0, 11.0, 12.0, 14.0, 17.0, 20.0])
    loops = loops_of(believed(), 2).loops
    label = "other motors held" if others == "held" else "other loops closed"
    case = next(case for case in loops.cases if case.label == f"at the end of the line, {label}")
    law = replace(loops.law, notches=(replace(notch, mode=NOTCH_SWITCHED),))
    reckoned = 1.0 / np.abs(1.0 + law.controller(lines, speed) * case.angle_per_torque(lines))
    measured = sensitivity_of_the_emulated_arm(notch, speed, lines.tolist(), others)
    np.testing.assert_allclose(measured, reckoned, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("percent", [0.0, 3.0])
def test_the_designed_filter_keeps_1_7_in_every_posture_of_the_line_and_table_3_does_not(percent):
    loops = loops_of(believed(), 2, percent).loops
    speeds = np.arange(0.0, 12.01, 0.1)
    assert worst(loops, (DESIGNED,), (), speeds)[0] < 1.7
    assert worst(loops, (TABLE_3[2],), (), speeds)[0] > 2.1


@pytest.mark.slow
def test_a_given_filter_that_breaks_a_margin_on_the_line_is_refused_with_the_place(tmp_path):
    outcome = design(believed(), NotchDesignRequest(2, is_given=True, uncertainty_percent=0.0))
    assert outcome.failure is not None
    assert not outcome.is_usable
    (missed,) = [check for check in outcome.failure.missed if check.name == "M_s on the arm"]
    assert str(missed).startswith("M_s on the arm 2.178 at 3.85 rev/s")
    assert "at the end of the line, other motors held" in str(outcome.failure)
    alone = next(check for check in outcome.given.checks if check.name == "M_s")
    assert alone.holds
    written = result_of(outcome)
    assert max(row.sensitivity_peak for row in written.given.postures) == pytest.approx(missed.value)
    assert written.given.postures[0].label == "at the start of the line, other motors held"
    assert "axes 1, 4 and 6 are taken as rigid" in " ".join(written.notes)
    page = write_design_report(outcome, tmp_path / "design.html").read_text()
    assert "Margins on the arm" in page
    assert "at the end of the line, other motors held" in page


def test_with_an_arm_of_no_masses_it_is_said_that_margins_on_it_are_not_known():
    found = loops_of(believed(arm=BENCH.arm), 2)
    assert found.loops is None
    assert "the links of the bench's arm have no bodies" in found.notes[0]
    assert "on the arm they are unknown" in found.notes[0]


def identified_modes(number, joints_rad):
    """A model file as an identification in a posture would write it, without errors: the arm's modes behind a motor."""
    rows = [ROBOT.arm.axes.index(each) for each in (2, 3, 5)]
    inertia = mass_matrix(ROBOT.arm, joints_rad)[np.ix_(rows, rows)]
    gears = np.diag([ROBOT.axis[each].gear_stiffness_nm_rad for each in (2, 3, 5)])
    dampers = np.diag([ROBOT.axis[each].gear_damping_nm_s_rad + ROBOT.axis[each].arm_damping_nm_s_rad for each in (2, 3, 5)])
    squares, shapes = linalg.eigh(gears, inertia)
    own = (2, 3, 5).index(number)
    modes = []
    for square, shape in zip(squares, shapes.T, strict=True):
        omega = math.sqrt(square)
        numbers = {
            "antiresonance_hz": omega / (2.0 * math.pi), "resonance_hz": 1.5 * omega / (2.0 * math.pi),
            "damping": float(shape @ dampers @ shape) / (2.0 * omega), "inertia_kg_m2": float((shape @ inertia)[own] ** 2),
        }  # fmt: skip
        modes.append(IdentifiedMode(**numbers))
    values = believed().axis[number].model.model_dump(exclude={"ate"})
    plant = IdentifiedPlant(
        values=PlantTable(**values), antiresonance_hz=10.4, resonance_hz=20.0, damping=0.03, modes=tuple(modes)
    )
    return Identified(robot=BENCH.name, axis={number: IdentifiedAxis(plant=plant)})


def test_identified_modes_stand_for_the_posture_in_which_they_were_found_and_for_no_other():
    identified = identified_modes(2, ROBOT.arm.home_rad())
    found = loops_of(believed(arm=BENCH.arm), 2, identified=identified)
    speeds = np.arange(3.85, 9.16, 0.05)
    assert [case.label for case in found.loops.cases] == ["where its plant was identified, other motors held"]
    assert "elsewhere on the line they are unknown" in found.notes[0]
    by_masses = worst(loops_of(believed(), 2).loops, (TABLE_3[2],), ("at the start", "motors held"), speeds)
    assert worst(found.loops, (TABLE_3[2],), (), speeds) == pytest.approx(by_masses, rel=0.04)  # damping is a mode's own there


def test_the_gear_of_several_modes_is_their_sum():
    stiffness, damping = gear_of(identified_modes(3, ROBOT.arm.home_rad()).axis[3].plant)
    assert stiffness == pytest.approx(ROBOT.axis[3].gear_stiffness_nm_rad, rel=1e-9)
    lost = ROBOT.axis[3].gear_damping_nm_s_rad + ROBOT.axis[3].arm_damping_nm_s_rad
    assert damping == pytest.approx(lost, rel=0.1)  # the modes do not diagonalise it


@pytest.mark.slow
def test_masses_identified_from_three_postures_do_instead_of_bodies():
    known = model_file()
    identified = known.with_arm(identify_arm(BENCH, known).arm)
    found = loops_of(believed(arm=BENCH.arm), 2, identified=identified)
    assert "the masses come from 3 postures, dips to 0." in " ".join(found.notes)
    notch, speeds = replace(TABLE_3[2], hysteresis_rps=0.0), np.arange(4.0, 9.01, 0.05)
    nominal = [case for case in found.loops.cases if "frequencies" not in case.label]
    held = worst(replace(found.loops, cases=tuple(nominal)), (notch,), ("at the end of the line", "motors held"), speeds)
    assert held[0] == pytest.approx(2.13, abs=0.03)
    assert worst(found.loops, (notch,), ("at the end of the line", "motors held"), speeds)[0] > held[0]


def test_a_gear_that_the_bench_file_states_counts_where_its_model_stands_for_one_mode():
    """Axis 2's model with the inertia and the stiffness of its leading mode alone, beside the whole gear's."""
    bench = believed()
    table = bench.axis[2]
    part = {"arm_inertia_kg_m2": 4.8, "gear_stiffness_nm_rad": 20_000.0, "gear_damping_nm_s_rad": 42.0 * 20_000.0 / 48_950.0}
    alone = table.model_copy(update={"model": table.model.model_copy(update=part), "gear_stiffness_nm_rad": 48_950.0})
    stated = loops_of(bench.model_copy(update={"axis": {**bench.axis, 2: alone}}), 2).loops
    for case, whole in zip(stated.cases, loops_of(bench, 2).loops.cases, strict=True):
        np.testing.assert_allclose(case.structure.stiffness, whole.structure.stiffness)
        np.testing.assert_allclose(case.structure.damping, whole.structure.damping)


def test_an_axis_by_itself_knows_no_arm():
    bench = load_bench("reference")
    found = loops_of(bench, 2)
    assert found.loops is None
    assert found.notes == ()
