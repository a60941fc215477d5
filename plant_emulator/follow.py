"""A whole run of cyclic set-points in one compiled call, for those who make hundreds."""

import math
from typing import Any

from hil.control.compiled import compiled
from plant_emulator.motion import command, measured_counts
from plant_emulator.physics.axis import arm_acceleration, constants, nearby, plant_period

COUNTS, ARM_ANGLE, ARM_SPEED, ARM_ACCELERATION, TORQUE = range(5)
"""Columns of a trace."""


@compiled
def follow(
    ticks: int,
    period_s: float,
    substeps: int,
    plant: Any,
    plant_state: Any,
    motion: Any,
    cascade_config: Any,
    cascade_state: Any,
    notch_config: Any,
    notch_state: Any,
    set_points: Any,
    encoder: Any,
    noise: Any,
    trace: Any,
) -> None:
    """All SYNC periods of a run: what is there at each SYNC, its set-point, and the control periods up to the next.

    What `Axes.set_point` and `Axes.advance` do in turn, to the bit, while no limit is set; the encoder may be wrong besides.

    Args:
        ticks: Control periods per set-point.
        period_s: The control period.
        substeps: Runge-Kutta steps of the plant per period.
        plant: `PLANT` array, shape (n_axes,).
        plant_state: `PLANT_STATE` array, shape (n_axes,).
        motion: `MOTION` array, shape (n_axes,).
        cascade_config: `CASCADE_CONFIG` array, shape (n_axes,).
        cascade_state: `CASCADE_STATE` array, shape (n_axes,).
        notch_config: `NOTCH_CONFIG` array, shape (n_axes, NOTCHES).
        notch_state: `NOTCH_STATE` array, shape (n_axes, NOTCHES).
        set_points: In counts; shape (n, n_axes).
        encoder: E₁, φ₁, E₂, φ₂ in rad; shape (n_axes, 4).
        noise: Of the encoder in rad; shape (n_axes, n · ticks).
        trace: What was there at each SYNC; shape (n, n_axes, 5), written.
    """
    for row in range(plant.shape[0]):  # an axis feels nothing of the others: each goes its whole way alone
        m, mechanics = motion[row], plant_state[row]
        k = constants(plant[row])
        near = nearby(k, mechanics.motor_angle, mechanics.arm_angle)
        e1, phi1, e2, phi2 = encoder[row, 0], encoder[row, 1], encoder[row, 2], encoder[row, 3]
        at_home = e1 * math.cos(phi1) + e2 * math.cos(phi2)  # the drive counts from what it saw there
        for i in range(set_points.shape[0]):
            for tick in range(ticks):
                angle = mechanics.motor_angle
                shown = angle + noise[row, i * ticks + tick]
                if e1 != 0.0 or e2 != 0.0:
                    shown += e1 * math.cos(angle + phi1) + e2 * math.cos(2.0 * angle + phi2) - at_home
                if tick == 0:
                    trace[i, row, 0] = measured_counts(shown, m.counts_per_rad)
                    trace[i, row, 1] = mechanics.arm_angle
                    trace[i, row, 2] = mechanics.arm_speed
                    trace[i, row, 3] = mechanics.arm_acceleration
                    trace[i, row, 4] = m.torque_nm
                    m.previous_counts, m.target_counts, m.tick = m.target_counts, set_points[i, row], 0
                torque = command(motion, row, shown, period_s, cascade_config, cascade_state, notch_config, notch_state)
                near = plant_period(k, near, mechanics, torque, False, period_s, substeps)
            mechanics.arm_acceleration = arm_acceleration(k, mechanics)
