"""The loop in the frequency domain: Table 1 of the paper, and poles, margins and Nyquist as each other's judges."""

import math

import numpy as np
import pytest
from scipy import signal

from hil.bench.bench import load_bench
from hil.control.angles import ARCSEC
from hil.control.cascade import Cascade
from hil.control.notch import NOTCH_TRAPEZOID, Notch
from hil.control.servo import Servo, ServoConfig
from hil.design.frequency import Loop, TwoInertia, acceleration_bound, margins

BENCH = load_bench("reference")
T = 250e-6


def loop(axis, period_s=T, delay=0, notch=False, gain=1.0):
    table = BENCH.axis[axis]
    c = table.control
    cascade = Cascade(
        c.position_gain_per_s,
        gain * c.velocity_gain_nm_s_rad,
        gain * c.velocity_integral_gain_nm_rad,
        c.lowpass_hz,
    )
    notches = tuple(t.notch() for t in table.notch) if notch else ()
    return Loop(table.plant(), cascade, notches, period_s, delay)


@pytest.mark.parametrize(("axis", "f_al", "f_m2", "f_m4"), [(2, 11.84, 5.92, 2.96), (3, 11.45, 5.72, 2.86)])
def test_table_1_peak_of_g_al_and_the_resonant_speeds(axis, f_al, f_m2, f_m4):
    peak = loop(axis).peak_hz()
    assert peak == pytest.approx(f_al, abs=0.005)
    # the paper rounds: 11.45 / 2 = 5.725 it prints as 5.72
    assert peak / 2.0 == pytest.approx(f_m2, abs=0.006)
    assert peak / 4.0 == pytest.approx(f_m4, abs=0.006)


def test_an_arm_that_its_loop_damps_out_has_its_anti_resonance_for_f_al():
    """A drawn robot (51753): |G_al| has no peak, and f_al was the end of the range, 63.3 Hz."""
    plant = TwoInertia(137.0, 5.1841e-5, 2.1786e-4, 4.3627, 11.252, 119650.0, 60.227)
    damped = Loop(plant, Cascade(37.05, 0.03257, 0.6514, 300.0), (), T)
    f_a = plant.antiresonance_hz
    gain = np.abs(damped.acceleration_per_transmission_error(np.linspace(0.3 * f_a, 2.4 * f_a, 500)))
    assert np.all(np.diff(gain) > 0.0)
    assert damped.peak_hz() == f_a


@pytest.mark.parametrize("axis", [2, 3])
def test_figure_4_antiresonance_near_12_hz_and_resonance_near_22_hz(axis):
    plant = BENCH.axis[axis].plant()
    assert plant.antiresonance_hz == pytest.approx(12.0, abs=0.5)
    assert plant.resonance_hz == pytest.approx(22.0, abs=0.1)
    # and the frequency response itself shows them there
    f = np.linspace(8.0, 30.0, 22001)
    # without the double integrator's slope, which would move the extremes
    gain = np.abs(plant.motor_angle_per_torque(f)) * f**2
    assert f[np.argmin(gain)] == pytest.approx(plant.antiresonance_hz, abs=0.1)
    assert f[np.argmax(gain)] == pytest.approx(plant.resonance_hz, abs=0.25)


@pytest.mark.parametrize("axis", [2, 3])
def test_the_plants_response_is_that_of_its_state_space(axis):
    plant = BENCH.axis[axis].plant()
    a, b = plant.state_space()
    f = np.geomspace(0.1, 1000.0, 200)
    want = [np.linalg.solve(2j * math.pi * f_hz * np.eye(4) - a, b)[0] for f_hz in f]
    np.testing.assert_allclose(plant.motor_angle_per_torque(f), want, rtol=1e-9)


