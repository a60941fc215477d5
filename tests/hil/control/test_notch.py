"""The variable notch: scipy judges the arithmetic, a noisy speed the switching."""

import math

import numpy as np
import pytest
from scipy import signal

from hil.control.notch import (
    NO_NOTCH,
    NOTCH_CONFIG,
    NOTCH_OFF,
    NOTCH_STATE,
    NOTCH_SWITCHED,
    NOTCH_TRAPEZOID,
    NOTCHES,
    Notch,
    notch_coefficients,
    notch_weight,
)
from tests.hil.control.law_in_c import notch_step

T = 250e-6
TABLE_3 = Notch(offset_hz=0.5, zeta_rn=0.028, zeta_rdth=0.1)
TABLE_3_AXIS_3 = Notch(offset_hz=0.7, zeta_rn=0.036, zeta_rdth=0.1)


class Bank:
    """The notches of one axis with their state, as the servo law holds them."""

    def __init__(self, *notches, period_s=T):
        self.config = np.zeros((1, NOTCHES), NOTCH_CONFIG)
        self.state = np.zeros((1, NOTCHES), NOTCH_STATE)
        self.period_s = period_s
        self.count = len(notches)
        for column, notch in enumerate(notches):
            notch.write(self.config[0, column])

    def at(self, speed_rps, torque_nm):
        """As if this speed and this torque had stood there for long."""
        self.state["speed_rps"], self.state["mean_nm"] = abs(speed_rps), torque_nm
        return self

    def step(self, speed_rps, u):
        for column in range(self.count):
            u = notch_step(self.config[0, column], self.state[0, column], self.period_s, 2.0 * math.pi * speed_rps, u)
        return u

    def run(self, speeds_rps, torques):
        return np.array([self.step(f, u) for f, u in zip(speeds_rps, torques, strict=True)])


def continuous(zero_hz, pole_hz, zeta_rn, zeta_rd):
    """F_n(s), eq. (6), as numerator and denominator."""
    wn, wd = 2.0 * math.pi * zero_hz, 2.0 * math.pi * pole_hz
    gain = wd**2 / wn**2
    return gain * np.array([1.0, 2.0 * zeta_rn * wn, wn**2]), np.array([1.0, 2.0 * zeta_rd * wd, wd**2])


def by_scipy(notch, speed_rps, period_s=T):
    zero_hz = notch.order * speed_rps
    return signal.bilinear(*continuous(zero_hz, zero_hz + notch.offset_hz, notch.zeta_rn, notch.zeta_rdth), fs=1.0 / period_s)


def noise(count, seed=1):
    return np.random.default_rng(seed).standard_normal(count)


@pytest.mark.parametrize("period_s", [250e-6, 1e-3, 2e-3])
@pytest.mark.parametrize("speed_rps", [2.5, 4.0, 5.92, 9.0])
@pytest.mark.parametrize("notch", [TABLE_3, TABLE_3_AXIS_3], ids=["axis 2", "axis 3"])
def test_the_coefficients_are_those_of_the_bilinear_transform(notch, speed_rps, period_s):
    zero_hz = notch.order * speed_rps
    b0, b1, b2, a1, a2 = notch_coefficients(zero_hz, zero_hz + notch.offset_hz, notch.zeta_rn, notch.zeta_rdth, period_s)
    b, a = by_scipy(notch, speed_rps, period_s)
    np.testing.assert_allclose([b0, b1, b2], b, rtol=1e-11)
    np.testing.assert_allclose([1.0, a1, a2], a, rtol=1e-11)


@pytest.mark.parametrize("speed_rps", [4.0, 5.92, 9.0])
def test_the_gain_is_one_at_dc_and_the_notch_is_deep_at_k_times_the_motor_speed(speed_rps):
    zero_hz, pole_hz = 2.0 * speed_rps, 2.0 * speed_rps + 0.5
    b0, b1, b2, a1, a2 = notch_coefficients(zero_hz, pole_hz, 0.028, 0.1, T)
    assert (b0 + b1 + b2) / (1.0 + a1 + a2) == pytest.approx(1.0, abs=1e-8)
    _, (at_zero,) = signal.freqz([b0, b1, b2], [1.0, a1, a2], worN=[zero_hz], fs=1.0 / T)
    # eq. (6) at s = j ω_rn
    b, a = continuous(zero_hz, pole_hz, 0.028, 0.1)
    s = 2j * math.pi * zero_hz
    assert at_zero == pytest.approx(np.polyval(b, s) / np.polyval(a, s), rel=2e-3)
    assert abs(at_zero) < 0.35


