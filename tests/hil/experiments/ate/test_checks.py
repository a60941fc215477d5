"""Bad data are refused with the number that is wrong and the number needed."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hil.design.ate.identification import JointEstimate
from hil.design.ate.model import Arm
from hil.design.estimate import Estimate
from hil.experiments.ate.checks import (
    AteNotIdentifiedError,
    check_accelerometer,
    check_estimate,
    check_run,
    factor_remark,
    reached_rps,
)
from hil.master.motion import RunResult
from hil.recording import Recording
from tests.hil.estimates import apart


def values(a2_error: float = 0.03, a4_error: float = 0.03) -> Estimate:
    return apart((2, 4), np.array([5.0, 222.0, 3.0, 126.0]), np.array([a2_error, 0.2, a4_error, 0.4]))


GOOD = JointEstimate(
    (2, 4), values(), Arm(12.4, 0.038, 1e-4), Arm(0.01, 0.001, 1e-4), 0.01, 0.99, 0.99, 1.0, 0.03, (), (6.2, 26.0),
)  # fmt: skip


def ringing(noise: float, step: float, reach: float = math.inf) -> np.ndarray:
    time = np.arange(0.0, 6.0, 0.001)
    envelope = np.exp(-(((time - 3.0) / 1.5) ** 2))
    wave = 0.6 * envelope * np.sin(2.0 * math.pi * 12.0 * time) + noise * np.random.default_rng(3).standard_normal(len(time))
    return np.clip(np.round(wave / step) * step, -reach, reach)


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.05])
@pytest.mark.parametrize("step", [0.001, 0.01, 0.02])
def test_a_sensor_within_its_range_passes(noise: float, step: float) -> None:
    check_accelerometer(ringing(noise, step))


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("reach", [0.2, 0.4])
def test_a_saturated_sensor_is_found_out(noise: float, reach: float) -> None:
    with pytest.raises(AteNotIdentifiedError, match=f"saturates at -{reach}") as error:
        check_accelerometer(ringing(noise, 0.01, reach))
    assert error.value.value > error.value.needed


def test_a_dead_sensor_is_found_out() -> None:
    with pytest.raises(AteNotIdentifiedError, match=r"different values of the accelerometer in 500 samples: 1 \(at least 8\)"):
        check_accelerometer(np.zeros(500))


def test_a_good_estimate_passes() -> None:
    check_estimate(GOOD, sensorless=False)
    assert factor_remark(GOOD) is None


@pytest.mark.parametrize(("miss", "is_spring"), [(0.005, True), (0.03, False)])
def test_an_arm_whose_vibration_a_spring_does_not_explain_is_not_on_one(miss: float, is_spring: bool) -> None:
    assert replace(GOOD, miss=miss).is_spring is is_spring


def test_a_factor_that_is_not_certainly_wrong_is_a_remark() -> None:
    unsure = replace(GOOD, motion_scale=0.62, motion_scale_error=0.1)
    check_estimate(unsure, sensorless=False)
    assert "0.620 ± 0.100 times" in (factor_remark(unsure) or "")


def test_noise_that_more_passes_overcome_is_no_reason_to_stop() -> None:
    weak = replace(GOOD, values=values(1.5, 3.0))
    check_estimate(weak, sensorless=False, passes_left=5)
    with pytest.raises(AteNotIdentifiedError, match=r": 3\.333 \(at least 5\)"):
        check_estimate(weak, sensorless=False, passes_left=0)


def test_vibration_that_is_noise_is_not_asked_of_the_error() -> None:
    check_estimate(replace(GOOD, explained_by_error=0.2, structured=0.01), sensorless=False)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"explained_by_error": 0.07, "structured": 0.93},
            r"that the orders 2, 4 explain: 0\.07 \(at least 0\.6\); look for anoth",
        ),
        (
            {"values": values(2.0, 3.0)},
            r"A_2, to its standard error: 2\.5 \(at least 5\).* none is above 12″",
        ),
        (
            {"motion_scale": 0.62},
            r"tip_lever_m / reduction_ratio: 0\.38 \(at most 0\.25\); check that this is the axis that moved",
        ),
        ({"motion_scale": -1.01}, r"the tip moves against the motor: the encoder counts backwards"),
        ({"motion_scale": 0.02}, r"the sensor does not respond to this axis"),
        ({"arm": Arm(12.4, 0.04, 0.0298)}, r"delay between motor angle and sensor: 29\.8 ms \(at most 29 ms\)"),
    ],
)
def test_a_bad_estimate_is_refused_with_its_number(changes: dict[str, object], message: str) -> None:
    with pytest.raises(AteNotIdentifiedError, match=message) as error:
        check_estimate(replace(GOOD, **changes), sensorless=False)  # type: ignore[arg-type]
    assert error.value.exit_code == 9


def result(**changes: int) -> RunResult:
    values = {"cycles": 1000, "missed_cycles": 0, "sensor_missed": 0} | changes
    return RunResult(Recording(), wall_s=1.0, motion_s=1.0, control_period_s=250e-6, stopped=None, **values)  # type: ignore[arg-type]


def test_a_pass_with_holes_is_refused() -> None:
    check_run(result(sensor_missed=5), sensorless=False)
    with pytest.raises(AteNotIdentifiedError, match=r"without the accelerometer \(of 1000\): 6 \(at most 5"):
        check_run(result(sensor_missed=6), sensorless=False)
    check_run(result(sensor_missed=1000), sensorless=True)
    with pytest.raises(AteNotIdentifiedError, match="late set-point: 7"):
        check_run(result(missed_cycles=4, dropped_cycles=3), sensorless=False)


def test_the_speed_at_the_end_of_a_ramp() -> None:
    assert reached_rps(2.0 * math.pi * 7.0 * np.arange(500) * 0.002, 0.002, 400) == pytest.approx(7.0)


def test_an_error_that_further_passes_may_show_is_not_refused() -> None:
    """A gear with hysteresis widens the standard errors: 4.9 of them where 5 are asked."""
    wide = replace(GOOD, values=values(5.0 / 4.9, 3.0 / 4.9))
    with pytest.raises(AteNotIdentifiedError, match=r"ratio of the largest amplitude, A_\d, to its standard error"):
        check_estimate(wide, sensorless=False)
    check_estimate(wide, sensorless=False, passes_left=3)


@pytest.mark.parametrize(
    ("changes", "causes"),
    [
        ({"motion_scale": 0.1}, ("wrong axis or wiring",)),
        ({"values": values(3.0, 3.0)}, ("noise",)),
        ({"explained_by_error": 0.1, "structured": 0.9}, ("another source of vibration",)),
        ({"arm": replace(GOOD.arm, delay_s=0.2)}, ()),
    ],
)
def test_a_refusal_carries_its_cause(changes, causes):
    with pytest.raises(AteNotIdentifiedError) as error:
        check_estimate(replace(GOOD, **changes), sensorless=False)
    assert error.value.causes == causes
