"""The cancellation follows angle, speed and direction, begins gently, and never exceeds what its table says."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.control.cancellation import CancellationLaw
from hil.control.cancellation_table import CancellationTable, MotorLoad, WaveLabel
from tests.hil.control.inside import inner_cancellation
from tests.oracles.law import InnerCancellation

PERIOD_S = 0.001
STEP_RPS = 0.05


def table(orders: tuple[int, ...] = (2, 4), speeds: int = 200) -> CancellationTable:
    """Amplitude and phase that grow with the speed."""
    rps = np.arange(speeds) * STEP_RPS
    reference = np.array([1e-3 * order * (1.0 + 0.2 * rps) * np.exp(0.1j * order * rps) for order in orders])
    waves = tuple(WaveLabel(order, 0.7 * order, 1, frozenset({order})) for order in orders)
    return CancellationTable(waves, STEP_RPS, reference, 10.0 * reference.conj(), np.zeros(reference.shape))


def mixed() -> CancellationTable:
    """Orders 2 and 4, what the motor makes of them, and order 6, which both make together."""
    own = table()
    both = WaveLabel(6, 0.1, 2, frozenset({2, 4}))
    reference, torque = (np.vstack([part, 0.1 * part[:1]]) for part in (own.reference, own.torque))
    motion = np.vstack([np.full((2, reference.shape[1]), 0.01), np.zeros((1, reference.shape[1]))])
    return CancellationTable((*own.waves, both), STEP_RPS, reference, torque, motion)


def expected(cancellation: CancellationTable, angle: float, speed_rps: float, *, torque: bool = False) -> float:
    values = cancellation.torque if torque else cancellation.reference
    total = 0.0
    for wave, row in zip(cancellation.waves, values, strict=True):
        gain = complex(np.interp(abs(speed_rps), cancellation.speeds_rps, row.real))
        gain += 1j * complex(np.interp(abs(speed_rps), cancellation.speeds_rps, row.imag))
        if speed_rps < 0.0:
            gain = gain.conjugate()
        total += (gain * np.exp(1j * (wave.order * angle + wave.phase_rad))).real
    return total


AT_ONCE = 1e-4
"""Revolutions in which a law forgets its first addition, so that the tables alone are seen."""


@pytest.mark.parametrize("speed_rps", [1.234, 5.0, 9.9, -0.7, -6.02])
def test_at_constant_speed_each_order_has_its_gain_and_phase(speed_rps: float) -> None:
    cancellation = table()
    law, angle = CancellationLaw([cancellation], PERIOD_S, fade_rev=AT_ONCE), 0.3
    for _ in range(400):
        (reference,), (torque,) = law.step([angle])
        angle += 2.0 * math.pi * speed_rps * PERIOD_S
    angle -= 2.0 * math.pi * speed_rps * PERIOD_S
    assert reference == pytest.approx(expected(cancellation, angle, speed_rps), abs=1e-9)
    assert torque == pytest.approx(expected(cancellation, angle, speed_rps, torque=True), abs=1e-8)


def test_a_motor_at_rest_stays_where_it_is_and_what_is_taken_off_for_that_is_forgotten_as_it_turns() -> None:
    cancellation, law, angle = table(), CancellationLaw([table()], PERIOD_S, fade_rev=2.0), 0.2
    assert [law.step([angle])[0][0] for _ in range(300)] == [0.0] * 300
    first, added = expected(cancellation, angle, 0.0), []
    for _ in range(4000):
        angle += 2.0 * math.pi * 2.0 * PERIOD_S
        added.append(law.step([angle])[0][0])
    turned = [0.2 + 2.0 * math.pi * 2.0 * PERIOD_S * (step + 1) for step in range(4000)]
    left = [expected(cancellation, each, 2.0) - given for each, given in zip(turned, added, strict=True)]
    assert left[999] == pytest.approx(first * math.exp(-1.0), rel=0.05)  # after two revolutions
    assert abs(left[-1]) < 0.03 * abs(first)
    law.reset()
    assert law.step([1.0])[0][0] == 0.0


def test_an_axis_without_cancellation_is_left_alone() -> None:
    law = CancellationLaw([None, table((2,)), None], PERIOD_S)
    for i in range(300):
        references, torques = law.step([0.01 * i] * 3)
    assert references[0] == references[2] == torques[0] == torques[2] == 0.0
    assert references[1] != 0.0


def test_axes_do_not_touch_each_other() -> None:
    one, two = table((2,), 40), table((2, 4))
    together, alone = CancellationLaw([one, two], PERIOD_S), [CancellationLaw([one], PERIOD_S), CancellationLaw([two], PERIOD_S)]
    for i in range(300):
        angles = [0.01 * i, 1.0 - 0.035 * i]
        references, torques = together.step(angles)
        apart = [law.step([angle]) for law, angle in zip(alone, angles, strict=True)]
        assert references == [each[0][0] for each in apart]
        assert torques == [each[1][0] for each in apart]


def test_beyond_the_table_its_last_values_stay() -> None:
    cancellation = table(speeds=21)  # up to 1 rps
    law, angle = CancellationLaw([cancellation], PERIOD_S, fade_rev=AT_ONCE), 0.0
    for _ in range(500):
        (reference,), _ = law.step([angle])
        angle += 2.0 * math.pi * 30.0 * PERIOD_S
    assert reference == pytest.approx(expected(cancellation, angle - 2.0 * math.pi * 30.0 * PERIOD_S, 1.0), abs=1e-9)


def test_whatever_the_motor_does_the_cancellation_stays_below_its_bound() -> None:
    cancellation, random = table(), np.random.default_rng(1)
    law, largest = CancellationLaw([cancellation], PERIOD_S), cancellation.largest_reference_rad()
    angle = 0.0
    for _ in range(5000):
        angle += random.normal(0.0, 0.05)
        (reference,), (torque,) = law.step([angle])
        assert abs(reference) <= largest
        assert abs(torque) <= cancellation.largest_torque_nm()
    assert cancellation.largest_reference_rad(2.0) < largest
    assert 2.0 < cancellation.largest_speed_rps(2.0) < cancellation.largest_speed_rps(8.0)


def test_torques_come_in_steps_that_add_up_to_what_is_wanted() -> None:
    cancellation, step = table(), 0.02
    fine, coarse = CancellationLaw([cancellation], PERIOD_S), CancellationLaw([cancellation], PERIOD_S, [step])
    owed = 0.0
    for i in range(1000):
        wanted, given = (law.step([0.02 * i])[1][0] for law in (fine, coarse))
        assert given / step == pytest.approx(round(given / step), abs=1e-9)
        owed += wanted - given
        assert abs(owed) <= 0.5001 * step


def test_half_of_a_cancellation_is_half_of_it() -> None:
    half = table().scaled(0.5)
    assert half.largest_reference_rad() == pytest.approx(0.5 * table().largest_reference_rad())
    assert half.waves == table().waves


def test_a_mixed_wave_goes_with_every_order_that_it_comes_from_and_with_the_product_of_their_sizes() -> None:
    assert mixed().orders == (2, 4)
    assert np.array_equal(mixed().scaled(0.5).reference[:, 100], np.array([0.5, 0.5, 0.25]) * mixed().reference[:, 100])
    assert np.array_equal(mixed().scaled(0.5).motion, 0.5 * mixed().motion)
    left = mixed().without([4])
    assert left is not None
    assert [wave.order for wave in left.waves] == [2]
    assert mixed().without([2, 4]) is None
    assert mixed().without([6]) is not None  # no order of the error


def test_sines_are_those_of_the_angle_without_what_the_motor_added() -> None:
    """The motor turns smoothly but for the motion that takes the error away; the law sees the smooth angle."""
    cancellation, speed_rps = mixed(), 3.0
    law = CancellationLaw([cancellation], PERIOD_S, fade_rev=AT_ONCE)
    for step in range(600):
        smooth = 2.0 * math.pi * speed_rps * step * PERIOD_S
        angle = smooth
        for _ in range(30):
            angle = smooth - sum(0.01 * math.cos(wave.order * angle + wave.phase_rad) for wave in cancellation.waves[:2])
        (reference,), _ = law.step([angle])
    assert reference == pytest.approx(expected(cancellation, smooth, speed_rps), rel=1e-6)


def test_on_a_ramp_the_speed_is_not_late() -> None:
    cancellation, law, angle, speed_rps = table((2,)), CancellationLaw([table((2,))], PERIOD_S, fade_rev=AT_ONCE), 0.0, 0.0
    for step in range(1000):
        speed_rps = 8.0 * step * PERIOD_S
        (reference,), _ = law.step([angle])
        now = angle
        angle += 2.0 * math.pi * speed_rps * PERIOD_S
    assert reference == pytest.approx(expected(cancellation, now, speed_rps), abs=1e-5)
    assert abs(reference - expected(cancellation, now, speed_rps - 8.0 * 8e-3)) > 3e-5


@pytest.mark.parametrize("rps_s", [6.0, -3.0])
@pytest.mark.parametrize("period_s", [0.00025, 0.001, 0.004, 0.008])
def test_on_a_ramp_speed_and_acceleration_are_those_of_now_however_long_the_period(period_s: float, rps_s: float) -> None:
    """At 8 ms the speed was half a period late, the acceleration half of what it is, and 2 % of the vibration was left."""
    plain = table((2,))
    bent = replace(plain, bend=0.01 * plain.reference, most_rad_s2=100.0)
    for cancellation, bend in ((replace(plain, most_rad_s2=100.0), 0.0), (bent, 0.01)):
        law = CancellationLaw([cancellation], period_s, fade_rev=AT_ONCE)
        for step in range(round(1.2 / period_s)):
            angle = math.pi * rps_s * (step * period_s) ** 2
            (reference,), _ = law.step([angle])
        wanted = expected(plain, angle, rps_s * step * period_s) * (1.0 + bend * 2.0 * math.pi * abs(rps_s))
        assert reference == pytest.approx(wanted, abs=1e-6)


def test_set_points_are_no_faster_than_a_limit_allows_and_the_highest_orders_give_way_first() -> None:
    whole = table((1, 2, 4), 120)
    limit_rps = whole.largest_speed_rps(5.0) - 0.01
    within = whole.within_speed(limit_rps, 5.0, 6.0)
    assert within.largest_speed_rps(5.0) <= limit_rps
    share = np.abs(within.reference) / np.maximum(np.abs(whole.reference), 1e-30)
    at_top = share[:, 100]
    assert at_top[0] == pytest.approx(1.0)
    assert at_top[2] < 1.0
    assert at_top[2] <= at_top[1] + 1e-9
    assert np.all(share[1, whole.speeds_rps <= 3.0] == pytest.approx(1.0))  # up to the frequency that is kept
    assert np.all(share[:, :20] == pytest.approx(1.0))  # where the motor is slow there is room for all


def test_what_must_be_kept_is_kept_and_left_to_the_check_of_limits() -> None:
    whole = table((1, 2), 120)
    within = whole.within_speed(5.0, 5.0, 100.0)
    assert np.allclose(within.reference, whole.reference)
    assert within.largest_speed_rps(5.0) > 5.0


def by_torque_alone(whole: CancellationTable, nm_per_rad: float) -> CancellationTable:
    return replace(whole, reference=0.0 * whole.reference, torque=nm_per_rad * whole.reference)


def test_what_the_set_points_have_no_room_for_is_left_to_the_torque() -> None:
    whole = table((1, 2, 4), 120)
    whole = replace(whole, torque=0.0 * whole.torque)
    limit_rps = whole.largest_speed_rps(5.0) - 0.01
    within = whole.within_speed(limit_rps, 5.0, 6.0, by_torque_alone(whole, 10.0), 1e3)
    used = whole.speeds_rps <= 5.0
    assert within.largest_speed_rps(5.0) <= limit_rps
    assert np.allclose((within.reference + within.torque / 10.0)[:, used], whole.reference[:, used])
    assert np.any(within.torque)
    assert not np.any(within.torque[:, :20])  # where the motor is slow there is room for all
    assert not np.any(within.torque[:, whole.speeds_rps > 5.1])  # where the motion does not go


def test_a_torque_has_its_own_limit_and_what_neither_can_do_is_left_out() -> None:
    whole = table((1, 2, 4), 120)
    whole = replace(whole, torque=0.0 * whole.torque)
    limit_rps, alone = whole.largest_speed_rps(5.0) - 0.1, by_torque_alone(whole, 10.0)
    most_nm = 0.3 * whole.within_speed(limit_rps, 5.0, 6.0, alone, 1e3).largest_torque_nm(5.0)
    within = whole.within_speed(limit_rps, 5.0, 6.0, alone, most_nm)
    assert within.largest_speed_rps(5.0) <= limit_rps
    assert within.largest_torque_nm(5.0) <= most_nm * (1.0 + 1e-9)
    assert np.any(np.abs(within.reference + within.torque / 10.0) < 0.99 * np.abs(whole.reference))


def test_the_torque_bends_with_the_acceleration_as_the_set_point_does() -> None:
    plain = replace(table((2,)), torque=10.0 * table((2,)).reference)
    bent = replace(plain, bend=0.01 * plain.reference, torque_bend=0.01 * plain.torque, most_rad_s2=40.0)
    law, angle = CancellationLaw([bent], PERIOD_S, fade_rev=AT_ONCE), 0.0
    assert bent.largest_torque_nm() == pytest.approx(1.4 * plain.largest_torque_nm())
    for step in range(600):
        (reference,), (torque,) = law.step([angle])
        angle += 2.0 * math.pi * 20.0 * step * PERIOD_S * PERIOD_S
    assert torque == pytest.approx(10.0 * reference, rel=1e-6)
    assert torque != 0.0


LOAD = MotorLoad(100.0, 1e-4, 1e-3, 0.05, 0.9, 30.0)


@pytest.mark.parametrize("speed_rps", [3.0, -3.0])
@pytest.mark.parametrize("load_nm", [20.0, -20.0, 200.0])
def test_against_the_reaction_of_a_load_it_adds_its_torque_times_the_slope_of_the_error(speed_rps: float, load_nm: float) -> None:
    """Whatever the direction, it is −r τ_g A k sin(k θ + φ); and no more than the largest load that counts."""
    size, order, phase = 1e-3, 2.0, 0.7
    none = np.zeros((1, 100), dtype=np.complex128)
    slope = np.full((1, 100), 1j * order * size)
    waves = (WaveLabel(order, phase, 1, frozenset({order})),)
    table = CancellationTable(waves, 0.1, none, none, none.real, load_torque=slope, motor_load=LOAD)
    law, angle, rate = CancellationLaw([table], PERIOD_S), 0.0, 2.0 * math.pi * speed_rps
    felt_nm = load_nm / 100.0 + 1e-3 * rate + math.copysign(0.05, rate)
    for _ in range(3000):
        now = angle
        _, (torque,) = law.step([angle], [felt_nm])
        angle += rate * PERIOD_S
    counted = min(max(load_nm, -30.0), 30.0)
    assert torque == pytest.approx(-0.9 * counted * size * order * math.sin(order * now + phase), abs=1e-4 * size * abs(load_nm))
    assert abs(torque) <= table.largest_torque_nm() == pytest.approx(0.9 * 30.0 * size * order)


def test_whatever_the_acceleration_the_bound_holds() -> None:
    plain = table((2,))
    bent = replace(plain, bend=0.01 * plain.reference, most_rad_s2=40.0)
    at_rest = float(np.abs(plain.reference[0, 0]))
    assert bent.largest_reference_rad() - at_rest == pytest.approx(1.4 * (plain.largest_reference_rad() - at_rest))
    law, angle, largest = CancellationLaw([bent], PERIOD_S), 0.0, 0.0
    for step in range(600):
        largest = max(largest, abs(law.step([angle])[0][0]))
        angle += 2.0 * math.pi * 20.0 * step * PERIOD_S * PERIOD_S * (1.0 if step < 300 else -1.0)
    assert 0.0 < largest <= bent.largest_reference_rad()


@pytest.mark.parametrize("speed", [37.0, -20.0])
def test_inside_a_drive_speed_and_torque_are_those_of_the_set_points_motion(speed: float) -> None:
    """Rates by differences of the very set-points, at the instants at which the loop measures and the torque acts."""
    lowpass_hz, period_s, inertia, damping = 300.0, 250e-6, 2.6e-4, 8e-4

    def at(angle: float) -> tuple[float, float, float]:
        known = InnerCancellation(3e-3, 1.0, 2e-3, -2.0, inertia, damping, 5e-3, 0.5)
        return inner_cancellation(known, lowpass_hz, period_s, angle, speed)

    step = 1e-5
    for angle in (0.0, 0.4, 2.0, -5.0):
        late, ahead = angle - speed / (2.0 * math.pi * lowpass_hz), angle + 0.5 * period_s * speed
        rate = (at(late + speed * step)[0] - at(late - speed * step)[0]) / (2.0 * step)
        before, here, after = (at(ahead + side * speed * step)[0] for side in (-1, 0, 1))
        slope = (after - before) / (2.0 * speed * step)
        # θ_m − Δθ_m turns at a constant speed, θ_m does not
        bend = (after - 2.0 * here + before) / step**2 / (1.0 - slope)
        torque = inertia * bend + damping * speed * slope
        assert at(angle)[1] == pytest.approx(rate, rel=1e-5, abs=1e-8)
        assert at(angle)[2] == pytest.approx(torque, rel=1e-4, abs=1e-8)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"waves": (WaveLabel(2, 0.0, 1, frozenset({2})),)}, "tables of shapes"),
        ({"motion": np.zeros((2, 3))}, "tables of shapes"),
        ({"torque": np.zeros((2, 3), dtype=complex)}, "tables of shapes"),
        ({"step_rps": 0.0}, "must be above 0"),
        ({"reference": np.full((2, 200), math.nan + 0j)}, "not finite"),
    ],
)
def test_what_is_no_table_is_refused(changes: dict[str, object], message: str) -> None:
    good = table()
    values = {name: getattr(good, name) for name in ("waves", "step_rps", "reference", "torque", "motion")}
    with pytest.raises(ValueError, match=message):
        CancellationTable(**{**values, **changes})  # type: ignore[arg-type]


def test_a_law_without_axes_or_time_is_refused() -> None:
    with pytest.raises(ValueError, match="a cancellation for 0 axes"):
        CancellationLaw([], PERIOD_S)
    with pytest.raises(ValueError, match="must be above 0"):
        CancellationLaw([table()], 0.0)