@pytest.mark.parametrize("axis", [2, 3])
@pytest.mark.parametrize("notch", [False, True])
def test_g_al_solves_the_equations_of_motion_with_the_loop_closed(axis, notch):
    """Motor and arm in the frequency domain as a 2 × 2 system, instead of the closed form."""
    closed = loop(axis, notch=notch)
    p = closed.plant
    f = np.array([3.0, 8.0, 11.8, 12.4, 16.0, 22.0, 40.0])
    controller = closed.controller(f, 5.9)
    got = closed.acceleration_per_transmission_error(f, 5.9)
    for f_hz, c, value in zip(f, controller, got, strict=True):
        s = 2j * math.pi * f_hz
        gear = p.gear_stiffness_nm_rad + p.gear_damping_nm_s_rad * s
        motor = p.motor_inertia_kg_m2 * s**2 + p.motor_damping_nm_s_rad * s + c
        arm = p.arm_inertia_kg_m2 * s**2 + p.arm_damping_nm_s_rad * s
        n = p.reduction_ratio
        # unknowns θ_m, θ_l; torsion = θ_m/N + 1 − θ_l
        matrix = np.array([[motor + gear / n**2, -gear / n], [-gear / n, arm + gear]])
        _, theta_l = np.linalg.solve(matrix, [-gear / n, gear])
        assert value == pytest.approx(s**2 * theta_l, rel=1e-9)


def test_the_controllers_response_is_scipys_bilinear_law_behind_hold_and_delay():
    closed = loop(2, notch=True, delay=1)
    f = np.array([1.0, 11.9, 50.0, 500.0])
    z = np.exp(2j * math.pi * f * T)
    w = 2.0 * math.pi * 300.0

    def response(b, a):
        bz, az = signal.bilinear(b, a, fs=1.0 / T)
        return np.polyval(bz, z) / np.polyval(az, z)

    pi = response([0.196, 3.92], [1.0, 0.0])
    feedback = 25.0 + response([w, 0.0], [1.0, w])
    zero, pole = 2.0 * math.pi * 11.84, 2.0 * math.pi * 12.34
    notch = response((pole / zero) ** 2 * np.array([1.0, 2.0 * 0.028 * zero, zero**2]), [1.0, 2.0 * 0.1 * pole, pole**2])
    hold = np.exp(-1j * math.pi * f * T) * np.sinc(f * T)
    np.testing.assert_allclose(closed.controller(f, 5.92), pi * feedback * notch * hold / z, rtol=1e-9)


@pytest.mark.parametrize("axis", [2, 3])
def test_table_3s_notch_keeps_constraint_5_on_the_line_and_the_bare_loop_does_not(axis):
    table = BENCH.axis[axis]
    speeds = np.linspace(4.0, 9.0, 101)
    bare, filtered = loop(axis), loop(axis, notch=True)
    amplitude = table.model.ate.a2_arcsec * ARCSEC
    bound = acceleration_bound(2.0 * speeds, amplitude, table.tip_lever_m, 50e-6)
    gains = {
        name: np.array([abs(one.acceleration_per_transmission_error(np.array([2.0 * f]), f)[0]) for f in speeds])
        for name, one in (("bare", bare), ("filtered", filtered))
    }
    assert np.max(gains["bare"] / bound) > 1.0
    assert np.max(gains["filtered"] / bound) <= 1.0


def test_the_bound_is_the_tip_displacement_read_as_an_acceleration():
    f = np.array([5.0, 11.84])
    tip = acceleration_bound(f, 5.0 * ARCSEC, 0.7, 50e-6) / (2.0 * math.pi * f) ** 2 * 5.0 * ARCSEC * 0.7
    np.testing.assert_allclose(tip, 50e-6)


