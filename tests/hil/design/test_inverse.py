"""The inverse of the loop, against the very law that runs in a drive: a motor alone does exactly what cancels the error."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hil.control.angles import ARCSEC
from hil.control.cancellation import CancellationLaw
from hil.control.cascade import Cascade
from hil.control.notch import Notch
from hil.control.servo import Servo, ServoConfig
from hil.design.frequency import Loop, TwoInertia
from hil.design.inverse import (
    Actuation,
    CyclicTiming,
    InnerTiming,
    Way,
    cancellation_table,
    made_error,
    reference_per_motor_angle,
)

CONTROL_S = 250e-6
Asked = Callable[[float], tuple[float, float]]
PLANT = TwoInertia(120.0, 2.6e-4, 8e-4, 8.0, 6.0, 48950.0, 42.0)
CASCADE = Cascade(25.0, 0.196, 3.92)
LOOP = Loop(PLANT, CASCADE)
SLOW = CyclicTiming(8e-3, CONTROL_S)
AMPLITUDE, PHASE = {2: 5.0 * ARCSEC, 4: 3.0 * ARCSEC}, {2: math.radians(222.0), 4: math.radians(126.0)}


def wanted(angle: np.ndarray, share: float = 1.0) -> np.ndarray:
    waves = [share * AMPLITUDE[k] * np.cos(k * angle + PHASE[k]) for k in AMPLITUDE]
    return -PLANT.reduction_ratio * np.sum(waves, axis=0)


LAG_S = 4e-4


def motor(torque: float, state: tuple[float, float]) -> tuple[float, float]:
    """A control period of a motor alone under a held torque, exactly."""
    j, d = PLANT.motor_inertia_kg_m2, PLANT.motor_damping_nm_s_rad
    angle, speed = state
    end = torque / d
    decay = math.exp(-d / j * CONTROL_S)
    return angle + end * CONTROL_S + (speed - end) * (1.0 - decay) * j / d, end + (speed - end) * decay


def turned(
    speed_rps: float,
    corrected: Asked,
    ticks: int,
    notches: tuple[Notch, ...] = (),
    duration_s: float = 2.0,
    lag_s: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Time and angle of a motor that turns at a constant speed; `corrected` is asked every so many ticks, one SYNC ahead.

    With 0 ticks it is asked in every control period, and acts in it. With a lag its current follows the torque that is asked for.
    """
    servo, rate = Servo(ServoConfig(CASCADE, 7.0, notches), CONTROL_S), 2.0 * math.pi * speed_rps
    state = (0.0, rate)
    servo.start(0.0, rate, PLANT.motor_damping_nm_s_rad * rate)
    lag = rate / CASCADE.position_gain_per_s
    coming, before, target, offset = (0.0, 0.0), 0.0, 0.0, 0.0
    angles, felt, blend = [], 0.0, 1.0 if lag_s == 0.0 else 1.0 - math.exp(-CONTROL_S / lag_s)
    for i in range(round(duration_s / CONTROL_S)):
        angle = state[0]
        angles.append(angle)
        if ticks and i % ticks == 0:
            before, (target, offset) = target, coming
            coming = corrected(angle)
        delta = before + (target - before) * (i % ticks + 1) / ticks if ticks else 0.0
        if not ticks:
            delta, offset = corrected(angle)
        # the reference of a constant speed itself: reached at the end of each interpolation
        torque = servo.step(lag + rate * i * CONTROL_S + delta, angle, 0.0, offset)
        felt += blend * (torque - felt)
        state = motor(felt, state)
    return np.arange(len(angles)) * CONTROL_S, np.array(angles)


def ripple(time: np.ndarray, angle: np.ndarray, share: float = 1.0) -> float:
    """What the motor does beside turning, less what it should, as a part of that; root mean squares of the last second."""
    late = time > time[-1] - 1.0
    asked, done = (
        values - np.polynomial.Polynomial.fit(time[late], values, 1)(time[late])
        for values in (wanted(angle[late], share), angle[late])
    )
    return float(np.sqrt(np.mean((done - asked) ** 2)) / np.sqrt(np.mean(asked**2)))


