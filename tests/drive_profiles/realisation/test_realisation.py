"""What a drive makes of the paper's notch and gains: recomputed from what its objects hold, or refused with the numbers."""

import contextlib
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal
from typer.testing import CliRunner

from drive_profiles.cli.main import app
from drive_profiles.errors import DriveProfileError, OutOfRangeError
from drive_profiles.family.profile import Profile, available
from drive_profiles.realisation import (
    Biquad,
    NotchTarget,
    NotRealisableError,
    Tolerance,
    gains_for,
    held_filter,
    pid_gains,
    realise,
    shape_of,
)
from drive_profiles.realisation.biquad import Quadratic, biquad_of, factors, polynomial_of, quadratic_of, stated
from drive_profiles.standard.units import Scaling
from hil.control.notch import notch_coefficients

EMULATED = Profile.load("emulated_drive")
AXIS_2, AXIS_3 = (0.5, 0.028, 0.1), (0.7, 0.036, 0.1)
SPEEDS = (4.0, 5.0, 5.72, 5.92, 7.0, 9.0)
TABLE_3 = [NotchTarget.at_speed(2, rps, *axis) for axis in (AXIS_2, AXIS_3) for rps in SPEEDS]
NOTCH = NotchTarget.at_speed(2, 5.92, *AXIS_2)
GAINS = {"position_gain_per_s": 25.0, "velocity_gain_nm_s_rad": 0.196, "velocity_integral_gain_nm_rad": 3.92}

frequencies = st.floats(2.0, 60.0)
dampings = st.floats(0.01, 0.9)
rates = st.sampled_from([1e3, 4e3, 5e3, 8e3, 16e3, 20e3])
rules = st.sampled_from(["bilinear", "bilinear prewarped", "backward Euler prewarped"])


def drive(notch=None, loop=None, **parameters):
    """A drive that differs from the emulated one in its filter or loop, and has these parameters besides."""
    facts = EMULATED.model_dump(by_alias=True)
    fact = {"source": "test", "evidence": "definition"}
    facts["capabilities"]["notch_inside"]["answer"] = "unknown"
    facts["notch"] = notch and {"place": "torque command", "changed_by": "SDO", **fact, **notch}
    facts["loop"] = {"structure": "P-PI", **fact, **loop} if loop else facts["loop"]
    facts["parameters"] = {**facts["parameters"], **dict(_parameters(parameters, fact))}
    return Profile.model_validate(facts)


def _parameters(parameters, fact):
    for n, (name, fields) in enumerate(parameters.items()):
        base = {"index": 0x3000 + n, "subindex": 0, "data_type": "REAL32", "class": "tuning", "description": name}
        yield name, base | fact | fields


def coefficient_drive(rate_hz, bits=None, *, gain=False, a_sign=-1, higher=False, period=True):
    """A drive with coefficients: REAL32, or fixed point of so many fraction bits in 32."""
    names = ["b0", "b1", "b2", "a1", "a2"] + ["b3", "b4", "a3", "a4"] * higher
    kind = {} if bits is None else {"data_type": "INTEGER32", "scale": 2.0**-bits}
    word = {} if bits is None else {"word": "fixed point", "fraction_bits": bits}
    parts = {name: name for name in names} | ({"gain": "gain"} if gain else {})
    sections = ({"parts": parts, "settings": {"filter_type": 1.0}},)
    notch = {"form": "coefficients", "period_s": 1 / rate_hz if period else None, "a_sign": a_sign, "sections": sections, **word}
    extra = {"gain": kind} if gain else {}
    return drive(notch, **dict.fromkeys(names, kind), **extra, filter_type={"data_type": "UNSIGNED16"})


def zero_pole_drive(rule="backward Euler prewarped", **facts):
    """The form of Kollmorgen's AKD: four numbers, Q of the zeros at most 5, 16 kHz."""
    q = {"zero_q": facts.pop("zero_q", {"minimum": 0.1, "maximum": 5.0}), "pole_q": {"minimum": 0.2, "maximum": 20.0}}
    f = {name: {"unit": "Hz"} for name in ("zero_frequency", "pole_frequency")}
    parts = {name: name for name in (*q, *f)}
    notch = {"form": "zero-pole", "period_s": 62.5e-6, "discretisation": rule, "min_frequency_hz": 5.0, **facts}
    return drive(notch | {"sections": ({"parts": parts},)}, **q, **f)


def symmetric_drive(kind="q", unit="", **facts):
    sections = ({"parts": {"frequency": "frequency", kind: "width"}},)
    notch = {"form": "symmetric", "period_s": 250e-6, "discretisation": "bilinear", "sections": sections, **facts}
    return drive(notch, frequency={"unit": "Hz"}, width={"unit": unit})


def response(biquads, frequency_hz, period_s):
    sos = [[b.b0, b.b1, b.b2, 1.0, b.a1, b.a2] for b in biquads]
    return signal.sosfreqz(sos, worN=2 * np.pi * np.atleast_1d(frequency_hz) * period_s)[1]


