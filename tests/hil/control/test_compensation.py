"""The correction follows angle, speed and direction, begins gently, and never exceeds what its table says."""

import math

import numpy as np
import pytest

from hil.control.compensation import Compensation, Correction, inner_compensation

PERIOD_S = 0.001
STEP_RPS = 0.05


def table(orders: tuple[int, ...] = (2, 4), speeds: int = 200) -> Correction:
    """Amplitude and phase that grow with the speed."""
    rps = np.arange(speeds) * STEP_RPS
    reference = np.array([1e-3 * order * (1.0 + 0.2 * rps) * np.exp(0.1j * order * rps) for order in orders])
    return Correction(orders, tuple(0.7 * order for order in orders), STEP_RPS, reference, 10.0 * reference.conj())


def expected(correction: Correction, angle: float, speed_rps: float, *, torque: bool = False) -> float:
    values = correction.torque if torque else correction.reference
    total = 0.0
    for order, phase, row in zip(correction.orders, correction.phase_rad, values, strict=True):
        gain = complex(np.interp(abs(speed_rps), correction.speeds_rps, row.real))
        gain += 1j * complex(np.interp(abs(speed_rps), correction.speeds_rps, row.imag))
        if speed_rps < 0.0:
            gain = gain.conjugate()
        total += (gain * np.exp(1j * (order * angle + phase))).real
    return total


@pytest.mark.parametrize("speed_rps", [0.0, 1.234, 5.0, 9.9, -0.7, -6.02])
def test_at_constant_speed_each_order_has_its_gain_and_phase(speed_rps: float) -> None:
    correction = table()
    law, angle = Compensation([correction], PERIOD_S), 0.3
    for _ in range(400):
        (reference,), (torque,) = law.step([angle])
        angle += 2.0 * math.pi * speed_rps * PERIOD_S
    angle -= 2.0 * math.pi * speed_rps * PERIOD_S
    assert reference == pytest.approx(expected(correction, angle, speed_rps), abs=1e-9)
    assert torque == pytest.approx(expected(correction, angle, speed_rps, torque=True), abs=1e-8)


def test_a_correction_fades_in_and_begins_anew_after_a_reset() -> None:
    law = Compensation([table()], PERIOD_S, fade_s=0.1)
    first = [law.step([0.2])[0][0] for _ in range(150)]
    full = expected(table(), 0.2, 0.0)
    assert first[0] == pytest.approx(0.01 * full)
    assert first[49] == pytest.approx(0.5 * full)
    assert first[120] == pytest.approx(full)
    law.reset()
    assert law.step([0.2])[0][0] == first[0]


def test_an_axis_without_correction_is_left_alone() -> None:
    law = Compensation([None, table((2,)), None], PERIOD_S)
    for i in range(300):
        references, torques = law.step([0.01 * i] * 3)
    assert references[0] == references[2] == torques[0] == torques[2] == 0.0
    assert references[1] != 0.0


def test_axes_do_not_touch_each_other() -> None:
    one, two = table((2,), 40), table((2, 4))
    together, alone = Compensation([one, two], PERIOD_S), [Compensation([one], PERIOD_S), Compensation([two], PERIOD_S)]
    for i in range(300):
        angles = [0.01 * i, 1.0 - 0.035 * i]
        references, torques = together.step(angles)
        apart = [law.step([angle]) for law, angle in zip(alone, angles, strict=True)]
        assert references == [each[0][0] for each in apart]
        assert torques == [each[1][0] for each in apart]


def test_beyond_the_table_its_last_values_stay() -> None:
    correction = table(speeds=21)  # up to 1 rps
    law, angle = Compensation([correction], PERIOD_S), 0.0
    for _ in range(500):
        (reference,), _ = law.step([angle])
        angle += 2.0 * math.pi * 30.0 * PERIOD_S
    assert reference == pytest.approx(expected(correction, angle - 2.0 * math.pi * 30.0 * PERIOD_S, 1.0), abs=1e-9)


def test_whatever_the_motor_does_the_correction_stays_below_its_bound() -> None:
    correction, random = table(), np.random.default_rng(1)
    law, largest = Compensation([correction], PERIOD_S), correction.largest_reference_rad()
    angle = 0.0
    for _ in range(5000):
        angle += random.normal(0.0, 0.05)
        (reference,), (torque,) = law.step([angle])
        assert abs(reference) <= largest
        assert abs(torque) <= correction.largest_torque_nm()
    assert correction.largest_reference_rad(2.0) < largest
    assert correction.largest_rate_rps(2.0) < correction.largest_rate_rps()


def test_torques_come_in_steps_that_add_up_to_what_is_wanted() -> None:
    correction, step = table(), 0.02
    fine, coarse = Compensation([correction], PERIOD_S), Compensation([correction], PERIOD_S, [step])
    owed = 0.0
    for i in range(1000):
        wanted, given = (law.step([0.02 * i])[1][0] for law in (fine, coarse))
        assert given / step == pytest.approx(round(given / step), abs=1e-9)
        owed += wanted - given
        assert abs(owed) <= 0.5001 * step


def test_half_of_a_correction_is_half_of_it() -> None:
    half = table().scaled(0.5)
    assert half.largest_reference_rad() == pytest.approx(0.5 * table().largest_reference_rad())
    assert half.phase_rad == table().phase_rad


@pytest.mark.parametrize("speed", [37.0, -20.0])
def test_inside_a_drive_speed_and_torque_are_those_of_the_set_points_motion(speed: float) -> None:
    """Rates by differences of the very set-points, at the instants at which the loop measures and the torque acts."""
    lowpass_hz, period_s, inertia, damping = 300.0, 250e-6, 2.6e-4, 8e-4

    def at(angle: float) -> tuple[float, float, float]:
        return inner_compensation(3e-3, 1.0, 2e-3, -2.0, inertia, damping, lowpass_hz, period_s, angle, speed)

    step = 1e-5
    for angle in (0.0, 0.4, 2.0, -5.0):
        late, ahead = angle - speed / (2.0 * math.pi * lowpass_hz), angle + 0.5 * period_s * speed
        rate = (at(late + speed * step)[0] - at(late - speed * step)[0]) / (2.0 * step)
        before, here, after = (at(ahead + side * speed * step)[0] for side in (-1, 0, 1))
        torque = inertia * (after - 2.0 * here + before) / step**2 + damping * (after - before) / (2.0 * step)
        assert at(angle)[1] == pytest.approx(rate, rel=1e-5, abs=1e-8)
        assert at(angle)[2] == pytest.approx(torque, rel=1e-4, abs=1e-8)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"orders": (2,)}, "tables of shapes"),
        ({"phase_rad": (0.0,)}, "tables of shapes"),
        ({"torque": np.zeros((2, 3), dtype=complex)}, "tables of shapes"),
        ({"step_rps": 0.0}, "must be above 0"),
        ({"reference": np.full((2, 200), math.nan + 0j)}, "not finite"),
    ],
)
def test_what_is_no_table_is_refused(changes: dict[str, object], message: str) -> None:
    good = table()
    values = {name: getattr(good, name) for name in ("orders", "phase_rad", "step_rps", "reference", "torque")}
    with pytest.raises(ValueError, match=message):
        Correction(**{**values, **changes})  # type: ignore[arg-type]


def test_a_law_without_axes_or_time_is_refused() -> None:
    with pytest.raises(ValueError, match="no axis"):
        Compensation([], PERIOD_S)
    with pytest.raises(ValueError, match="must be above 0"):
        Compensation([table()], 0.0)
