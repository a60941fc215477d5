"""The issue's numbers on the reference robot: resonance without notch, specification kept with it, and nothing where nothing is.

Drive-closed at 250 µs, set-points every 2 ms, friction, gravity and encoder on unless a test says otherwise.
"""

import dataclasses
import math

import numpy as np
import pytest

from drive_profiles.standard.units import real32
from hil.analysis import constant_acceleration_metrics, line_motion_metrics, paper_scale, tip_displacement_mm
from hil.bench.bench import load_bench
from hil.control.angles import ARCSEC
from hil.control.notch import Notch
from hil.recording import Recording
from hil.robot_tables import Control, NotchShape, TransmissionErrorTable
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.physics.tip import TipSensor
from plant_emulator.robots.robot import load_robot
from plant_emulator.studies.simulate import references, simulate

BENCH, ROBOT = load_bench("reference"), load_robot("reference")
SYNC = 0.002
F_AL = {number: BENCH.axis[number].loop(250e-6).peak_hz() for number in (2, 3)}
SCALE = {number: paper_scale(f_al) for number, f_al in F_AL.items()}
CONTROLS = {number: Control(**axis.control.model_dump()) for number, axis in BENCH.axis.items()}
TABLE_3 = {
    number: tuple(NotchShape(**table.model_dump(include=set(NotchShape.model_fields))) for table in axis.notch)
    for number, axis in BENCH.axis.items()
}
SPECIFICATION_MM = 0.05


def robot_with(**changes):
    """The reference robot with every axis changed alike."""
    axes = {number: axis.model_copy(update=changes) for number, axis in ROBOT.axis.items()}
    return ROBOT.model_copy(update={"axis": axes})


def as_recorded(run, acceleration=None):
    """What a master would have recorded of a simulation."""
    acceleration = run.tip_acceleration_m_s2 if acceleration is None else acceleration
    columns = {"time_s": run.time_s}
    for column, number in enumerate(run.axes):
        k = ROBOT.axis[number].encoder_counts_per_rev / (2.0 * math.pi)
        columns[f"axis{number}_position_rad"] = run.position_counts[:, column] / k
    for column, name in enumerate(("tip_x_m_s2", "tip_y_m_s2", "tip_z_m_s2")):
        columns[name] = acceleration[:, column]
    return Recording(columns)


def measured(run, seed):
    """The tip's acceleration behind the reference accelerometer: 0.02 m/s² of noise, 1 mg of resolution."""
    a = ROBOT.accelerometer
    assert (a.noise_m_s2, a.resolution_m_s2) == (0.02, 0.00981)
    sensor = TipSensor(a.noise_m_s2, a.resolution_m_s2, a.range_m_s2, np.random.default_rng(seed))
    return np.array([sensor.sample(tuple(row)) for row in run.tip_acceleration_m_s2])


@pytest.fixture(scope="module")
def single_axis():
    """Constant acceleration, 4 rps/s: by axis, without and with Table 3's notch."""
    assert ROBOT.constant_acceleration.acceleration_rps_s == 4.0
    return {
        (number, notch): simulate(ROBOT, number, controls=CONTROLS, notches=TABLE_3 if notch else {})
        for number in (2, 3)
        for notch in (False, True)
    }


@pytest.fixture(scope="module")
def line():
    """The line motion, without and with Table 3's notches."""
    return {notch: simulate(ROBOT, None, controls=CONTROLS, notches=TABLE_3 if notch else {}) for notch in (False, True)}


def single_axis_peak(run, number, seed):
    acceleration = None if seed is None else measured(run, seed)
    return constant_acceleration_metrics(as_recorded(run, acceleration), number, 2, SCALE[number]).tip_peak_mm