class TestBiquad:
    def test_it_is_the_notch_that_the_host_runs(self):
        for target in TABLE_3:
            mine = biquad_of(Quadratic(target.zero_hz, target.zeta_zero), Quadratic(target.pole_hz, target.zeta_pole), 250e-6)
            his = notch_coefficients(target.zero_hz, target.pole_hz, target.zeta_zero, target.zeta_pole, 250e-6)
            assert mine == pytest.approx(his, rel=1e-12)

    def test_it_is_the_bilinear_transform_of_a_stranger(self):
        wn, wd = 2 * np.pi * NOTCH.zero_hz, 2 * np.pi * NOTCH.pole_hz
        numerator = np.array([1 / wn**2, 2 * NOTCH.zeta_zero / wn, 1.0])
        denominator = [1 / wd**2, 2 * NOTCH.zeta_pole / wd, 1.0]
        b, a = signal.bilinear(numerator, denominator, fs=4000.0)
        mine = biquad_of(Quadratic(NOTCH.zero_hz, NOTCH.zeta_zero), Quadratic(NOTCH.pole_hz, NOTCH.zeta_pole), 250e-6)
        assert mine == pytest.approx([*b, *a[1:]], rel=1e-9)

    @given(frequencies, dampings, frequencies, dampings, rates)
    def test_shape_and_biquad_are_inverse(self, zero_hz, zeta_zero, pole_hz, zeta_pole, rate):
        shape = shape_of(biquad_of(Quadratic(zero_hz, zeta_zero), Quadratic(pole_hz, zeta_pole), 1 / rate), 1 / rate)
        found = (shape.zero_hz, shape.zeta_zero, shape.pole_hz, shape.zeta_pole, shape.dc_gain)
        assert found == pytest.approx((zero_hz, zeta_zero, pole_hz, zeta_pole, 1.0), rel=1e-6)
        assert shape.is_stable
        assert shape.is_notch

    @given(frequencies, dampings, rates, rules)
    def test_every_rule_has_its_inverse(self, frequency_hz, zeta, rate, rule):
        found = quadratic_of(polynomial_of(Quadratic(frequency_hz, zeta), 1 / rate, rule), 1 / rate, rule)
        assert found == pytest.approx((frequency_hz, zeta), rel=1e-6)

    def test_gain_is_that_of_the_frequency_response(self):
        biquad = biquad_of(Quadratic(11.84, 0.028), Quadratic(12.34, 0.1), 62.5e-6)
        for f in (0.1, 8.0, 11.84, 12.34, 40.0):
            stranger = 20 * math.log10(abs(response([biquad], f, 62.5e-6)[0]))
            assert shape_of(biquad, 62.5e-6).gain_db(f) == pytest.approx(stranger, abs=2e-3)

    def test_backward_euler_keeps_the_frequency_and_adds_half_w_t_of_damping(self):
        w_t = 2 * math.pi * 10.0 * 62.5e-6
        euler = polynomial_of(Quadratic(10.0, 0.028), 62.5e-6, "backward Euler prewarped")
        found = quadratic_of(euler, 62.5e-6)
        assert found.frequency_hz == pytest.approx(10.0, rel=2e-4)
        assert found.zeta - 0.028 == pytest.approx(w_t / 2, rel=0.01)
        assert w_t / 2 == pytest.approx(0.00196, abs=1e-5)
        undamped = np.roots(polynomial_of(Quadratic(10.0, 0.0), 62.5e-6, "backward Euler prewarped"))
        assert abs(np.angle(undamped[0])) == pytest.approx(w_t, rel=1e-9)

    def test_prewarping_puts_the_zero_where_it_is_said(self):
        biquad = biquad_of(Quadratic(18.0, 1e-6), Quadratic(18.5, 0.1), 1e-3, "bilinear prewarped")
        assert abs(response([biquad], 18.0, 1e-3)[0]) < 1e-4
        assert shape_of(biquad, 1e-3).zero_hz == pytest.approx(18.019, abs=1e-3)  # the bilinear frequency of the same roots

    def test_a_frequency_beyond_the_rule_is_refused(self):
        with pytest.raises(ValueError, match="600 Hz is not possible with the bilinear prewarped"):
            polynomial_of(Quadratic(600.0, 0.1), 1e-3, "bilinear prewarped")
        with pytest.raises(ValueError, match="backward Euler"):
            polynomial_of(Quadratic(300.0, 0.1), 1e-3, "backward Euler prewarped")

    def test_what_is_no_oscillation_is_no_notch(self):
        real = shape_of(Biquad(1.0, -2.0, 1.0, -2.0, 1.0 - 1e-5), 1e-3)
        assert (real.pole_hz, real.zeta_pole, real.zero_hz) == (0.0, math.inf, 0.0)
        assert not real.is_notch
        lowpass = shape_of(Biquad(0.25, 0.5, 0.25, -0.1, 0.1), 1e-3)
        assert lowpass.zero_hz == math.inf
        assert not lowpass.is_notch
        assert not shape_of(Biquad(1.0, -1.9, 0.95, -2.0, 1.1), 1e-3).is_stable
        assert shape_of(Biquad(1.0, 0.0, 0.0, -2.0, 1.0), 1e-3).dc_gain == math.inf

    @pytest.mark.parametrize("zeta", [0.0, -0.1, math.nan, math.inf])
    def test_a_target_without_damping_is_refused(self, zeta):
        with pytest.raises(ValueError, match="zeta_zero"):
            NotchTarget(8.0, 8.5, zeta, 0.1)


