"""Weight of an arm, as its motor's torque shows it while it turns."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.design.ate.model import Sweep
from hil.design.ate.reaction import averaged
from hil.design.order_map import SLOWEST_RPS

MEAN_S = 0.1
"""Accuracy: width of the mean over which torque and motion are slow: a factor of 2 changes estimates by 0.01, errors by 6 %."""
BLOCK_S = 0.5
"""Accuracy: blocks between which standard errors are read: a factor of 2 changes estimates by 0.001, errors by 2 %."""
MOTOR_SHARE = (0.1, 0.7)
"""Measured: the motor's part of all inertia where the arm's is not known: 0.17 to 0.65 on the drawn robots 10700 to 10764."""


@dataclass(frozen=True)
class Weight:
    """Gravity's deceleration of an arm, g_c cos θ_l + g_s sin θ_l, with its standard errors.

    Attributes:
        values_rad_s2: (g_c, g_s).
    """

    values_rad_s2: tuple[float, float]
    errors_rad_s2: tuple[float, float]


def weight_of(sweeps: Sequence[Sweep], reduction_ratio: float, arm_inertia: tuple[float, float] | None) -> Weight | None:
    """Fit the motor's torque by friction, inertia and gravity.

    Least squares of τ on sgn θ̇_m, θ̇_m, θ̈_m, cos(θ_m/N) and sin(θ_m/N); the last two, times N/J_l, are g_c and g_s.

    Args:
        sweeps: Recordings with the motor's torque.
        arm_inertia: J_l in kg·m² and its standard error; None if it is not known, and is taken from the whole inertia.

    Returns:
        The weight; None if a recording has no torque, or never turns fast enough.
    """
    matrices, torques, blocks = [], [], []
    for sweep in sweeps:
        if sweep.torque_nm is None:
            return None
        width = max(1, round(MEAN_S / sweep.period_s))
        angle, torque = averaged(sweep.motor_angle_rad, width), averaged(sweep.torque_nm, width)
        speed = np.gradient(angle, sweep.period_s)
        posture = angle / reduction_ratio
        columns = (np.sign(speed), speed, np.gradient(speed, sweep.period_s), np.cos(posture), np.sin(posture))
        inside = np.abs(speed) > math.tau * SLOWEST_RPS
        inside[: 2 * width] = inside[-2 * width :] = False
        turned = np.convolve(np.sign(speed), np.ones(2 * width + 1), "same")
        inside &= np.abs(turned) > 2 * width  # it does not turn round within the mean
        matrices.append(np.column_stack(columns)[inside])
        torques.append(torque[inside])
        blocks.append(max(1.0, BLOCK_S / sweep.period_s))
    matrix, torque = np.concatenate(matrices), np.concatenate(torques)
    if len(torque) < 10 * max(blocks):
        return None
    found, *_ = np.linalg.lstsq(matrix, torque, rcond=None)
    left = torque - matrix @ found
    variance = float(np.mean(left**2)) * float(np.mean(blocks))
    errors = np.sqrt(np.maximum(0.0, np.diag(np.linalg.pinv(matrix.T @ matrix)) * variance))
    inertia, inertia_error = arm_inertia or _shared(float(found[2]) * reduction_ratio**2)
    if inertia <= 0.0:
        return None
    scale = reduction_ratio / inertia
    values = scale * found[3:]
    widened = np.hypot(scale * errors[3:], inertia_error / inertia * math.hypot(*values))
    return Weight((float(values[0]), float(values[1])), (float(widened[0]), float(widened[1])))


def _shared(whole: float) -> tuple[float, float]:
    """The arm's part of the whole inertia with its standard error."""
    least, most = 1.0 - MOTOR_SHARE[1], 1.0 - MOTOR_SHARE[0]
    return 0.5 * (least + most) * whole, (most - least) / math.sqrt(12.0) * whole