@pytest.mark.parametrize("seed", [None, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("number", [2, 3])
def test_at_4_rps_per_s_the_tip_breaks_the_specification_without_and_keeps_it_with_table_3s_notch(single_axis, number, seed):
    """0.075 → 0.046 mm (axis 2) and 0.079 → 0.045 mm (axis 3), true; the sensor adds its noise to both."""
    assert single_axis_peak(single_axis[number, False], number, seed) > 1.3 * SPECIFICATION_MM
    assert single_axis_peak(single_axis[number, True], number, seed) <= SPECIFICATION_MM


@pytest.mark.parametrize("number", [2, 3])
def test_the_vibration_peaks_where_twice_the_motor_speed_meets_the_resonance(single_axis, number):
    found = constant_acceleration_metrics(as_recorded(single_axis[number, False]), number, 2, SCALE[number])
    assert found.spectrum_peak_hz == pytest.approx(F_AL[number], abs=0.7)
    filtered = constant_acceleration_metrics(as_recorded(single_axis[number, True]), number, 2, SCALE[number])
    assert filtered.spectrum_peak_m_s2 < 0.6 * found.spectrum_peak_m_s2
    assert filtered.spectrum_area < 0.7 * found.spectrum_area


@pytest.mark.parametrize("number", [2, 3])
def test_table_3s_notch_leaves_the_4th_order_alone(single_axis, number):
    bare, filtered = (
        constant_acceleration_metrics(as_recorded(single_axis[number, notch]), number, 4, SCALE[number])
        for notch in (False, True)
    )
    assert filtered.tip_peak_mm == pytest.approx(bare.tip_peak_mm, rel=0.01)
    assert bare.tip_peak_mm > 0.03


@pytest.mark.parametrize("seed", [None, 1, 2, 3, 4, 5])
def test_in_the_line_motion_the_spectrums_area_falls_by_26_percent_and_more(line, seed):
    """28 … 29 % with the sensor's noise, 28.9 % without."""
    assert BENCH.specification.line_area_reduction_pct == 26.0
    dwell, duration = ROBOT.line_motion.dwell_s, ROBOT.line_motion.duration_s
    bare, filtered = (
        line_motion_metrics(
            as_recorded(line[notch], None if seed is None else measured(line[notch], seed + 100 * notch)),
            dwell,
            duration,
            SCALE[2],
        )
        for notch in (False, True)
    )
    assert 1.0 - filtered.spectrum_area / bare.spectrum_area >= 0.26
    assert filtered.tip_peak_mm < 0.7 * bare.tip_peak_mm


@pytest.mark.parametrize("bits", [17, 13])
@pytest.mark.parametrize("number", [2, 3])
def test_without_any_transmission_error_the_notch_adds_no_vibration_of_its_own(number, bits):
    """Gravity and friction on, up through f_s and f_e and down again: switching moves the tip by 0.005 mm at most."""
    quiet = robot_with(ate=TransmissionErrorTable.of({}, {}), encoder_counts_per_rev=2**bits)
    assert quiet.axis[number].coulomb_friction_nm > 0.0
    assert quiet.axis[number].gravity_moment_nm > 0.0
    bare, filtered = (
        simulate(quiet, number, controls=CONTROLS, notches=notches).tip_acceleration_m_s2[:, 2] for notches in ({}, TABLE_3)
    )
    assert not np.array_equal(bare, filtered)
    difference = tip_displacement_mm(filtered, SYNC, SCALE[number]) - tip_displacement_mm(bare, SYNC, SCALE[number])
    assert np.max(np.abs(difference)) <= 0.005


def constant_speed(number, speed_rps, notches, realistic=False):
    """|θ_l at k θ_m| over A_k, for k = 2 and 4, of a simulated run at a constant speed."""
    changes = {"encoder_counts_per_rev": 2**24}
    if not realistic:
        changes |= {"coulomb_friction_nm": 0.0, "static_friction_nm": 0.0, "gravity_moment_nm": 0.0}
    axis = ROBOT.axis[number].model_copy(update={} if realistic else changes)
    axes = Axes(ROBOT.model_copy(update={"axis": {number: axis}, "geometry": None, "line_motion": None}))
    CONTROLS[number].cascade().write(axes.cascade_config[0])
    for column, notch in enumerate(notches):
        notch.write(axes.notch_config[0, column])
    periods = 8
    axes.open_brake(0, POSITION, periods)
    settle, seconds, ramp = 3.0, 6.0, 1.0
    rows = []
    for i in range(1, round((settle + seconds) / SYNC) + 1):
        t = i * SYNC
        turns = speed_rps * (0.5 * t * t / ramp if t < ramp else t - 0.5 * ramp)
        axes.set_point(0, round(turns * axis.encoder_counts_per_rev))
        axes.advance(periods)
        if t > settle:
            rows.append((float(axes.plant_state[0]["motor_angle_rad"]), float(axes.plant_state[0]["arm_angle_rad"])))
    motor, arm = np.array(rows).T
    t = np.arange(len(motor)) * SYNC
    columns = [np.ones_like(t), t]
    for k in (2, 4, 6, 8):
        columns += [np.cos(k * motor), np.sin(k * motor)]
    fitted, *_ = np.linalg.lstsq(np.stack(columns, axis=1), arm, rcond=None)
    return {
        2: math.hypot(fitted[2], fitted[3]) / (axis.ate.a2_arcsec * ARCSEC),
        4: math.hypot(fitted[4], fitted[5]) / (axis.ate.a4_arcsec * ARCSEC),
    }


def closed_form(number, order, speed_rps, notches):
    """|X| at k f_m."""
    loop = dataclasses.replace(BENCH.axis[number].loop(250e-6), notches=tuple(notches))
    return abs(loop.arm_per_transmission_error(np.array([order * speed_rps]), speed_rps)[0])


FOURTH = Notch(order=4, start_rps=2.0, end_rps=3.9, offset_hz=0.5, zeta_rn=0.03, zeta_rdth=0.1)
IN_BAND = [*[(2, f) for f in (4.5, 5.0, 5.5, 5.92, 6.5, 7.5)], *[(4, f) for f in (2.3, 2.5, 2.75, 2.96, 3.2, 3.5)]]


@pytest.mark.slow
@pytest.mark.parametrize("number", [2, 3])
@pytest.mark.parametrize(("order", "speed_rps"), IN_BAND)
def test_at_constant_speed_the_arm_vibrates_as_the_closed_form_says(number, order, speed_rps):
    """1 % without notch, 4 % with: the linear case."""
    bare = constant_speed(number, speed_rps, ())[order]
    assert bare == pytest.approx(closed_form(number, order, speed_rps, ()), rel=0.01)
    notches = (TABLE_3[number][0].notch(), FOURTH)
    filtered = constant_speed(number, speed_rps, notches)[order]
    assert filtered == pytest.approx(closed_form(number, order, speed_rps, notches), rel=0.04)


@pytest.mark.parametrize("number", [2, 3])
@pytest.mark.parametrize("speed_rps", [5.0, 5.92, 6.5])
def test_with_friction_gravity_and_the_encoder_on_the_closed_form_still_holds_to_2_and_6_percent(number, speed_rps):
    """Around the resonance of k = 2. For k = 4 with its own notch friction costs more: up to a fifth."""
    bare = constant_speed(number, speed_rps, (), realistic=True)[2]
    assert bare == pytest.approx(closed_form(number, 2, speed_rps, ()), rel=0.02)
    notches = (TABLE_3[number][0].notch(),)
    filtered = constant_speed(number, speed_rps, notches, realistic=True)[2]
    assert filtered == pytest.approx(closed_form(number, 2, speed_rps, notches), rel=0.06)


def test_the_resonance_is_real_and_the_notch_lowers_it_at_constant_speed():
    bare, filtered = constant_speed(2, 5.92, ())[2], constant_speed(2, 5.92, (TABLE_3[2][0].notch(),))[2]
    assert bare > 3.0
    assert filtered < 0.6 * bare


def test_the_simulation_starts_at_the_first_set_point_and_ends_at_rest_at_the_last(single_axis, line):
    for run in (*single_axis.values(), *line.values()):
        assert len(run.time_s) == len(run.position_counts) == len(run.tip_acceleration_m_s2) == len(run.torque_nm)
        np.testing.assert_allclose(np.diff(run.time_s), SYNC)
        assert np.max(np.abs(run.position_counts[0] - run.reference_counts[0])) < 100
        # friction holds the wrist 0.0012 rev away until the integrator has gathered its torque
        assert np.max(np.abs(run.position_counts[-1] - run.reference_counts[-1])) < 0.002 * 131072
    assert single_axis[3, False].axes == (3,)
    assert line[False].axes == (2, 3, 5)


def test_the_arm_follows_the_motor_through_the_gear_within_its_transmission_error_and_torsion(line):
    run = line[False]
    for column, number in enumerate(run.axes):
        axis = ROBOT.axis[number]
        motor = run.position_counts[:, column] * 2.0 * math.pi / axis.encoder_counts_per_rev
        error = run.arm_angle_rad[:, column] - motor / axis.reduction_ratio
        sag = abs(axis.gravity_moment_nm) / axis.gear_stiffness_nm_rad
        assert np.max(np.abs(error)) < sag + 4.0 * (axis.ate.a2_arcsec + axis.ate.a4_arcsec) * ARCSEC + 1e-3
        assert np.ptp(error) > axis.ate.a2_arcsec * ARCSEC


def test_before_and_after_the_motion_gear_and_gravity_are_in_balance(line):
    run = line[True]
    for column, number in enumerate(run.axes):
        axis = ROBOT.axis[number]
        for row in (0, -1):
            motor = float(run.position_counts[row, column]) * 2.0 * math.pi / axis.encoder_counts_per_rev
            arm = float(run.arm_angle_rad[row, column])
            phases = axis.ate.phases_deg()
            error = sum(
                size * ARCSEC * math.cos(k * motor + math.radians(phases[k])) for k, size in axis.ate.amplitudes_arcsec().items()
            )
            weight = axis.gravity_moment_nm * math.cos(arm + ROBOT.home_angle(number))
            sag = weight / axis.gear_stiffness_nm_rad
            assert arm == pytest.approx(motor / axis.reduction_ratio + error - sag, abs=1e-5), (number, row)


def test_the_torque_of_the_line_motion_stays_within_the_limits(line):
    limits = np.array([ROBOT.axis[number].torque_limit_nm for number in line[False].axes])
    for run in line.values():
        assert np.all(np.abs(run.torque_nm) <= limits)
        assert np.max(np.abs(run.torque_nm) / limits) > 0.01


def test_two_runs_are_the_same_to_the_last_bit(line):
    again = simulate(ROBOT, None, controls=CONTROLS, notches=TABLE_3)
    for name in ("reference_counts", "position_counts", "arm_angle_rad", "torque_nm", "tip_acceleration_m_s2"):
        assert np.array_equal(getattr(line[True], name), getattr(again, name)), name


def test_halving_the_substep_of_the_plant_leaves_the_vibration_as_it_is(single_axis):
    fine = simulate(ROBOT.model_copy(update={"plant_substeps": 8}), 2, controls=CONTROLS, notches=TABLE_3).tip_acceleration_m_s2[
        :, 2
    ]
    coarse = single_axis[2, True].tip_acceleration_m_s2[:, 2]
    difference = tip_displacement_mm(fine, SYNC, SCALE[2]) - tip_displacement_mm(coarse, SYNC, SCALE[2])
    assert np.max(np.abs(difference)) < 0.002


def test_gains_and_filters_are_rounded_to_single_precision_as_on_the_bus():
    rough = {number: Control(**{k: real32(v) for k, v in c.model_dump().items()}) for number, c in CONTROLS.items()}
    assert rough[2] != CONTROLS[2]
    short = ROBOT.model_copy(update={"constant_acceleration": ROBOT.constant_acceleration.model_copy(update={"end_rps": 1.0})})
    a, b = (simulate(short, 2, controls=c, notches={}) for c in (CONTROLS, rough))
    assert np.array_equal(a.torque_nm, b.torque_nm)


@pytest.mark.parametrize(
    ("changes", "axis", "said"),
    [
        ({"constant_acceleration": None}, 2, "constant-acceleration motion of an axis 2"),
        ({}, 4, "axis 4"),
        ({"line_motion": None}, None, "no line motion"),
    ],
)
def test_a_motion_that_the_robot_lacks_is_refused(changes, axis, said):
    with pytest.raises(ValueError, match=said):
        references(ROBOT.model_copy(update=changes), axis, SYNC)


@pytest.mark.parametrize("period", [0.0011, 1e-4])
def test_a_sync_period_that_is_no_whole_number_of_control_periods_is_refused(period):
    with pytest.raises(ValueError, match=f"{period} s is not a whole number"):
        simulate(ROBOT, 2, controls=CONTROLS, notches={}, sync_period_s=period)