@pytest.mark.parametrize("speed_rps", [4.0, 5.92, -5.92, 9.0])
def test_at_a_constant_speed_the_running_filter_is_scipys_lfilter(speed_rps):
    u = 0.4 + noise(4000)
    got = Bank(TABLE_3).at(speed_rps, 0.4).run(np.full(u.shape, speed_rps), u)
    b, a = by_scipy(TABLE_3, abs(speed_rps))
    # the filter starts on the low-passed torque, which the first sample has moved a little
    blend = 2.0 * (math.pi * 20.0 * T) / (1.0 + math.pi * 20.0 * T)
    mean = 0.4 + blend * (u[0] - 0.4)
    want, _ = signal.lfilter(b, a, u, zi=mean * signal.lfilter_zi(b, a))
    np.testing.assert_allclose(got, want, atol=1e-9)


def test_two_notches_of_orders_2_and_4_are_the_product_of_both():
    second = Notch(order=2, start_rps=4.0, end_rps=9.0)
    fourth = Notch(order=4, start_rps=2.2, end_rps=7.0, offset_hz=0.8, zeta_rn=0.03, zeta_rdth=0.12)
    u = noise(3000)
    u[0] = 0.0  # both start on zero torque
    got = Bank(second, fourth).at(5.0, 0.0).run(np.full(u.shape, 5.0), u)
    want = u
    for notch in (second, fourth):
        want = signal.lfilter(*by_scipy(notch, 5.0), want)
    np.testing.assert_allclose(got, want, atol=1e-9)


def test_of_two_notches_only_the_one_whose_range_holds_the_speed_acts():
    bank = Bank(Notch(order=2, start_rps=4.0, end_rps=9.0), Notch(order=4, start_rps=2.0, end_rps=3.6)).at(3.0, 0.0)
    bank.step(3.0, 1.0)
    assert bank.state["active"].tolist() == [[0, 1]]
    assert bank.state["frequency_hz"][0, 1] == pytest.approx(12.0)


@pytest.mark.parametrize("speed_rps", [0.0, 1.0, 3.9, 9.3, 12.0, -3.9, -9.3])
@pytest.mark.parametrize("mode", [NOTCH_SWITCHED, NOTCH_TRAPEZOID])
def test_outside_its_range_the_output_is_the_input(mode, speed_rps):
    u = noise(500)
    bank = Bank(Notch(mode=mode)).at(speed_rps, 0.0)
    assert bank.run(np.full(u.shape, speed_rps), u).tolist() == u.tolist()
    assert not bank.state["active"].any()


@pytest.mark.parametrize("speed_rps", [0.0, 5.92])
def test_a_notch_that_is_off_passes_everything(speed_rps):
    u = noise(500)
    assert NO_NOTCH.mode == NOTCH_OFF
    assert Bank(NO_NOTCH).at(speed_rps, 0.0).run(np.full(u.shape, speed_rps), u).tolist() == u.tolist()


@pytest.mark.slow
@pytest.mark.parametrize("mode", [NOTCH_SWITCHED, NOTCH_TRAPEZOID])
@pytest.mark.parametrize("speed_rps", [4.0, 4.3, 5.92, 9.0])
def test_a_constant_torque_passes_unchanged_through_a_filter_that_starts(speed_rps, mode):
    out = Bank(Notch(mode=mode)).at(speed_rps, 0.7).run(np.full(4000, speed_rps), np.full(4000, 0.7))
    np.testing.assert_allclose(out, 0.7, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("mode", "bound"), [(NOTCH_SWITCHED, 0.006), (NOTCH_TRAPEZOID, 0.03)])
def test_retuning_at_4_rps_per_s_disturbs_a_constant_torque_by_less_than_a_hundredth_or_three(mode, bound):
    """The delays hold what the coefficients of a moment ago left: 0.5 % at 4 rps/s, 2.4 % on the trapezoid's slope."""
    speeds = np.concatenate([np.arange(0.0, 11.0, 4.0 * T), np.arange(11.0, 0.0, -4.0 * T)])
    bank, active = Bank(Notch(mode=mode)).at(0.0, 0.7), 0
    out = np.empty_like(speeds)
    for i, f in enumerate(speeds):
        out[i] = bank.step(f, 0.7)
        active += int(bank.state["active"][0, 0])
    assert active > 9000  # it did act
    assert np.max(np.abs(out / 0.7 - 1.0)) < bound


def switches(notch, speeds_rps):
    """How often the filter goes in or out along a speed."""
    bank = Bank(notch).at(speeds_rps[0], 0.0)
    active = []
    for f in speeds_rps:
        bank.step(f, 0.1)
        active.append(int(bank.state["active"][0, 0]))
    return np.count_nonzero(np.diff(active))


def coarse_speed(bits, speeds_rps):
    """What the velocity low-pass of 300 Hz makes of an encoder with so many bits."""
    angle = 0.123 + np.cumsum(speeds_rps) * T
    shown = np.floor(angle * 2**bits + 0.5) / 2**bits
    corner = 2.0 * math.pi * 300.0
    b, a = signal.bilinear([corner, 0.0], [1.0, corner], fs=1.0 / T)
    settled = signal.lfilter_zi(b, a) * shown[0]
    return signal.lfilter(b, a, shown, zi=settled)[0]


