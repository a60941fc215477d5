"""Motions of the bench file, and what no motor can do of them."""

import math

import pytest

from hil.bench.bench import Bench, load_bench
from hil.errors import UnsafeRequestError
from hil.experiments.motions import constant_acceleration

BENCH = load_bench("reference")


def at(acceleration_rps_s: float, limit_rps_s: float | None = None) -> Bench:
    motion = BENCH.constant_acceleration
    assert motion is not None
    table = BENCH.axis[2]
    limits = table.limits.model_copy(update={"acceleration_rps_s": limit_rps_s})
    axis = {**BENCH.axis, 2: table.model_copy(update={"limits": limits})}
    faster = motion.model_copy(update={"acceleration_rps_s": acceleration_rps_s})
    return BENCH.model_copy(update={"constant_acceleration": faster, "axis": axis})


def test_a_ramp_beyond_the_acceleration_limit_is_refused_with_its_unit_and_the_key_to_change() -> None:
    assert constant_acceleration(at(60.0, 60.0), 2, 0.002).axes == (2,)
    with pytest.raises(UnsafeRequestError) as refused:
        constant_acceleration(at(4000.0, 100.0), 2, 0.002)
    assert str(refused.value) == (
        "the acceleration of axis 2 would be 4000 rev/s²; the limit is 100 rev/s²; lower acceleration_rps_s, or raise "
        "axis.2.limits.acceleration_rps_s"
    )


def test_an_acceleration_that_the_torque_limit_cannot_give_is_refused_with_its_unit() -> None:
    table = BENCH.axis[2]
    assert table.model is not None
    inertia = table.model.motor_inertia_kg_m2 + table.model.arm_inertia_kg_m2 / table.reduction_ratio**2
    most = table.limits.torque_nm / (2.0 * math.pi * inertia)
    assert most < 4000.0
    assert constant_acceleration(at(0.9 * most), 2, 0.002).axes == (2,)
    with pytest.raises(
        UnsafeRequestError, match=r"the acceleration of axis 2 would be .* rev/s²; the limit is .* rev/s²"
    ) as refused:
        constant_acceleration(at(1.1 * most), 2, 0.002)
    assert "torque_nm = 7.1" in str(refused.value)
    assert "lower acceleration_rps_s" in str(refused.value)