class TestFourthOrder:
    @given(st.lists(st.tuples(frequencies, dampings), min_size=4, max_size=4), rates)
    def test_two_biquads_do_what_the_fourth_order_does(self, pairs, rate):
        z1, p1, z2, p2 = (Quadratic(*pair) for pair in pairs)
        first, second = biquad_of(z1, p1, 1 / rate), biquad_of(z2, p2, 1 / rate)
        b = np.polymul(first[:3], second[:3])
        a = np.polymul([1.0, *first[3:]], [1.0, *second[3:]])
        found = factors(list(np.float64(np.float32(b))), [1.0, *np.float64(np.float32(a[1:]))])
        at = np.array([0.3 * rate, 0.1 * rate, 100.0])
        wanted = signal.freqz(np.float32(b).astype(float), np.float32(a).astype(float), worN=2 * np.pi * at / rate)[1]
        assert response(found, at, 1 / rate) == pytest.approx(wanted, rel=1e-6)

    @staticmethod
    def two_notches(period_s):
        """k = 2 and k = 4 at the resonance, as one filter of order 4."""
        pairs = [biquad_of(Quadratic(f, 0.028), Quadratic(f + 0.5, 0.1), period_s) for f in (11.84, 23.68)]
        b, a = np.polymul(pairs[0][:3], pairs[1][:3]), np.polymul([1.0, *pairs[0][3:]], [1.0, *pairs[1][3:]])
        return {f"b{n}": float(v) for n, v in enumerate(b)} | {f"a{n}": float(v) for n, v in enumerate(a) if n}

    def test_two_notches_are_found_again(self):
        c = self.two_notches(250e-6)
        shapes = [shape_of(q, 250e-6) for q in factors([c[f"b{n}"] for n in range(5)], [1.0, *(c[f"a{n}"] for n in range(1, 5))])]
        assert [s.zero_hz for s in shapes] == pytest.approx([11.84, 23.68], rel=1e-3)
        assert [s.pole_hz for s in shapes] == pytest.approx([12.34, 24.18], rel=1e-3)

    @pytest.mark.parametrize(("rate_hz", "zeros"), [(1e3, (11.82, 23.69)), (4e3, (14.64, 22.06)), (8e3, (0.0, 31.35))])
    def test_two_notches_in_one_filter_of_singles_are_lost(self, rate_hz, zeros):
        """Σa is (ω₁T)²(ω₂T)², 5·10⁻⁷ at 4 kHz, the last bit of a₂ = 6 is 5·10⁻⁷: order 4 needs more than a single holds."""
        profile = coefficient_drive(rate_hz, higher=True)
        held = held_filter(profile, self.two_notches(1 / rate_hz) | {"filter_type": 1.0})
        shapes = [shape_of(biquad, 1 / rate_hz) for biquad in held]
        assert [s.zero_hz for s in shapes] == pytest.approx(zeros, abs=6e-3)
        assert all(s.is_stable for s in shapes) == (rate_hz < 8e3)

    @pytest.mark.parametrize(
        ("b", "a"),
        [
            ([0.0, 0.0, 0.0, 0.0, 0.5], [1.0, -0.5, 0.0, 0.0, 0.0]),
            ([0.0, 0.2, 0.1, 0.0, 0.05], [1.0, -0.9, 0.1, 0.2, 0.01]),
            ([1.0, -0.5, 0.0, 0.0, 0.3], [1.0, -1.5, 0.7, -0.2, 0.02]),
            ([0.0] * 5, [1.0, 0.1, 0.0, 0.0, 0.2]),
        ],
    )
    def test_delays_and_real_roots(self, b, a):
        at = np.array([50.0, 200.0, 450.0])
        wanted = signal.freqz(b, a, worN=2 * np.pi * at / 1000.0)[1]
        assert response(factors(b, a), at, 1e-3) == pytest.approx(wanted, rel=1e-9, abs=1e-12)