@pytest.mark.slow
@pytest.mark.parametrize("bits", [13, 11])
@pytest.mark.parametrize("foot_rps", [4.0, 9.0])
def test_the_speed_of_a_coarse_encoder_switches_the_filter_at_most_twice_per_crossing(foot_rps, bits):
    ramp = np.arange(foot_rps - 0.5, foot_rps + 0.5, 0.5 * T)  # slow: 0.5 rps/s
    for speeds in (coarse_speed(bits, ramp), coarse_speed(bits, ramp[::-1])):
        assert 1 <= switches(Notch(), speeds[400:]) <= 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_noisy_speed_switches_the_filter_at_most_twice_per_crossing(seed):
    ramp = np.arange(3.5, 4.5, 0.5 * T)
    noisy = ramp + 0.15 * noise(len(ramp), seed)
    for speeds in (noisy, noisy[::-1], noisy + 5.0):
        assert 1 <= switches(Notch(hysteresis_rps=0.15), speeds) <= 2
    # without hysteresis the same speed makes it chatter, so the noise is worth the test
    assert switches(Notch(hysteresis_rps=0.0), noisy) > 10


def test_the_weight_is_one_where_it_switches_and_a_trapezoid_over_the_ramps_otherwise():
    assert notch_weight(NOTCH_SWITCHED, 4.0, 4.0, 9.0, 1.0) == 1.0
    speeds = [3.0, 4.0, 4.25, 5.0, 6.5, 8.0, 8.5, 9.0, 9.5]
    want = np.interp(speeds, [4.0, 5.0, 8.0, 9.0], [0.0, 1.0, 1.0, 0.0])
    np.testing.assert_allclose([notch_weight(NOTCH_TRAPEZOID, f, 4.0, 9.0, 1.0) for f in speeds], want, atol=1e-12)


@pytest.mark.parametrize("foot_rps", [4.0, 9.0])
def test_the_feet_of_the_trapezoid_are_continuous_and_those_of_the_switch_are_not(foot_rps):
    u = noise(2000)
    just_inside = foot_rps + (1e-6 if foot_rps == 4.0 else -1e-6)
    for mode, low, high in ((NOTCH_TRAPEZOID, 0.0, 1e-4), (NOTCH_SWITCHED, 0.05, math.inf)):
        out = Bank(Notch(mode=mode)).at(just_inside, 0.0).run(np.full(u.shape, just_inside), u)
        deviation = float(np.max(np.abs(out - u)))
        assert low <= deviation <= high, mode


def test_the_pole_damping_and_offset_follow_the_weight():
    bank = Bank(Notch(mode=NOTCH_TRAPEZOID)).at(4.5, 0.0)
    bank.step(4.5, 0.0)
    assert bank.state["zeta_rd"][0, 0] == pytest.approx(0.028 + 0.5 * (0.1 - 0.028))
    assert bank.state["frequency_hz"][0, 0] == pytest.approx(9.0)


def test_the_speed_that_tunes_it_is_the_measured_one_behind_its_own_lowpass():
    """A first-order low-pass of 50 Hz: after one time constant 63 % of a step."""
    bank = Bank(Notch(speed_lowpass_hz=50.0)).at(0.0, 0.0)
    samples = round(1.0 / (2.0 * math.pi * 50.0) / T)
    for _ in range(samples):
        bank.step(6.0, 0.0)
    assert bank.state["speed_rps"][0, 0] == pytest.approx(6.0 * (1.0 - math.exp(-1.0)), rel=0.03)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"mode": 7}, "mode 7"),
        ({"order": 0}, "order 0"),
        ({"order": 9}, "order 9"),
        ({"start_rps": 9.0, "end_rps": 4.0}, "9.0 … 4.0"),
        ({"start_rps": 0.0}, "0.0 … 9.0"),
        ({"zeta_rn": 0.0}, "zeta_rn = 0.0"),
        ({"zeta_rdth": -0.1}, "zeta_rdth = -0.1"),
        ({"speed_lowpass_hz": 0.0}, "speed_lowpass_hz = 0.0"),
        ({"ramp_rps": math.nan}, "ramp_rps = nan"),
        ({"offset_hz": -0.5}, "offset_hz = -0.5"),
        ({"hysteresis_rps": -0.1}, "hysteresis_rps = -0.1"),
        ({"start_rps": 0.1, "hysteresis_rps": 0.15}, "hysteresis_rps = 0.15"),
    ],
)
def test_what_is_no_filter_is_refused_with_its_value(values, said):
    with pytest.raises(ValueError, match=said.replace(".", r"\.")):
        Notch(**values)
