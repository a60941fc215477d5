"""True and estimated facts of a robot."""

import cmath
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.bench.bench import Bench
from hil.bench.model import Identified, IdentifiedError, IdentifiedPlant
from hil.control.order_keys import amplitude_key, phase_key
from hil.robot_tables import ORDERS
from plant_emulator.rehearsal.gear import ALL_AROUND_RAD, gear_plant
from plant_emulator.rehearsal.record import Cell, QuantityRecord
from plant_emulator.rehearsal.truth import true_f_al_hz
from plant_emulator.robots.fleet import antiresonance_hz
from plant_emulator.robots.robot import Robot, RobotAccelerometer, RobotAxis


def facts_of(robot: Robot, bench: Bench, number: int) -> dict[str, Cell]:
    """Return facts of an axis and its robot, named as in `record.FACTS`."""
    axis, sensor = robot.axis[number], robot.accelerometer
    return {
        "reduction_ratio": axis.reduction_ratio,
        "antiresonance_hz": antiresonance_hz(axis),
        "f_al_hz": true_f_al_hz(bench, robot, number),
        "inertia_ratio": axis.arm_inertia_kg_m2 / (axis.reduction_ratio**2 * axis.motor_inertia_kg_m2),
        **{amplitude_key(order): getattr(axis.apparent_ate, amplitude_key(order)) for order in ORDERS},
        "encoder_bits": math.log2(axis.encoder_counts_per_rev),
        "current_lag_s": axis.current_time_constant_s,
        "hysteresis_nm": axis.hysteresis_torque_nm,
        "softness": axis.wind_up_softness,
        "gear_reaction": axis.gear_reaction,
        "noise_m_s2": sensor.noise_m_s2,
        "sensor_delay_s": sensor.delay_s,
        "mounting_hz": sensor.mounting_resonance_hz,
        "sync_period_s": robot.sync_period_s,
        "late_answers": bool(axis.behaviour.tpdo_delay_us),
        "bitrate": robot.bus.bitrate,
    }


def quantities_of(
    robot: Robot,
    number: int,
    identified: Identified | None,
    learnt: Identified | None,
    arm_rad: NDArray[np.float64] = ALL_AROUND_RAD,
) -> dict[str, QuantityRecord]:
    """Return truth, estimate and standard error by `record.QUANTITIES`.

    Args:
        identified: Model file of the identifications; None without one.
        learnt: Model file of learning; None if nothing was learnt.
        arm_rad: Arm angles at which the plant was identified.
    """
    axis = robot.axis[number]
    known = None if identified is None else identified.axis.get(number)
    taught = None if learnt is None else learnt.axis.get(number)
    found = _plant(axis, None if known is None else known.plant, arm_rad)
    error = None if known is None else known.ate
    found["accelerometer_delay_s"] = QuantityRecord(
        sensor_delay_s(robot.accelerometer, antiresonance_hz(axis)),
        None if error is None else error.accelerometer_delay_s,
        None if error is None else error.standard_error.get("accelerometer_delay_s"),
    )
    found |= _error(axis, error, "")
    return found | _error(axis, None if taught is None else taught.ate, "learnt_")


def sensor_delay_s(sensor: RobotAccelerometer, frequency_hz: float) -> float:
    """Return the delay of a vibration in the sensor.

    It is the sensor's delay, and −arg H(jω)/ω of its low-pass and its mounting.
    """
    omega = 2.0 * math.pi * frequency_hz
    lag = 0.0
    if sensor.lowpass_hz is not None:
        corner = 2.0 * math.pi * sensor.lowpass_hz
        lag += cmath.phase(corner**2 - omega**2 + math.sqrt(2.0) * 1j * corner * omega)
    if sensor.mounting_resonance_hz is not None:
        own = 2.0 * math.pi * sensor.mounting_resonance_hz
        through = 2j * sensor.mounting_damping * own * omega
        lag += cmath.phase(own**2 - omega**2 + through) - cmath.phase(own**2 + through)
    return sensor.delay_s + lag / omega


def _plant(axis: RobotAxis, plant: IdentifiedPlant | None, arm_rad: NDArray[np.float64]) -> dict[str, QuantityRecord]:
    """Return true and identified plant."""
    gear = gear_plant(axis, None if plant is None else plant.torsion_arcsec, arm_rad)
    true = {
        "motor_inertia_kg_m2": axis.motor_inertia_kg_m2,
        "arm_inertia_kg_m2": axis.arm_inertia_kg_m2,
        "gear_stiffness_nm_rad": gear.stiffness_nm_rad,
        "antiresonance_hz": gear.antiresonance_hz,
        "resonance_hz": gear.resonance_hz,
        "damping": gear.damping,
        "motor_damping_nm_s_rad": axis.motor_damping_nm_s_rad,
        "arm_damping_nm_s_rad": axis.arm_damping_nm_s_rad,
        "coulomb_friction_nm": axis.coulomb_friction_nm,
        "gravity_moment_nm": abs(axis.gravity_moment_nm),
    }
    if plant is None:
        return {name: QuantityRecord(value) for name, value in true.items()}
    values: dict[str, Any] = plant.values.model_dump() | plant.model_dump(exclude={"values"})
    errors: Mapping[str, float] = plant.standard_error
    named = {"coulomb_friction_nm": "friction_coulomb_nm"}
    return {
        name: QuantityRecord(value, values.get(name), errors.get(name, errors.get(named.get(name, ""))))
        for name, value in true.items()
    }


def _error(axis: RobotAxis, error: IdentifiedError | None, prefix: str) -> dict[str, QuantityRecord]:
    found = {}
    estimated = {} if error is None else error.values.amplitudes_arcsec()
    for order in ORDERS:
        for name in (amplitude_key(order), phase_key(order)):
            estimate = getattr(error.values, name) if error is not None and order in estimated else None
            spread = None if error is None else error.standard_error.get(name)
            found[f"{prefix}{name}"] = QuantityRecord(getattr(axis.apparent_ate, name), estimate, spread)
    return found