def law_of(
    loop: Loop,
    timing: CyclicTiming | InnerTiming,
    period_s: float,
    way: Actuation = "reference",
    share: float = 1.0,
    lag_s: float = 0.0,
) -> Asked:
    amplitude = {order: share * size for order, size in AMPLITUDE.items()}
    table = cancellation_table(loop, amplitude, PHASE, timing, 12.0, way, torque_lag_s=lag_s)
    law = CancellationLaw([table], period_s, fade_rev=0.2)  # the motor turns when it begins

    def corrected(angle: float) -> tuple[float, float]:
        (reference,), (torque,) = law.step([angle])
        return reference, torque

    return corrected


@pytest.mark.parametrize("way", ["reference", "torque", "torque alone"])
@pytest.mark.parametrize(("sync_s", "speed_rps"), [(0.001, 6.0), (0.001, -5.0), (0.002, 2.95), (0.002, -6.0)])
def test_over_the_bus_the_motor_makes_the_motion_that_cancels(speed_rps: float, sync_s: float, way: Actuation) -> None:
    ticks = round(sync_s / CONTROL_S)
    corrected = law_of(LOOP, CyclicTiming(sync_s, CONTROL_S), sync_s, way, 0.1)
    assert ripple(*turned(speed_rps, corrected, ticks), 0.1) < 0.001


def test_the_torque_alone_moves_no_set_point() -> None:
    table = cancellation_table(LOOP, AMPLITUDE, PHASE, CyclicTiming(0.001, CONTROL_S), 12.0, "torque alone")
    assert not np.any(table.reference)
    assert table.largest_speed_rps(6.0) == 6.0


def test_with_a_filter_the_torque_alone_makes_the_motion_less_exactly() -> None:
    """The filter follows the ripple of the motor's speed too, and the whole of the law's answer goes through it."""
    notch = Notch(zeta_rn=0.028)
    corrected = law_of(Loop(PLANT, CASCADE, (notch,)), CyclicTiming(0.002, CONTROL_S), 0.002, "torque alone", 0.1)
    assert ripple(*turned(6.0, corrected, 8, (notch,), duration_s=4.0), 0.1) < 0.06


@pytest.mark.parametrize("way", ["reference", "torque", "torque alone"])
def test_a_lag_of_the_current_loop_that_is_known_is_allowed_for(way: Actuation) -> None:
    left = [
        ripple(*turned(6.0, law_of(LOOP, CyclicTiming(0.001, CONTROL_S), 0.001, way, 0.1, lag_s), 4, lag_s=LAG_S), 0.1)
        for lag_s in (0.0, LAG_S)
    ]
    assert left[0] > 0.004
    assert left[1] < 0.4 * left[0]


@pytest.mark.parametrize(("share", "most"), [(1.0, 0.001), (10.0, 0.004)])
def test_an_error_of_30_mrad_at_the_motor_is_cancelled_as_well_as_one_of_3(share: float, most: float) -> None:
    """The addition turns the very angle at which the error is read: with its own orders alone 0.5 % and 5 % would be left."""
    asked = law_of(LOOP, CyclicTiming(0.001, CONTROL_S), 0.001, share=share)
    assert ripple(*turned(6.0, asked, 4), share) < most