def winding_outside(closed, speed_rps=0.0):
    """How often 1 + L(z) turns round zero along |z| = 1 + 1e-5, built without a line of the code under test.

    L has no poles outside and vanishes at infinity, so the turns are minus the number of unstable closed-loop poles.
    """
    p, c, period = closed.plant, closed.cascade, closed.period_s
    n2 = p.reduction_ratio**2
    k, d = p.gear_stiffness_nm_rad, p.gear_damping_nm_s_rad
    motor = np.array([p.motor_inertia_kg_m2, p.motor_damping_nm_s_rad, 0.0])
    arm = np.array([p.arm_inertia_kg_m2, p.arm_damping_nm_s_rad, 0.0])
    gear = np.array([d, k])
    denominator = np.polyadd(np.polymul(motor, np.polyadd(arm, gear)), np.polymul(arm, gear) / n2)
    continuous = signal.tf2ss(np.polyadd(arm, gear), denominator)
    a, b, row, _, _ = signal.cont2discrete(continuous, period)
    # dense at low frequencies, where the integrators turn fast
    half = np.concatenate([np.linspace(0.0, 1e-4, 4000), np.geomspace(1.0001e-4, math.pi, 40_000)])
    angle = np.concatenate([-half[::-1], half])
    z = (1.0 + 1e-5) * np.exp(1j * angle)
    eigenvalues, vectors = np.linalg.eig(a)
    left, right = row @ vectors, np.linalg.solve(vectors, b)
    plant = np.sum((left[0] * right[:, 0])[:, None] / (z[None, :] - eigenvalues[:, None]), axis=0)
    s = 2.0 / period * (z - 1.0) / (z + 1.0)
    w = 2.0 * math.pi * c.lowpass_hz
    law = (c.velocity_gain_nm_s_rad + c.velocity_integral_gain_nm_rad / s) * (c.position_gain_per_s + w * s / (s + w))
    for notch in closed.notches:
        if notch.start_rps <= speed_rps <= notch.end_rps:
            zero = 2.0 * math.pi * notch.order * speed_rps
            pole = zero + 2.0 * math.pi * notch.offset_hz
            top = s**2 + 2.0 * notch.zeta_rn * zero * s + zero**2
            law = law * top / (s**2 + 2.0 * notch.zeta_rdth * pole * s + pole**2) * (pole / zero) ** 2
    turned = np.angle(np.exp(1j * np.diff(np.angle(1.0 + plant * law * z ** (-closed.delay_samples)))))
    assert np.max(np.abs(turned)) < 1.0  # the grid resolves every turn
    return round(float(np.sum(turned)) / (2.0 * math.pi))


CASES = [
    *[(axis, T, 0, 1.0, notch, f) for axis in (2, 3) for notch, f in ((False, 0.0), (True, 4.0), (True, 5.9), (True, 9.0))],
    *[(axis, T, 1, 1.0, True, 5.9) for axis in (2, 3)],
    *[(axis, 1e-3, 0, 1.0, False, 0.0) for axis in (2, 3)],
    *[(axis, 1e-3, 1, 1.0, False, 0.0) for axis in (2, 3)],
    *[(axis, 1e-3, 1, gain, True, 5.9) for axis in (2, 3) for gain in (0.5, 1.0)],
    *[(axis, 2e-3, 1, 1.0, False, 0.0) for axis in (2, 3)],
    *[(axis, T, 0, 12.0, False, 0.0) for axis in (2, 3)],
    *[(axis, T, 4, 1.0, True, 6.5) for axis in (2, 3)],
]


@pytest.mark.parametrize(("axis", "period_s", "delay", "gain", "notch", "speed_rps"), CASES)
def test_the_number_of_unstable_poles_is_the_number_of_encirclements(axis, period_s, delay, gain, notch, speed_rps):
    closed = loop(axis, period_s, delay, notch, gain)
    outside = int(np.count_nonzero(np.abs(closed.closed_loop_poles(speed_rps)) > 1.0 + 1e-5))
    assert winding_outside(closed, speed_rps) == -outside
    assert margins(closed, speed_rps).stable == (outside == 0)


def test_the_cases_above_hold_stable_and_unstable_loops():
    stable = [margins(loop(a, t, d, n, g), f).stable for a, t, d, g, n, f in CASES]
    assert 4 <= sum(stable) <= len(CASES) - 4


@pytest.mark.parametrize("axis", [2, 3])
def test_the_reference_gains_at_250_us_are_stable_with_margins_at_every_speed(axis):
    for speed in (0.0, 4.0, 5.0, 5.9, 7.0, 9.0):
        found = margins(loop(axis, notch=True), speed)
        assert found.stable
        assert found.pole_radius < 1.0
        assert found.gain_margin_db > 18.0
        assert found.phase_margin_deg > 35.0


@pytest.mark.parametrize("axis", [2, 3])
def test_the_reference_gains_at_1_ms_with_a_sample_of_delay_are_at_the_edge_and_beyond_it_with_the_notch(axis):
    bare = margins(loop(axis, 1e-3, 1))
    assert bare.gain_margin_db < 0.3
    assert bare.phase_margin_deg < 2.0
    assert margins(loop(axis, 1e-3, 1, gain=1.05)).pole_radius > 1.0
    for speed in (4.0, 5.0, 5.9, 7.0, 9.0):
        filtered = margins(loop(axis, 1e-3, 1, notch=True), speed)
        assert not filtered.stable
        assert filtered.pole_radius > 1.0
    # half the gains stand it
    assert margins(loop(axis, 1e-3, 1, notch=True, gain=0.5), 5.9).stable


