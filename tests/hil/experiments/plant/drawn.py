"""Robots of the kinds that industry builds, drawn by a seed, with the bench file that knows nothing of them."""

import math
from typing import Any

import numpy as np

from hil.bench.bench import Bench
from hil.design.frequency import TwoInertia
from hil.robot_tables import Control
from plant_emulator.robots.robot import Robot, RobotAxis, load_robot
from tests.hil.experiments.plant.plant_rig import unknown_bench

AXIS = 2


def axis_of(
    ratio: float, f_a: float, inertia_ratio: float, motor: float, zeta: float = 0.04, seed: int = 0, **changes: Any
) -> RobotAxis:
    """An axis by what counts: N, f_a, J_l/(N² J_m), J_m and ζ; friction, gravity and limits follow its size.

    Args:
        ratio: Reduction ratio N.
        f_a: Anti-resonance in Hz.
        inertia_ratio: J_l/(N² J_m).
        motor: J_m in kg·m².
        zeta: Damping ratio of the arm on its gear.
        seed: Seed of the phases of the transmission error.
        changes: Fields of the axis that are other than those that follow.
    """
    arm = inertia_ratio * ratio**2 * motor
    stiffness = (2.0 * math.pi * f_a) ** 2 * arm
    damping = 2.0 * zeta * math.sqrt(stiffness * arm)
    total = motor * (1.0 + inertia_ratio)
    limit = round(8000.0 * total, 3)
    friction = changes.pop("friction", 1.0)
    rise = changes.pop("rise", 0.3)
    rng = np.random.default_rng([seed, 17])
    phases = {f"phi{order}_deg": float(rng.uniform(0.0, 360.0)) for order in (1, 2, 4)}
    ate = {"a1_arcsec": 0.0, "a2_arcsec": 8.0, "a4_arcsec": 4.0, **phases, **changes.pop("ate", {})}
    table = load_robot("reference").axis[AXIS]
    values = {
        "reduction_ratio": ratio,
        "motor_inertia_kg_m2": motor,
        "motor_damping_nm_s_rad": 3.0 * motor,
        "arm_inertia_kg_m2": arm,
        "arm_damping_nm_s_rad": 0.125 * damping,
        "gear_stiffness_nm_rad": stiffness,
        "gear_damping_nm_s_rad": 0.875 * damping,
        "coulomb_friction_nm": 0.014 * friction * limit,
        "static_friction_nm": 0.014 * friction * limit * (1.0 + rise),
        "gravity_moment_nm": 0.06 * limit * ratio,
        "torque_limit_nm": limit,
        "rated_torque_nm": limit / 3.0,
        "ate": table.ate.model_copy(update=ate),
        **changes,
    }
    return table.model_copy(update=values)


def robot_of(axis: RobotAxis, **sensor: float) -> Robot:
    """A robot of one axis."""
    robot = load_robot("reference")
    felt = robot.accelerometer.model_copy(update={"noise_m_s2": 0.05, "resolution_m_s2": 0.01, **sensor})
    changes = {"axis": {AXIS: axis}, "geometry": None, "line_motion": None, "accelerometer": felt}
    return robot.model_copy(update=changes)


def bench_of(robot: Robot, sync_s: float, bandwidth_hz: float = 100.0, **limits: float) -> Bench:
    """A bench file that holds what is on the name plate: N, lever, limits and gains."""
    axis = robot.axis[AXIS]
    velocity = 2.0 * math.pi * bandwidth_hz * axis.motor_inertia_kg_m2
    control = Control(
        position_gain_per_s=25.0, velocity_gain_nm_s_rad=velocity, velocity_integral_gain_nm_rad=20.0 * velocity, lowpass_hz=300.0
    )
    bench = unknown_bench(AXIS, sync_s, torque_nm=axis.torque_limit_nm, **limits)
    update = {"reduction_ratio": axis.reduction_ratio, "tip_lever_m": axis.tip_lever_m, "control": control, "notch": ()}
    return bench.model_copy(update={"axis": {AXIS: bench.axis[AXIS].model_copy(update=update)}})


def truth_of(axis: RobotAxis) -> dict[str, float]:
    """What an identification should find on an axis with a linear gear."""
    names = (*TwoInertia.__dataclass_fields__,)
    plant = TwoInertia(**{name: getattr(axis, name) for name in names})
    damping = plant.gear_damping_nm_s_rad + plant.arm_damping_nm_s_rad
    return {
        **{name: getattr(axis, name) for name in names},
        "antiresonance_hz": plant.antiresonance_hz,
        "resonance_hz": plant.resonance_hz,
        "damping": 0.5 * damping / math.sqrt(plant.gear_stiffness_nm_rad * plant.arm_inertia_kg_m2),
        "viscous_damping_nm_s_rad": plant.motor_damping_nm_s_rad + plant.arm_damping_nm_s_rad / plant.reduction_ratio**2,
        "friction_coulomb_nm": axis.coulomb_friction_nm,
        "gravity_moment_nm": axis.gravity_moment_nm,
        "lever_ratio": 1.0,
    }