@pytest.mark.parametrize(("way", "least"), [("reference", 0.1), ("torque alone", 0.05)])
@pytest.mark.parametrize("speed_rps", [10.0, -10.0])
def test_at_slow_syncs_the_motor_is_sampled_with_the_images_of_what_moves_it(
    speed_rps: float, way: Actuation, least: float
) -> None:
    """Order 4 at 40 Hz every 8 ms: what is seen of it then is not what the motor does."""
    sync_s, ticks = 0.008, 32
    table = cancellation_table(LOOP, {4: AMPLITUDE[4]}, {4: PHASE[4]}, CyclicTiming(sync_s, CONTROL_S), 12.0, way)
    law = CancellationLaw([table.scaled(0.1)], sync_s, fade_rev=0.2)

    def asked(at: float) -> tuple[float, float]:
        (reference,), (torque,) = law.step([at])
        return reference, torque

    time, angle = turned(speed_rps, asked, ticks, duration_s=4.0)
    late = (time > 2.0) & (np.arange(len(time)) % ticks == 0)
    waves = np.exp(1j * (4.0 * angle[late] + PHASE[4]))
    columns = np.column_stack([np.ones(len(waves)), time[late], waves.real, waves.imag])
    _, _, cosine, sine = np.linalg.lstsq(columns, angle[late], rcond=None)[0]
    seen = complex(cosine, -sine if speed_rps > 0.0 else sine) / (-0.1 * PLANT.reduction_ratio * AMPLITUDE[4])
    column = round(10.0 / table.step_rps)
    assert table.image is not None
    expected = 1.0 + complex(table.image[:, 0, column].sum()) / float(table.motion[0, column])
    assert abs(expected - 1.0) > least
    assert seen == pytest.approx(expected, abs=0.01)


def on_a_ramp(most_rad_s2: float, sync_s: float = 0.002, rise_rps_s: float = 8.0) -> float:
    """What a motor alone does beside its ramp, less what it should, as a part of that, at 4 to 7 rev/s."""
    table = cancellation_table(LOOP, AMPLITUDE, PHASE, CyclicTiming(sync_s, CONTROL_S), 12.0, most_rad_s2=most_rad_s2)
    law, servo = CancellationLaw([table], sync_s), Servo(ServoConfig(CASCADE, 7.0, ()), CONTROL_S)
    ticks = round(sync_s / CONTROL_S)
    state, coming, before, target = (0.0, 0.0), 0.0, 0.0, 0.0
    servo.start(0.0, 0.0, 0.0)
    angles, count = [], round(7.2 / rise_rps_s / CONTROL_S)
    for i in range(count):
        angles.append(state[0])
        if i % ticks == 0:
            before, target = target, coming
            coming = law.step([state[0]])[0][0]
        delta = before + (target - before) * (i % ticks + 1) / ticks
        set_point = math.pi * rise_rps_s * (i * CONTROL_S) ** 2
        state = motor(servo.step(set_point + delta, state[0], 0.0, 0.0), state)
    angle, time = np.array(angles), np.arange(count) * CONTROL_S
    late = (time > 4.0 / rise_rps_s) & (time < 7.0 / rise_rps_s)
    # the motion itself, which the position loop follows smoothly
    done, asked = (
        values - np.polynomial.Polynomial.fit(time[late], values, 7)(time[late]) for values in (angle[late], wanted(angle[late]))
    )
    return float(np.sqrt(np.mean((done - asked) ** 2)) / np.sqrt(np.mean(asked**2)))


@pytest.mark.parametrize(("sync_s", "most"), [(0.001, 2e-4), (0.002, 2e-4), (0.004, 1e-3), (0.008, 0.01)])
def test_while_the_motor_speeds_up_a_sine_is_a_chirp(sync_s: float, most: float) -> None:
    plain, allowed_for = on_a_ramp(0.0, sync_s), on_a_ramp(2.0 * math.pi * 8.0, sync_s)
    assert plain > 0.004
    assert allowed_for < most


def test_inside_the_drive_it_does_so_as_well() -> None:
    corrected = law_of(LOOP, InnerTiming(CONTROL_S), CONTROL_S, share=0.1)
    assert ripple(*turned(6.0, corrected, 0), 0.1) < 0.001