def growth(closed, steps):
    """The largest motor angle in the first and in the last tenth of a simulated run of `Servo` on scipy's plant."""
    a, b = closed.plant.state_space()
    c = [[1.0, 0.0, 0.0, 0.0]]
    a, b, _, _, _ = signal.cont2discrete((a, b[:, np.newaxis], np.array(c), np.zeros((1, 1))), closed.period_s)
    servo = Servo(ServoConfig(closed.cascade, 1e300), closed.period_s)
    x = np.array([1e-3, 0.0, 1e-3, 0.0])
    servo.start(1e-3)
    waiting = [0.0] * closed.delay_samples
    angles = np.empty(steps)
    for i in range(steps):
        angles[i] = x[0]
        waiting.append(servo.step(0.0, x[0]))
        x = a @ x + b[:, 0] * waiting.pop(0)
    tenth = steps // 10
    return np.max(np.abs(angles[:tenth])), np.max(np.abs(angles[-tenth:]))


@pytest.mark.parametrize("axis", [2, 3])
@pytest.mark.parametrize(("period_s", "delay"), [(250e-6, 0), (250e-6, 1), (1e-3, 0), (1e-3, 1), (2e-3, 1)])
def test_the_running_law_grows_or_decays_as_the_poles_say(axis, period_s, delay):
    closed = loop(axis, period_s, delay)
    radius = float(np.abs(closed.closed_loop_poles()).max())
    first, last = growth(closed, 4000)
    assert (last > first) == (radius > 1.0)


@pytest.mark.parametrize("axis", [2, 3])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_gain_margin_is_the_gain_at_which_the_poles_reach_the_unit_circle(axis, delay):
    found = margins(loop(axis, delay=delay), points=20_000)
    factor = 10.0 ** (found.gain_margin_db / 20.0)
    radii = [float(np.abs(loop(axis, delay=delay, gain=g).closed_loop_poles()).max()) for g in (0.98 * factor, 1.02 * factor)]
    assert radii[0] < 1.0 < radii[1]


@pytest.mark.parametrize("axis", [2, 3])
def test_the_margins_keep_the_bounds_that_the_sensitivity_peak_sets(axis):
    for speed in (0.0, 5.9, 7.0):
        found = margins(loop(axis, notch=True), speed)
        peak = found.sensitivity_peak
        assert peak > 1.0
        assert 10.0 ** (found.gain_margin_db / 20.0) >= peak / (peak + 1.0)
        assert found.phase_margin_deg >= 0.99 * math.degrees(2.0 * math.asin(0.5 / peak))


def test_filters_act_only_within_their_range_and_not_when_off():
    closed = loop(2, notch=True)
    assert closed.filters(3.9) == []
    assert len(closed.filters(5.9)) == 1
    assert Loop(closed.plant, closed.cascade, (Notch(mode=0),)).filters(5.9) == []
    # at a foot of the trapezoid zeros and poles are one
    foot = Loop(closed.plant, closed.cascade, (Notch(mode=NOTCH_TRAPEZOID),))
    np.testing.assert_allclose(foot.notch_response(np.array([1.0, 8.0, 100.0]), 4.0), 1.0, atol=1e-9)


def test_a_rigid_gear_has_no_arm_vibration_of_its_own():
    """A hundred times the stiffness: the arm follows the transmission error one to one at low frequency."""
    p = BENCH.axis[2].plant()
    stiff = TwoInertia(
        p.reduction_ratio, p.motor_inertia_kg_m2, p.motor_damping_nm_s_rad, p.arm_inertia_kg_m2, p.arm_damping_nm_s_rad,
        1e4 * p.gear_stiffness_nm_rad, p.gear_damping_nm_s_rad,
    )  # fmt: skip
    held = Loop(stiff, Cascade(25.0, 1e4, 1e3))
    np.testing.assert_allclose(held.arm_per_transmission_error(np.array([5.0, 12.0])), 1.0, atol=1e-3)