class TestWordLength:
    """Poles of ζ = 0.028 at 8, 11.84 and 18 Hz, bilinear, each coefficient rounded by itself."""

    @staticmethod
    def poles(rate_hz, bits, frequency_hz):
        _, _, _, a1, a2 = biquad_of(Quadratic(frequency_hz, 0.028), Quadratic(frequency_hz, 0.028), 1 / rate_hz)
        rounded = [float(np.float32(a)) if bits is None else round(a * 2**bits) / 2**bits for a in (a1, a2)]
        return shape_of(Biquad(1.0, 0.0, 0.0, *rounded), 1 / rate_hz).pole_hz

    @pytest.mark.parametrize(
        ("rate_hz", "bits", "expected"),
        [
            (1e3, 14, (7.97, 11.82, 17.99)),
            (1e3, 15, (8.02, 11.85, 18.01)),
            (4e3, 14, (7.04, 12.19, 17.94)),
            (4e3, 15, (7.87, 11.67, 17.94)),
            (5e3, 14, (8.79, 10.77, 17.59)),
            (5e3, 15, (8.79, 12.44, 18.13)),
            (16e3, 14, (0.0, 19.90, 19.90)),  # 0: real poles
            (16e3, 15, (0.0, 0.0, 19.90)),
            (16e3, None, (7.986, 11.829, 17.999)),
            (20e3, 14, (0.0, 24.87, 24.87)),
            (20e3, 15, (0.0, 0.0, 17.59)),
            (20e3, None, (8.039, 11.837, 17.993)),
            (4e3, None, (8.0, 11.84, 18.0)),
            (5e3, None, (8.0, 11.84, 18.0)),
        ],
    )
    def test_poles_that_are_left(self, rate_hz, bits, expected):
        found = [self.poles(rate_hz, bits, f) for f in (8.0, 11.84, 18.0)]
        within = 3e-3 if rate_hz == 5e3 and bits is None else 1e-3 if bits is None else 6e-3
        assert found == pytest.approx(expected, abs=within)

    @pytest.mark.parametrize("rate_hz", [1e3, 4e3, 5e3, 16e3, 20e3])
    @pytest.mark.parametrize("target", TABLE_3)
    def test_singles_are_accepted_with_the_dc_gain_to_the_last_bit(self, rate_hz, target):
        found = realise(coefficient_drive(rate_hz), target)
        assert found.is_exact
        assert abs(found.deviations.zero_hz) < 0.04
        assert abs(found.deviations.pole_hz) < 0.04
        assert found.held.dc_gain == 1.0
        assert found.deviations.offset_share == pytest.approx(1.0, abs=0.02)
        assert all(np.float32(value) == value for value in found.values.values())

    def test_singles_rounded_one_by_one_lose_the_dc_gain_at_16_khz(self):
        target = NotchTarget.at_speed(2, 4.0, *AXIS_2)
        exact = biquad_of(Quadratic(8.0, 0.028), Quadratic(8.5, 0.1), 62.5e-6)
        rounded = shape_of(Biquad(*(float(np.float32(c)) for c in exact)), 62.5e-6)
        assert abs(rounded.dc_gain - 1.0) > 1e-3
        assert realise(coefficient_drive(16e3), target).held.dc_gain == 1.0

    @pytest.mark.parametrize("rps", [4.0, 5.0, 5.92, 6.0])
    def test_15_bits_at_4_khz_are_refused_with_the_numbers(self, rps):
        target = NotchTarget.at_speed(2, rps, *AXIS_2)
        with pytest.raises(NotRealisableError) as refused:
            realise(coefficient_drive(4e3, 15), target)
        error = refused.value
        assert error.profile == "emulated_drive"
        assert any(f"instead of {target.zero_hz:.2f}" in reason or f"instead of {target.pole_hz:.2f}" in reason
                   for reason in error.reasons)  # fmt: skip
        nearest = realise(coefficient_drive(4e3, 15), target, allow_approximate=True)
        assert nearest.reasons == error.reasons
        assert max(abs(nearest.deviations.zero_hz), abs(nearest.deviations.pole_hz)) > 0.05

    @pytest.mark.ci
    @pytest.mark.parametrize(
        ("rate_hz", "bits", "passing"), [(1e3, 15, 26), (4e3, 15, 11), (16e3, 15, 1), (4e3, 18, 26), (16e3, 24, 26)]
    )
    def test_at_how_many_of_26_speeds_a_word_holds_the_notch(self, rate_hz, bits, passing):
        """A short word has a grid of frequencies: some speeds fall on it, and the notch that follows the speed does not."""
        held = 0
        for rps in np.linspace(4.0, 9.0, 26):
            with contextlib.suppress(NotRealisableError):
                held += realise(coefficient_drive(rate_hz, bits), NotchTarget.at_speed(2, rps, *AXIS_2)).is_exact
        assert held == passing

    def test_8_bits_at_16_khz_leave_no_notch_even_approximately(self):
        with pytest.raises(NotRealisableError, match="not a stable notch"):
            realise(coefficient_drive(16e3, 8), NotchTarget.at_speed(2, 4.0, *AXIS_2), allow_approximate=True)

    @given(st.floats(4.0, 9.0), rates, st.sampled_from([18, 20, 22, 24, 26, 28]))
    def test_the_error_halves_with_every_bit(self, rps, rate, bits):
        """One bit of Σa is 2⁻ᶠ/(ωT)² of the squared frequency, one of a₂ is 2⁻ᶠ/(2ωT) of the damping."""
        target = NotchTarget.at_speed(2, rps, *AXIS_2)
        w_t = 2 * math.pi * target.zero_hz / rate
        step = 2.0**-bits
        bound = step * max(target.zero_hz / w_t**2 / 0.05, 1 / (target.zeta_zero * w_t) / 0.05)
        if bound < 2.0:
            found = realise(coefficient_drive(rate, bits), target, allow_approximate=True)
            assert max(Tolerance().excess(target, found.held).values()) <= bound / 2

    def test_the_search_never_does_worse_than_rounding(self):
        for bits in (15, 18, 24):
            for target in TABLE_3:
                exact = biquad_of(Quadratic(target.zero_hz, target.zeta_zero), Quadratic(target.pole_hz, target.zeta_pole), 1e-3)
                rounded = shape_of(Biquad(*(round(c * 2**bits) / 2**bits for c in exact)), 1e-3)
                held = realise(coefficient_drive(1e3, bits), target, allow_approximate=True).held
                excess = [max(Tolerance().excess(target, shape).values()) for shape in (held, rounded)]
                assert excess[0] <= excess[1]