def test_a_notch_on_the_torque_command_is_asked_for_more() -> None:
    notch = Notch(zeta_rn=0.028)
    loop = Loop(PLANT, CASCADE, (notch,))
    corrected = law_of(loop, CyclicTiming(0.002, CONTROL_S), 0.002, share=0.1)
    assert ripple(*turned(6.0, corrected, 8, (notch,), duration_s=4.0), 0.1) < 0.01
    line = np.array([12.0])
    more = reference_per_motor_angle(loop, line, "reference", 6.0) - reference_per_motor_angle(LOOP, line)
    assert abs(more[0]) > 0.3


def test_at_12_hz_a_set_point_is_three_times_the_motion_and_70_to_76_degrees_ahead() -> None:
    ways: tuple[Actuation, ...] = ("reference", "torque")
    for way in ways:
        found = complex(reference_per_motor_angle(LOOP, np.array([12.0]), way)[0])
        assert abs(found) == pytest.approx(3.1, abs=0.15)
        assert math.degrees(math.atan2(found.imag, found.real)) == pytest.approx(73.0, abs=4.0)


def test_the_error_of_what_the_motor_makes_is_the_spread_of_the_plants_that_it_may_be() -> None:
    generator = np.random.default_rng(1)
    errors = np.array([0.02 * PLANT.motor_inertia_kg_m2, 0.2 * PLANT.motor_damping_nm_s_rad, 1e-4])
    correlation = np.array([[1.0, 0.3, 0.9], [0.3, 1.0, 0.1], [0.9, 0.1, 1.0]])
    covariance, at = correlation * np.outer(errors, errors), np.array([25.0])
    asked, made = reference_per_motor_angle(LOOP, at, torque_lag_s=LAG_S), []
    for inertia, damping, lag in generator.multivariate_normal(np.zeros(3), covariance, 2000):
        plant = replace(
            PLANT,
            motor_inertia_kg_m2=PLANT.motor_inertia_kg_m2 + inertia,
            motor_damping_nm_s_rad=PLANT.motor_damping_nm_s_rad + damping,
        )
        made.append(abs(asked / reference_per_motor_angle(replace(LOOP, plant=plant), at, torque_lag_s=LAG_S + lag))[0])
    assert made_error(LOOP, 25.0, LAG_S, covariance) == pytest.approx(float(np.std(made)), rel=0.1)


def test_at_rest_the_correction_is_the_error_itself_and_high_up_it_is_nothing() -> None:
    table = cancellation_table(LOOP, AMPLITUDE, PHASE, CyclicTiming(0.001, CONTROL_S), 20.0)
    assert table.orders == (2, 4)
    assert table.reference[:2, 0] == pytest.approx([-120.0 * AMPLITUDE[2], -120.0 * AMPLITUDE[4]], rel=1e-3)
    assert np.all(table.reference[1, table.speeds_rps >= 15.0] == 0.0)
    assert not np.any(table.torque)


def test_a_delay_of_the_drive_is_a_phase_ahead() -> None:
    plain, late = (
        cancellation_table(LOOP, AMPLITUDE, PHASE, CyclicTiming(0.001, CONTROL_S, delay), 12.0).reference[0, 120]
        for delay in (0.0, 0.001)
    )
    assert math.degrees(np.angle(late / plain)) == pytest.approx(4.32, abs=0.01)  # 12 Hz, 1 ms


