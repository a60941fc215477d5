"""The tip: kinematics against numerical derivatives, the sensor against its data sheet."""

import math

import numpy as np
import pytest

from hil.control.trajectory import PlanarChain
from plant_emulator.core import CORE
from plant_emulator.motion.axes import tip_sensor
from plant_emulator.physics.tip import MovedTip, TipSensor
from plant_emulator.robots.robot import RobotAccelerometer

CHAIN = PlanarChain(0.050, 0.330, 0.440, (0.420, 0.035), 0.130)
LEVERS = (0.5, 0.4, 0.1)


def traced(tip, moved):
    """Acceleration (X, Y, Z) of a tip for angle, speed and acceleration of all axes, as the control period computes it."""
    rows, found = np.array([moved], np.float64), np.empty(3)
    CORE.call.tip_trace(tip.shared, CORE.pointer(rows), 1, rows.shape[1], -1, CORE.pointer(found))
    return tuple(found.tolist())


def chain_acceleration(q, w, a):
    return traced(MovedTip(LEVERS, CHAIN, range(3), (0.0, 0.0, 0.0)), np.array([q, w, a]).T)


def lever_acceleration(lever, speed, acceleration):
    return traced(MovedTip([lever]), [[0.0, speed, acceleration]])


@pytest.mark.parametrize("seed", range(6))
def test_the_planar_acceleration_is_the_second_derivative_of_the_tip(seed):
    rng = np.random.default_rng(seed)
    q, w, a = rng.uniform(-1.5, 1.5, 3), rng.uniform(-2.0, 2.0, 3), rng.uniform(-10.0, 10.0, 3)
    h = 1e-4
    before, now, after = (CHAIN.tip(q + w * t + 0.5 * a * t * t) for t in (-h, 0.0, h))
    x, z = (before - 2.0 * now + after) / h**2
    got = chain_acceleration(q, w, a)
    assert got == pytest.approx((x, 0.0, z), abs=1e-4)


def test_a_chain_at_rest_feels_nothing():
    assert chain_acceleration(np.array([0.3, -0.4, 0.1]), np.zeros(3), np.zeros(3)) == (0.0, 0.0, 0.0)


def test_a_lever_feels_the_centripetal_and_the_tangential_acceleration():
    radius, rate, change, h = 0.7, 1.3, -4.0, 1e-4

    def place(t):
        angle = rate * t + 0.5 * change * t * t
        return np.array([radius * math.cos(angle), radius * math.sin(angle)])

    radial, tangential = (place(-h) - 2.0 * place(0.0) + place(h)) / h**2
    assert lever_acceleration(radius, rate, change) == pytest.approx((radial, 0.0, tangential), abs=1e-5)


def sensor(noise=0.0, resolution=0.0, reach=19.62, seed=1):
    return TipSensor(noise, resolution, reach, np.random.default_rng(seed))


def test_a_sensor_without_noise_rounds_to_its_nearest_step():
    step = 0.00981
    for true in np.linspace(-1.0, 1.0, 401):
        value = sensor(resolution=step).sample((float(true), 0.0, 0.0))[0]
        assert abs(value - true) <= 0.5 * step * (1.0 + 1e-9)
        assert value / step == pytest.approx(round(value / step), abs=1e-9)
    assert sensor().sample((0.123456, -1.0, 2.0)) == (0.123456, -1.0, 2.0)


def test_beyond_its_range_the_sensor_saturates():
    assert sensor(noise=0.02, resolution=0.00981, reach=19.62).sample((100.0, -100.0, 25.0)) == (19.62, -19.62, 19.62)


def test_the_noise_is_white_and_of_the_stated_size_on_every_axis():
    one = sensor(noise=0.02)
    draws = np.array([one.sample((1.0, 0.0, -1.0)) for _ in range(20_000)])
    np.testing.assert_allclose(draws.std(axis=0), 0.02, rtol=0.02)
    np.testing.assert_allclose(draws.mean(axis=0), [1.0, 0.0, -1.0], atol=6e-4)
    noise = draws - draws.mean(axis=0)
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.02 * 0.02**2
    assert np.max(np.abs(np.corrcoef(noise.T) - np.eye(3))) < 0.03


def test_equal_seeds_give_equal_samples_and_different_ones_do_not():
    def run(seed):
        one = sensor(noise=0.02, resolution=0.00981, seed=seed)
        return [one.sample((0.1, 0.2, 0.3)) for _ in range(50)]

    assert run(7) == run(7)
    assert run(7) != run(8)


def test_the_chain_is_the_sum_over_its_links():
    """a = Σ (α̈_i ŷ×r_i − α̇_i² r_i), link after link, in the same order of the arithmetic: the same bits."""
    rng = np.random.default_rng(1)
    links = ((CHAIN.upper_arm_m, 0.0), CHAIN.forearm_m, (CHAIN.tool_m, 0.0))
    for _ in range(200):
        q, w, a = (rng.uniform(-3.0, 3.0, 3).tolist() for _ in range(3))
        x = z = rate = change = 0.0
        alpha = 0.5 * math.pi
        for (length, width), sign, i in zip(links, (-1.0, 1.0, 1.0), range(3), strict=True):
            alpha, rate, change = alpha + sign * q[i], rate + sign * w[i], change + sign * a[i]
            cos, sin = math.cos(alpha), math.sin(alpha)
            link_x, link_z = length * cos - width * sin, length * sin + width * cos
            x += -change * link_z - rate * rate * link_x
            z += change * link_x - rate * rate * link_z
        assert chain_acceleration(q, w, a) == (x, 0.0, z)


@pytest.mark.parametrize(("noise", "resolution", "reach"), [(0.02, 0.00981, 19.62), (0.3, 0.0, 1.0), (0.0, 0.5, 0.7)])
def test_each_value_of_a_sample_is_its_own_draw_rounded_and_limited(noise, resolution, reach):
    one, draws = sensor(noise, resolution, reach, seed=3), np.random.default_rng(3).standard_normal((600, 3))
    for i, draw in enumerate(draws.tolist()):
        true = (math.sin(i), 0.9 * math.cos(i), 0.01 * i)
        values = [value + noise * number for value, number in zip(true, draw, strict=True)]
        if resolution:
            values = [resolution * math.floor(value / resolution + 0.5) for value in values]
        assert one.sample(true) == tuple(min(reach, max(-reach, value)) for value in values)


@pytest.mark.parametrize("sensitivity", [0.0, 3.0])
@pytest.mark.parametrize("cross", [0.0, -2.0])
@pytest.mark.parametrize("tilt", [0.0, 10.0])
def test_a_sensor_reads_what_its_data_sheet_allows_it(sensitivity, cross, tilt):
    setting = RobotAccelerometer(
        sensitivity_percent=sensitivity, cross_axis_percent=cross, tilt_deg=tilt, noise_m_s2=0.0, resolution_m_s2=0.0
    )
    true, turned = np.array([1.0, -2.0, 3.0]), math.radians(tilt)
    cos, sin = math.cos(turned), math.sin(turned)
    felt = np.array([true[0] * cos - true[2] * sin, true[1], true[0] * sin + true[2] * cos])
    expected = (1.0 + sensitivity / 100.0) * felt + cross / 100.0 * (felt.sum() - felt)
    shown = tip_sensor(setting, np.random.default_rng(1)).sample(tuple(true))
    assert shown == pytest.approx(tuple(expected), abs=1e-12)
    assert sensitivity or cross or tilt or shown == tuple(true)