class TestCoefficients:
    def test_values_are_ready_to_write_and_held_filter_reads_them_back(self):
        for a_sign in (-1, 1):
            profile = coefficient_drive(8e3, a_sign=a_sign, higher=True)
            found = realise(profile, NOTCH)
            assert next(iter(found.values.items())) == ("filter_type", 1.0)
            assert found.values["b3"] == found.values["a4"] == 0.0
            assert math.copysign(1.0, found.values["a1"]) == a_sign
            assert held_filter(profile, found.values) == found.biquads
            assert held_filter(profile, found.values | {"filter_type": 0.0}) == ()

    def test_plain_integers_with_fraction_bits_are_the_same_as_a_scale(self):
        scaled = coefficient_drive(4e3, 28)
        facts = scaled.model_dump(by_alias=True)
        for name in ("b0", "b1", "b2", "a1", "a2"):
            facts["parameters"][name]["scale"] = 1.0
        plain = Profile.model_validate(facts)
        found = realise(plain, NOTCH)
        assert found.values["a1"] == realise(scaled, NOTCH).values["a1"] * 2**28
        assert found.biquads == realise(scaled, NOTCH).biquads == held_filter(plain, found.values)

    def test_a_gain_before_the_numerator_keeps_it_within_its_word(self):
        with pytest.raises(NotRealisableError, match="outside"):
            realise(coefficient_drive(4e3, 30), NotchTarget.at_speed(2, 4.0, 0.7, 0.036, 0.1))  # b₁ is below −2
        found = realise(coefficient_drive(4e3, 29, gain=True), NotchTarget.at_speed(2, 4.0, 0.7, 0.036, 0.1))
        assert (found.values["gain"], found.biquads[0].b1 < -2.0) == (1.0, True)
        facts = coefficient_drive(4e3, 30, gain=True).model_dump(by_alias=True)
        facts["parameters"]["gain"]["scale"] = 2.0**-20
        facts["parameters"]["a1"]["data_type"] = "INTEGER64"
        found = realise(Profile.model_validate(facts), NotchTarget.at_speed(2, 4.0, 0.7, 0.036, 0.1))
        assert (found.values["gain"], found.biquads[0].b1 < -2.0) == (2.0, True)

    def test_scaling_not_known_is_refused_before_anything_is_computed(self):
        facts = coefficient_drive(4e3).model_dump(by_alias=True)
        facts["notch"]["word"] = "integer, scaling not known"
        with pytest.raises(NotRealisableError, match="scaling of its integer coefficients is not known"):
            realise(Profile.model_validate(facts), NOTCH, allow_approximate=True)
        with pytest.raises(NotRealisableError, match="scaling"):
            held_filter(Profile.model_validate(facts), {"filter_type": 1.0})

    def test_a_period_that_is_not_known_has_to_be_stated(self):
        facts = coefficient_drive(4e3, period=False).model_dump(by_alias=True)
        facts["loop"]["period_s"] = None
        profile = Profile.model_validate(facts)
        with pytest.raises(NotRealisableError, match=r"period .* not known"):
            realise(profile, NOTCH)
        assert realise(profile, NOTCH, period_s=125e-6).period_s == 125e-6

    def test_one_object_of_bytes_is_refused(self):
        facts = coefficient_drive(4e3).model_dump(by_alias=True)
        facts["parameters"]["b0"] |= {"data_type": "DOMAIN"}
        with pytest.raises(NotRealisableError, match="object of bytes"):
            realise(Profile.model_validate(facts), NOTCH)

    def test_a_missing_part_and_a_read_only_one_are_named_together(self):
        facts = coefficient_drive(4e3).model_dump(by_alias=True)
        del facts["notch"]["sections"][0]["parts"]["a2"]
        facts["parameters"]["b0"] |= {"access": "ro"}
        with pytest.raises(NotRealisableError) as refused:
            realise(Profile.model_validate(facts), NOTCH)
        assert refused.value.reasons == ("no parameter is known for a2", "b0 (3000:0) is read only")

    def test_values_that_are_missing_are_the_factory_s_or_named(self):
        profile = coefficient_drive(4e3)
        with pytest.raises(NotRealisableError, match=r"filter_type .* has no value"):
            held_filter(profile, {})
        facts = profile.model_dump(by_alias=True)
        facts["parameters"]["filter_type"]["default"] = 0
        assert held_filter(Profile.model_validate(facts), {}) == ()
        with pytest.raises(NotRealisableError, match=r"b0 .* has no value"):
            held_filter(profile, {"filter_type": 1.0})

    def test_no_filter_and_no_such_section(self):
        with pytest.raises(NotRealisableError, match="its profile has no filter"):
            realise(drive(None), NOTCH)
        assert held_filter(drive(None), {}) == ()
        with pytest.raises(NotRealisableError, match="no filter section 2; its sections are 1 to 1"):
            realise(coefficient_drive(4e3), NOTCH, section=1)


class TestZeroPole:
    @pytest.mark.parametrize("rule", ["bilinear", "bilinear prewarped", "backward Euler prewarped"])
    @pytest.mark.parametrize("target", TABLE_3)
    def test_free_numbers_are_stated_such_that_the_discretisation_gives_the_target(self, rule, target):
        found = realise(zero_pole_drive(rule, zero_q={"maximum": 100.0}), target)
        assert abs(found.deviations.zero_hz) < 1e-4
        assert abs(found.deviations.zeta_zero) < 1e-4
        assert abs(found.deviations.depth_db) < 1e-2

    def test_backward_euler_asks_for_a_higher_q(self):
        found = realise(zero_pole_drive(zero_q={"maximum": 100.0}), NOTCH)
        assert 0.5 / found.values["zero_q"] == pytest.approx(0.028 - math.pi * 11.84 * 62.5e-6, rel=1e-3)

    def test_a_q_of_5_is_refused_and_approximate_with_the_depth_it_costs(self):
        with pytest.raises(NotRealisableError) as refused:
            realise(zero_pole_drive(), NOTCH)
        assert "the zeros' damping cannot be 0.0257; the nearest is 0.1 (zero_q = 5)" in refused.value.reasons
        nearest = realise(zero_pole_drive(), NOTCH, allow_approximate=True)
        assert not nearest.is_exact
        assert nearest.held.zeta_zero == pytest.approx(0.1 + math.pi * 11.84 * 62.5e-6, rel=0.01)
        assert nearest.held.zero_hz == pytest.approx(11.84, abs=1e-2)
        assert nearest.deviations.depth_db == pytest.approx(11.26, abs=0.01)  # of 11.4: next to nothing is left
        assert nearest.target.shape.gain_db(11.84) == pytest.approx(-11.4, abs=0.1)

    def test_the_range_is_refused_with_both_numbers(self):
        target = NotchTarget.at_speed(2, 4.0, *AXIS_2)
        for allow in (False, True):
            with pytest.raises(NotRealisableError, match="starts at 50 Hz; the zeros need 8 Hz"):
                realise(zero_pole_drive(min_frequency_hz=50.0), target, allow_approximate=allow)
        with pytest.raises(NotRealisableError, match="ends at 5 Hz; the zeros need 8 Hz"):
            realise(zero_pole_drive(max_frequency_hz=5.0), target)

    def test_whole_hertz_lose_the_offset(self):
        profile = zero_pole_drive(zero_q={"maximum": 100.0}, frequency_step_hz=1.0)
        with pytest.raises(NotRealisableError, match=r"zeros at 12\.00 Hz instead of 11\.84"):
            realise(profile, NOTCH)
        nearest = realise(profile, NOTCH, allow_approximate=True)
        assert (nearest.values["zero_frequency"], nearest.values["pole_frequency"]) == (12.0, 12.0)
        assert nearest.deviations.offset_share == pytest.approx(0.0, abs=0.01)

    def test_an_unknown_discretisation_is_a_doubt_about_the_damping(self):
        profile = zero_pole_drive("not known", zero_q={"maximum": 100.0})
        with pytest.raises(NotRealisableError, match=r"the damping of the zeros may be off by 0\.0023, 8 %"):
            realise(profile, NOTCH)
        assert realise(profile, NOTCH, period_s=31.25e-6).is_exact

    def test_the_factory_s_limits_of_damping_hold(self):
        profile = zero_pole_drive(zero_q={"maximum": 100.0}, max_pole_damping=0.05)
        with pytest.raises(NotRealisableError, match=r"the poles' damping cannot be 0\.\d+; the nearest is 0\.05"):
            realise(profile, NOTCH)


