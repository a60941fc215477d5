"""A whole run of cyclic set-points in one compiled call.

It serves studies of hundreds of runs.
"""

import math

import numpy as np
from numpy.typing import NDArray

from hil.control.compiled import compiled
from hil.control.records import Rows
from plant_emulator.motion.period import age, command, measured_counts
from plant_emulator.motion.record import AxisRow
from plant_emulator.physics.angle_grid import constants
from plant_emulator.physics.integration import arm_acceleration, nearest_to, plant_period

Real = NDArray[np.float64]

COUNTS, ARM_ANGLE, ARM_SPEED, ARM_ACCELERATION, TORQUE = range(5)
"""Columns of a trace."""


@compiled
def follow(
    periods: int,
    period_s: float,
    substeps: int,
    axes: Rows[AxisRow],
    set_points: Real,
    encoder: Real,
    noise: Real,
    trace: Real,
) -> None:
    """Run all SYNC periods.

    Each has the state at SYNC, its set-point, and the control periods up to the next.

    The result is that of `Axes.set_point` and `Axes.advance` in turn, to the bit, while no limit is set; the encoder may
    also have errors.

    Args:
        periods: Control periods per set-point.
        period_s: The control period.
        substeps: Runge-Kutta steps of the plant per period.
        axes: `AXIS` array, shape (n_axes,); changed in place.
        set_points: In counts; shape (n, n_axes).
        encoder: E₁, φ₁, E₂, φ₂ in rad; shape (n_axes, 4).
        noise: Noise of the encoder in rad; shape (n_axes, n · periods).
        trace: Measurements and states at each SYNC; shape (n, n_axes, 5), written.
    """
    for row in range(len(axes)):  # an axis feels nothing of the others: each goes through all periods alone
        axis = axes[row]
        m, mechanics = axis.motion, axis.plant_state
        k = constants(axis.plant)
        near = nearest_to(k, mechanics)
        e1, phi1, e2, phi2 = encoder[row, 0], encoder[row, 1], encoder[row, 2], encoder[row, 3]
        at_home = e1 * math.cos(phi1) + e2 * math.cos(phi2)  # the drive counts from what it saw there
        for i in range(set_points.shape[0]):
            for period in range(periods):
                angle = mechanics.motor_angle_rad
                shown = angle + noise[row, i * periods + period]
                if e1 != 0.0 or e2 != 0.0:
                    shown += e1 * math.cos(angle + phi1) + e2 * math.cos(2.0 * angle + phi2) - at_home
                if period == 0:
                    trace[i, row, 0] = measured_counts(shown, m.counts_per_rad)
                    trace[i, row, 1] = mechanics.arm_angle_rad
                    trace[i, row, 2] = mechanics.arm_speed_rad_s
                    trace[i, row, 3] = mechanics.arm_acceleration_rad_s2
                    trace[i, row, 4] = m.torque_nm
                    m.previous_counts, m.target_counts, m.elapsed_periods = m.target_counts, set_points[i, row], 0
                torque = command(axis, shown, period_s)
                near = plant_period(k, near, mechanics, torque, False, period_s, substeps)
                if axis.change.is_changing > 0.0:
                    age(axis, period_s)
                    k = constants(axis.plant)
                    near = nearest_to(k, mechanics)
            mechanics.arm_acceleration_rad_s2 = arm_acceleration(k, mechanics)