@pytest.mark.parametrize(
    ("loop", "amplitude", "max_rps", "message"),
    [
        (Loop(PLANT, Cascade(0.0, 0.2, 3.0)), AMPLITUDE, 12.0, "no position gain or no velocity gain"),
        (Loop(PLANT, Cascade(25.0, 0.0, 0.0)), AMPLITUDE, 12.0, "no position gain or no velocity gain"),
        (LOOP, {}, 12.0, "nothing to cancel"),
        (LOOP, AMPLITUDE, 0.0, "nothing to cancel"),
    ],
)
def test_what_cannot_be_asked_is_refused(loop: Loop, amplitude: dict[int, float], max_rps: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cancellation_table(loop, amplitude, PHASE, CyclicTiming(0.001, CONTROL_S), max_rps)


def test_a_factor_of_an_order_turns_and_sizes_all_that_it_mixes_to():
    size, turn = 1.2, 0.4
    large = {order: 8.0 * each for order, each in AMPLITUDE.items()}
    plain = cancellation_table(LOOP, large, PHASE, CyclicTiming(0.002, CONTROL_S), 10.0)
    other = {**large, 2: size * large[2]}, {**PHASE, 2: PHASE[2] + turn}
    wanted_table = cancellation_table(LOOP, *other, CyclicTiming(0.002, CONTROL_S), 10.0)
    assert len(plain.waves) > 4
    law, wanted_law = (CancellationLaw([each], 0.002) for each in (plain, wanted_table))
    law.multiply(0, {2: size * np.exp(1j * turn)})
    largest = plain.largest_reference_rad()
    for row in range(600):
        mine, right = (each.step([0.04 * row])[0][0] for each in (law, wanted_law))
        assert mine == pytest.approx(right, abs=1e-3 * largest)
    law.multiply(0, {})
    apart = [abs(law.step([0.04 * row])[0][0] - wanted_law.step([0.04 * row])[0][0]) for row in range(600, 700)]
    assert max(apart) > 0.03 * largest


@pytest.mark.parametrize("actuation", ["reference", "torque alone"])
@pytest.mark.parametrize("frequency_hz", [20.0, 52.0, 58.0, 66.0])
def test_no_other_part_of_a_sine_leaves_less_at_the_tip_than_the_one_that_is_cancelled(
    actuation: Actuation, frequency_hz: float
) -> None:
    """The motor's motion in time, as the sampled input with its interpolation or hold makes it: its lines shake the arm."""
    way, at = Way(LOOP, SLOW, actuation, 0.0, np.array([frequency_hz / 4.0])), np.array([frequency_hz])
    time_s = np.arange(0, 1000) * SLOW.sync_period_s  # 8 s: all of these frequencies are lines
    fine_s = np.arange(32 * 1000) * CONTROL_S
    sampled = (way.reference_per_motion if actuation == "reference" else way.torque_per_motion)(at)[0]
    values = np.real(sampled * np.exp(2j * math.pi * frequency_hz * time_s))
    late_s = 2.0 * SLOW.sync_period_s - CONTROL_S
    if actuation == "reference":
        shown = np.interp(fine_s - late_s, time_s - SLOW.sync_period_s, values, period=8.0)
    else:
        shown = values[np.floor((fine_s - SLOW.sync_period_s) / SLOW.sync_period_s + 1e-9).astype(int) % 1000]
    line_hz, lines = np.fft.rfftfreq(len(fine_s), CONTROL_S)[1:1700], np.fft.rfft(shown)[1:1700] / (0.5 * len(fine_s))
    by = Way(LOOP, InnerTiming(CONTROL_S), actuation, 0.0, np.full(len(line_hz), frequency_hz / 4.0))
    made = np.abs(lines / (by.reference_per_motion(line_hz) if actuation == "reference" else by.torque_per_motion(line_hz)))
    _, arm, gear = PLANT.terms(2j * math.pi * line_hz)
    tip = made * np.abs(gear / (arm + gear))
    row = int(np.argmin(np.abs(line_hz - frequency_hz)))
    power = (1.0 - np.linspace(0.0, 1.0, 201)) ** 2 * np.abs(gear / (arm + gear))[row] ** 2
    power = power + np.linspace(0.0, 1.0, 201) ** 2 * (np.sum(tip**2) - tip[row] ** 2)
    assert made[row] == pytest.approx(1.0, abs=0.02)
    assert way.worth(at)[0] == pytest.approx(np.linspace(0.0, 1.0, 201)[np.argmin(power)], abs=0.02)