class TestSymmetric:
    @pytest.mark.parametrize(("kind", "unit", "value"), [("q", "", 5.0), ("damping", "", 0.1), ("bandwidth", "Hz", 2.368)])
    def test_the_missing_separate_pole_is_named(self, kind, unit, value):
        profile = symmetric_drive(kind, unit, min_zero_damping=0.028)
        with pytest.raises(NotRealisableError, match=r"cannot hold the poles 0\.5 Hz from the zeros at 11\.84 Hz"):
            realise(profile, NOTCH)
        nearest = realise(profile, NOTCH, allow_approximate=True)
        assert nearest.values["width"] == pytest.approx(value, rel=1e-6)
        assert nearest.deviations.offset_share == pytest.approx(0.0, abs=1e-6)
        assert abs(nearest.deviations.depth_db) < 0.5  # as deep as the paper's, without its phase

    def test_without_an_offset_it_is_the_notch(self):
        target = NotchTarget(11.84, 11.84, 0.028, 0.1)
        assert realise(symmetric_drive(min_zero_damping=0.028), target).is_exact
        with pytest.raises(NotRealisableError, match="the damping of its zeros is fixed at 0"):
            realise(symmetric_drive(), target)

    def test_an_infinitely_deep_notch_is_approximate(self):
        nearest = realise(symmetric_drive(), NOTCH, allow_approximate=True)
        assert nearest.deviations.depth_db < -100.0

    def test_a_width_in_an_unknown_unit_is_refused(self):
        with pytest.raises(NotRealisableError, match=r"width is in %: its relation to Hz is not known"):
            realise(symmetric_drive("bandwidth", "%"), NOTCH)


class TestVariable:
    def test_the_emulated_drive_holds_the_paper_s_notch(self):
        for target in TABLE_3:
            found = realise(EMULATED, target)
            assert found.is_exact
            assert set(found.values) == {"notch_1.offset_hz", "notch_1.zeta_rn", "notch_1.zeta_rdth"}
            assert abs(found.deviations.depth_db) < 1e-5
        assert set(realise(EMULATED, NOTCH, section=1).values) == {"notch_2.offset_hz", "notch_2.zeta_rn", "notch_2.zeta_rdth"}

    def test_it_is_no_fixed_filter(self):
        assert held_filter(EMULATED, {"notch_1.mode": 1.0}) == ()


def passes_everywhere(profile):
    """Whether every notch of Table 3, from 4 to 9 rps, is held within the tolerance; and the first refusal."""
    known = profile.notch and (profile.notch.period_s or (profile.loop and profile.loop.period_s))
    for period_s in (None,) if known else (62.5e-6, 125e-6, 250e-6):
        for target in TABLE_3:
            try:
                realise(profile, target, period_s=period_s)
            except NotRealisableError as error:
                return False, str(error)
    return True, ""


@pytest.mark.parametrize("name", available())
def test_a_profile_says_exact_just_when_the_notch_is_held(name):
    profile = Profile.load(name)
    if profile.capabilities is None:
        return
    passes, reason = passes_everywhere(profile)
    assert (profile.capabilities.notch_inside.answer == "exact") == passes, reason


class TestTolerance:
    def test_a_tenth_of_the_offset_and_a_twentieth_of_the_damping_cost_what_is_said(self):
        before = NOTCH.shape.gain_db(11.84)
        shifted = NotchTarget(11.89, 12.34, 0.028, 0.1).shape.gain_db(11.84)
        shallower = NotchTarget(11.84, 12.34, 0.028 * 1.05, 0.1).shape.gain_db(11.84)
        assert shifted - before == pytest.approx(0.1, abs=0.05)
        assert shallower - before == pytest.approx(0.4, abs=0.05)

    def test_frequency_tolerance_is_a_share_of_the_offset_or_of_the_width(self):
        assert Tolerance().frequency_hz(NOTCH) == pytest.approx(0.05)
        assert Tolerance().frequency_hz(NotchTarget(11.84, 11.84, 0.028, 0.1)) == pytest.approx(0.033, abs=1e-3)


