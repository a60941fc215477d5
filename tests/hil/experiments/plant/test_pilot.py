"""Amplitudes of a plant identification: what is planned keeps to the limits by which the master checks it."""

import math
from typing import Any

import numpy as np
import pytest

from hil.bench.bench import load_bench
from hil.control.cancellation_table import LIMIT_USED
from hil.design.estimate import Estimate
from hil.design.estimation import EstimatedParameter
from hil.design.plant_identification import PlantEstimate
from hil.errors import UnsafeRequestError
from hil.experiments.plant.bands import pilot_band
from hil.experiments.plant.motion import PlantRequest, excited_motion, plan_travel
from hil.experiments.plant.pilot import predicted_peaks, set_point_room_nm
from hil.master.drive.axis import DriveAxis
from hil.master.request import check_motion

BENCH = load_bench("reference")
REQUEST = PlantRequest(2)


@pytest.mark.parametrize("sync_s", [0.001, 0.002, 0.004])
def test_set_points_of_the_largest_excited_reference_keep_the_speed_limit(sync_s: float) -> None:
    bench = BENCH.model_copy(update={"bus": BENCH.bus.model_copy(update={"sync_period_s": sync_s})})
    axes, limit = [DriveAxis(None, 2, bench.axis[2])], bench.axis[2].limits.speed_rps  # type: ignore[arg-type]
    travel = plan_travel(bench, REQUEST, pilot_band(REQUEST, sync_s), 0.0, "reference", is_pilot=True)
    largest_nm = set_point_room_nm(travel, "reference", limit)
    motion = excited_motion(bench, REQUEST, travel, 0.0, "reference", largest_nm).motion
    check_motion(motion, axes, [0.0])
    fastest = float(np.max(np.abs(np.diff(motion.motor_angle_rad[:, 0])))) / sync_s / math.tau
    assert 0.8 * limit < fastest <= LIMIT_USED * limit * (1.0 + 1e-6)
    faster = excited_motion(bench, REQUEST, travel, 0.0, "reference", 1.3 * largest_nm).motion
    with pytest.raises(UnsafeRequestError, match="the speed of axis 2"):
        check_motion(faster, axes, [0.0])


def test_an_excited_torque_moves_no_set_point() -> None:
    travel = plan_travel(BENCH, REQUEST, pilot_band(REQUEST, 0.002), 0.0, "torque", is_pilot=True)
    assert set_point_room_nm(travel, "torque", 12.0) == np.inf


def pilot(lever_ratio: EstimatedParameter | None) -> PlantEstimate:
    """An estimate of a pilot with the reference's plant, and this lever of the tip over the bench file's."""
    plant, nothing = BENCH.axis[2].plant(), np.zeros(0)
    assert plant is not None
    parameters = {"torque_lag_s": EstimatedParameter(0.0, 0.0)} | ({} if lever_ratio is None else {"lever_ratio": lever_ratio})
    values = Estimate.independent({name: (each.value, each.standard_error) for name, each in parameters.items()})
    response: Any = None
    return PlantEstimate(plant, parameters, values, response, None, 1.0, 10, 0.0, 0.0, nothing)


def test_a_lever_that_the_tips_noise_does_not_tell_limits_no_amplitude() -> None:
    """A pilot gave 260 ± 20 000 times the lever: no amplitude was small enough, and the tip was said to be at its limit."""
    travel = plan_travel(BENCH, REQUEST, pilot_band(REQUEST, 0.002), 0.0, "reference", is_pilot=True)
    law = BENCH.axis[2].gains("a test").cascade()

    def tip_m_s2(lever_ratio: EstimatedParameter | None) -> float:
        return predicted_peaks(pilot(lever_ratio), travel, "reference", law, 0.00025, 0.8).tip_m_s2

    plain = tip_m_s2(None)
    assert plain > 0.0
    assert tip_m_s2(EstimatedParameter(260.0, 20_000.0)) == plain
    assert tip_m_s2(EstimatedParameter(1.3, 0.01)) == pytest.approx(1.3 * plain)
