"""The accelerometer's mounting, low-pass and delay, held against scipy and against mathematics."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from plant_emulator.core import CORE
from plant_emulator.motion.axes import Axes
from plant_emulator.motion.record import POSITION
from plant_emulator.physics.sensing import SensorResponse, interpolation
from plant_emulator.robots.robot import Robot, load_robot

T = 250e-6


def shown(response: SensorResponse, tips: NDArray[np.float64]) -> float:
    """The Z channel after some samples."""
    sections, ring, size, sensed = response.shared
    CORE.call.sense(sections, ring, size, CORE.pointer(tips), len(tips), sensed)
    return sensed[2]


def passed(response: SensorResponse, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The Z channel of the response, sample by sample."""
    return np.array([shown(response, np.array([[0.0, 0.0, value]])) for value in values])


def noise(count: int) -> NDArray[np.float64]:
    return np.random.default_rng(3).standard_normal(count)


def test_the_low_pass_is_scipys_butterworth_of_order_2() -> None:
    values = noise(400)
    expected = signal.lfilter(*signal.butter(2, 150.0, fs=1.0 / T), values)
    np.testing.assert_allclose(passed(SensorResponse(T, lowpass_hz=150.0), values), expected, atol=1e-12)


@pytest.mark.slow
def test_the_mounting_resonates_as_a_mass_on_a_spring_does() -> None:
    resonance, damping = 90.0, 0.06
    impulse = np.zeros(40_000)
    impulse[0] = 1.0
    spectrum = np.fft.rfft(passed(SensorResponse(T, mounting_resonance_hz=resonance, mounting_damping=damping), impulse))
    frequency = np.fft.rfftfreq(len(impulse), T)
    omega = 2.0 * math.pi * resonance
    low = (frequency > 0.0) & (frequency < 150.0)
    _, expected = signal.freqs(
        [2.0 * damping * omega, omega**2], [1.0, 2.0 * damping * omega, omega**2], 2.0 * math.pi * frequency[low]
    )
    np.testing.assert_allclose(np.abs(spectrum[low]), np.abs(expected), rtol=0.02)
    at_resonance = np.argmin(np.abs(frequency - resonance))
    exact = abs((2j * damping + 1.0) / (2j * damping))
    assert abs(spectrum[at_resonance]) == pytest.approx(exact, rel=0.005)


@pytest.mark.parametrize("samples", [1, 7, 40])
def test_a_delay_of_whole_control_periods_is_exact(samples: int) -> None:
    values = noise(200)
    found = passed(SensorResponse(T, delay_s=samples * T), values)
    np.testing.assert_array_equal(found, np.concatenate([np.zeros(samples), values[:-samples]]))


@pytest.mark.parametrize("delay_s", [0.3 * T, 1.5 * T, 17.25 * T, 0.0073])
def test_a_fractional_delay_shifts_a_vibration_by_its_time(delay_s: float) -> None:
    times = np.arange(4000) * T
    found = passed(SensorResponse(T, delay_s=delay_s), np.sin(2.0 * math.pi * 40.0 * times))
    late = np.sin(2.0 * math.pi * 40.0 * (times - delay_s))
    np.testing.assert_allclose(found[400:], late[400:], atol=5e-5)


def test_the_weights_of_an_interpolation_add_up_to_1_and_hold_a_cubic() -> None:
    for delay in (0.2, 3.0, 5.7):
        first, weights = interpolation(delay)
        assert sum(weights) == pytest.approx(1.0)
        at = -(first + np.arange(4.0))
        assert np.dot(weights, at**3 - 2.0 * at) == pytest.approx((-delay) ** 3 + 2.0 * delay, abs=1e-9)


def test_several_samples_at_once_are_as_good_as_one_after_the_other() -> None:
    values = noise(64)
    options = {"delay_s": 2.5e-3, "lowpass_hz": 200.0, "mounting_resonance_hz": 120.0}
    whole = SensorResponse(T, **options)
    tips = np.zeros((64, 3))
    tips[:, 2] = values
    assert shown(whole, tips) == passed(SensorResponse(T, **options), values)[-1]


@pytest.mark.parametrize("name", ["lowpass_hz", "mounting_resonance_hz"])
def test_a_frequency_that_the_control_period_does_not_show_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="too high"):
        SensorResponse(T, **{name: 1900.0})
    robot = load_robot("reference").model_dump()
    robot["accelerometer"] |= {name: 1900.0}
    with pytest.raises(ValueError, match="the most that a control_period_s"):
        Robot.model_validate(robot)


def moved(robot: Robot, *, several: bool = False) -> list[tuple[float, float, float]]:
    """What the accelerometer shows at each SYNC while axis 2 (or all axes) steps ahead."""
    axes = Axes(robot)
    rows = range(len(axes.numbers)) if several else [axes.row(2)]
    for row in rows:
        axes.cascade_config[row]["position_gain_per_s"] = 25.0
        axes.cascade_config[row]["velocity_gain_nm_s_rad"] = 0.2 if row == 0 else 0.02
        axes.cascade_config[row]["lowpass_hz"] = 300.0
        axes.open_brake(row, POSITION, 8)
    shown = []
    for i in range(150):
        for row in rows:
            axes.set_point(row, 60 * i)
        axes.advance(8)
        shown.append(axes.sensed_acceleration())
    return shown


@pytest.mark.parametrize("several", [False, True])
def test_a_delay_of_a_cycle_shows_the_motion_of_the_same_robot_a_cycle_late(several: bool) -> None:
    robot = load_robot("reference")
    late = robot.accelerometer.model_copy(update={"delay_s": 0.002})
    plain, delayed = moved(robot, several=several), moved(robot.model_copy(update={"accelerometer": late}), several=several)
    assert max(abs(z) for _, _, z in plain) > 0.1
    np.testing.assert_array_equal(delayed[1:], plain[:-1])