class TestGains:
    @given(
        st.floats(0.1, 500.0),
        st.floats(1e-4, 100.0),
        st.floats(1e-3, 1000.0),
        st.complex_numbers(min_magnitude=0.01, max_magnitude=1e4, allow_nan=False, allow_infinity=False),
        st.floats(-1.0, 1.0),
        st.floats(-1.0, 1.0),
    )
    def test_the_pid_is_the_p_pi(self, k_p, k_v, k_vi, s, r, theta):
        pid = pid_gains(k_p, k_v, k_vi)

        def close(a, b):
            assert a == pytest.approx(b, rel=1e-9, abs=1e-9 * abs(k_v + k_vi / s) * (k_p + abs(s)))

        p, i, d = pid.proportional_nm_rad, pid.integral_nm_rad_s, pid.derivative_nm_s_rad
        close((p + i / s + d * s) * theta, (k_v + k_vi / s) * (k_p + s) * theta)
        on_error = (p + i / s + d * s) * (r - theta)
        close(on_error, (k_v + k_vi / s) * (k_p * (r - theta) + s * r - s * theta))  # with full velocity feed-forward
        bare = (k_v + k_vi / s) * (k_p * (r - theta) - s * theta)
        close(on_error + (pid.reference_velocity_nm_s_rad * s + pid.reference_position_nm_rad) * r, bare)
        if abs(pid.reference_lag_s * s + 1) > 1e-3:
            lagged = r / (pid.reference_lag_s * s + 1)
            assert (p + i / s + d * s) * (lagged - theta) == pytest.approx(
                bare, rel=1e-6, abs=1e-6 * abs(k_v + k_vi / s) * (k_p + abs(s))
            )

    def test_the_emulated_drive_takes_them_as_they_are(self):
        assert gains_for(EMULATED, **GAINS) == pytest.approx(GAINS, rel=1e-6)

    @staticmethod
    def with_loop(structure="P-PI", gains=None, **parameters):
        return drive(None, {"structure": structure, "gains": gains or {}}, **parameters)

    def test_an_integral_time_and_a_gain_in_milliamperes_per_hertz(self):
        profile = self.with_loop(
            gains={
                "position_gain_per_s": {"parameter": "kp_hz", "factor": 2 * math.pi},
                "velocity_gain_nm_s_rad": {"parameter": "kv", "factor": 1e-3 / (2 * math.pi), "times_torque_constant": True},
                "velocity_integral_time_s": {"parameter": "ti", "factor": 1e-6},
            },
            kp_hz={"unit": "Hz"},
            kv={"data_type": "UNSIGNED32", "unit": "mA/Hz"},
            ti={"data_type": "UNSIGNED32", "unit": "us"},
        )
        with pytest.raises(NotRealisableError, match="kv is in amperes: the motor's torque constant is needed"):
            gains_for(profile, **GAINS)
        found = gains_for(profile, **GAINS, torque_constant_nm_a=0.1)
        assert found["kv"] == round(0.196 / 0.1 * 1e3 * 2 * math.pi)
        assert found["ti"] == 50_000
        assert found["kp_hz"] == pytest.approx(25 / (2 * math.pi))

    def test_a_pid_takes_the_converted_gains(self):
        roles = ("proportional_nm_rad", "integral_nm_rad_s", "derivative_nm_s_rad")
        names = dict(zip(roles, ("p", "i", "d"), strict=True))
        profile = self.with_loop("PID", {r: {"parameter": n, "factor": 0.5} for r, n in names.items()}, p={}, i={}, d={})
        assert gains_for(profile, **GAINS) == pytest.approx({"p": 2 * 8.82, "i": 2 * 98.0, "d": 2 * 0.196}, rel=1e-6)

    def test_everything_that_is_missing_is_named(self):
        profile = self.with_loop(gains={"position_gain_per_s": {"parameter": "kp"}}, kp={"data_type": "UNSIGNED16"})
        with pytest.raises(NotRealisableError) as refused:
            gains_for(profile, **GAINS)
        assert refused.value.reasons == (
            "the scaling of kp (3000:0) is not known",
            "no parameter of its loop is known to hold velocity_gain_nm_s_rad",
            "no parameter of its loop is known to hold velocity_integral_gain_nm_rad",
        )
        with pytest.raises(NotRealisableError, match="not accessible"):
            gains_for(self.with_loop("not accessible"), **GAINS)

    def test_counts_need_the_scaling(self):
        gains = {role: {"parameter": role, "factor": 1.0} for role in GAINS}
        gains["position_gain_per_s"] = {"parameter": "kp", "factor": 1.0}
        profile = self.with_loop(gains=gains, kp={"data_type": "INTEGER32", "scale": "counts"})
        with pytest.raises(NotRealisableError, match="kp counts in counts: the drive's scaling is needed"):
            gains_for(profile, **GAINS)
        assert gains_for(profile, **GAINS, scaling=Scaling(131072, 7.1))["kp"] == pytest.approx(25.0, rel=1e-4)

    def test_a_coarse_step_and_a_full_range_are_refused(self):
        def with_factor(factor, **extra):
            gains = {role: {"parameter": role, "factor": 1.0} for role in GAINS}
            gains["velocity_gain_nm_s_rad"] = {"parameter": "kv", "factor": factor}
            return self.with_loop(gains=gains, kv={"data_type": "UNSIGNED16", **extra})

        with pytest.raises(NotRealisableError, match=r"kv would hold 2 instead of 2\.333, -14 %"):
            gains_for(with_factor(0.084), **GAINS)
        with pytest.raises(NotRealisableError, match="outside"):
            gains_for(with_factor(1e-6), **GAINS)
        with pytest.raises(NotRealisableError, match="read only"):
            gains_for(with_factor(1e-3, access="ro"), **GAINS)
        assert gains_for(with_factor(1e-3), **GAINS)["kv"] == 196

    def test_gains_that_are_none_are_the_caller_s_mistake(self):
        with pytest.raises(ValueError, match="position_gain_per_s = 0"):
            gains_for(EMULATED, **GAINS | {"position_gain_per_s": 0.0})
        with pytest.raises(ValueError, match="must be positive"):
            pid_gains(0.0, 1.0, 1.0)


def test_the_refusal_is_an_error_of_the_package_with_its_attributes():
    error = NotRealisableError("x", ("a", "b"))
    assert isinstance(error, DriveProfileError)
    assert (error.profile, error.reasons, str(error)) == ("x", ("a", "b"), "x: a; b")
    assert not issubclass(NotRealisableError, OutOfRangeError)


@given(frequencies, dampings, rates, rules)
def test_what_is_stated_comes_out(frequency_hz, zeta, rate, rule):
    told = stated(Quadratic(frequency_hz, zeta), 1 / rate, rule)
    assert quadratic_of(polynomial_of(told, 1 / rate, rule), 1 / rate) == pytest.approx((frequency_hz, zeta), rel=1e-5)


class TestCommands:
    @staticmethod
    def invoke(*arguments):
        return CliRunner().invoke(app, [str(argument) for argument in arguments])

    def test_realise_shows_wanted_and_held(self):
        result = self.invoke("realise", "emulated_drive", "--speed-rps", 5.92)
        assert result.exit_code == 0
        assert "emulated_drive: exact, filter period 250 µs" in result.stdout
        rows = [line.split() for line in result.stdout.splitlines()]
        assert ["zeros,", "Hz", "11.8400", "11.8400", "+0.0000"] in rows
        assert ["notch_1.zeta_rn", "2110:6"] in [row[:2] for row in rows]

    def test_realise_as_json(self):
        result = self.invoke("realise", "emulated_drive", "--speed-rps", 5.92, "--section", 2, "--json")
        facts = json.loads(result.stdout)
        assert facts["is_exact"] is True
        assert facts["target"]["pole_hz"] == 12.34
        assert set(facts["biquads"][0]) == {"b0", "b1", "b2", "a1", "a2"}

    def test_not_realisable_is_9_with_the_reasons(self):
        result = self.invoke("realise", "emulated_drive", "--speed-rps", 5000)
        assert result.exit_code == 9
        assert "its filter ends at 1900 Hz; the zeros need 10000 Hz" in result.stderr
        result = self.invoke("realise", "emulated_drive", "--speed-rps", 5.92, "--section", 3, "--json")
        assert result.exit_code == 9
        assert json.loads(result.stdout)["reasons"] == ["it has no filter section 3; its sections are 1 to 2"]

    @pytest.mark.parametrize(
        "arguments",
        [
            ("realise", "nobody", "--speed-rps", 5.92),
            ("realise", "emulated_drive", "--speed-rps", -1),
            ("realise", "emulated_drive", "--speed-rps", 5.92, "--period-us", 0),
            ("realise", "emulated_drive"),
            ("gains", "emulated_drive", "--position-gain", -1, "--velocity-gain", 1, "--velocity-integral-gain", 1),
        ],
    )
    def test_wrong_usage_is_2(self, arguments):
        assert self.invoke(*arguments).exit_code == 2

    def test_gains(self):
        arguments = ("--position-gain", 25, "--velocity-gain", 0.196, "--velocity-integral-gain", 3.92)
        result = self.invoke("gains", "emulated_drive", *arguments)
        assert result.exit_code == 0
        assert ["position_gain_per_s", "2100:1", "25", "1/s"] in [line.split() for line in result.stdout.splitlines()]
        facts = json.loads(self.invoke("gains", "emulated_drive", *arguments, "--json").stdout)
        assert facts["values"]["position_gain_per_s"] == 25.0
        assert facts["pid"] is None

    def test_an_approximation_is_shown_as_one(self, monkeypatch):
        monkeypatch.setattr(Profile, "load", lambda name: zero_pole_drive())
        result = self.invoke("realise", "akd", "--speed-rps", 5.92, "--approximate")
        assert result.exit_code == 0
        assert ": lost, filter period" in result.stdout
        assert "the notch is lost: -0.1 dB at its frequency instead of -11.4 dB" in result.stdout
        assert "the zeros' damping cannot be 0.0257" in result.stdout
        assert "+11.26" in result.stdout
        assert self.invoke("realise", "akd", "--speed-rps", 5.92).exit_code == 9

    def test_what_is_unverified_is_said(self, monkeypatch):
        facts = zero_pole_drive(zero_q={"maximum": 100.0}, evidence="unverified", note="Nobody has tried.").model_dump(
            by_alias=True
        )
        facts["loop"] |= {"evidence": "unverified", "note": "A guess."}
        monkeypatch.setattr(Profile, "load", lambda name: Profile.model_validate(facts))
        assert "unverified: Nobody has tried." in self.invoke("realise", "x", "--speed-rps", 5.92).stdout
        arguments = ("--position-gain", 25, "--velocity-gain", 0.196, "--velocity-integral-gain", 3.92)
        assert "unverified: A guess." in self.invoke("gains", "x", *arguments).stdout
