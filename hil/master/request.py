"""What is asked of the robot against what it may do: refused before anything is sent."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from drive_profiles.units import interpolation_period
from hil.control.notch import FixedFilter
from hil.control.servo import ServoConfig
from hil.control.servo_bank import ServoBank
from hil.design.frequency import margins
from hil.errors import UnsafeRequestError
from hil.master.axis import DriveAxis
from hil.master.bench import Axis as AxisTable
from hil.master.motion import Motion

MAX_SENSITIVITY = 4.0
"""M_s up to which a host-closed loop is run: a quarter of the way from the edge is left."""


def host_loops(
    axes: list[DriveAxis], period_s: float, *, with_notch: bool, fixed: Mapping[int, FixedFilter] | None = None
) -> ServoBank:
    """The loops of axes that the host closes, ready for their first cycle.

    Raises:
        UnsafeRequestError: The model says that one is unstable, or at the edge of it.
    """
    configs = []
    for axis in axes:
        table = axis.table
        notches = tuple(notch.notch() for notch in table.notch) if with_notch else ()
        held = (fixed or {}).get(axis.number)
        check_host_loop(axis.number, table, period_s, with_notch=with_notch, held=held)
        filters = notches if held is None else (held,)
        configs.append(ServoConfig(table.control.cascade(), table.limits.torque_nm, filters))
    rehearsal, still = ServoBank(configs, period_s), [0.0] * len(configs)
    rehearsal.start(0, 0.0)
    rehearsal.step(still, still)  # compiled, or loaded, before the first cycle waits for it
    rehearsal.step_one(0, 0.0, 0.0)
    return ServoBank(configs, period_s)


def check_host_loop(number: int, table: AxisTable, period_s: float, *, with_notch: bool, held: FixedFilter | None = None) -> None:
    """Refuse a loop over the bus that the model shows unstable, or at the edge of it; without a model nothing is known.

    Args:
        number: Of the axis.
        table: Of the bench file.
        period_s: SYNC period.
        with_notch: Whether its variable filters act.
        held: A filter that acts at every speed.

    Raises:
        UnsafeRequestError: With what is wrong and how much is allowed.
    """
    model = table.loop(period_s, 1, with_notch=with_notch)
    if model is None:
        return
    if held is not None:
        model = replace(model, fixed=(held,))
    where = f"axis {number} closed over the bus at {1e3 * period_s:g} ms"
    remedy = "shorten bus.host_sync_period_s, lower the gains, or close the loop in the drive (--loop drive)"
    for speed in (0.0, *(speed for n in model.notches for speed in np.linspace(n.start_rps, n.end_rps, 5).tolist())):
        found = margins(model, speed)
        if not found.stable:
            raise UnsafeRequestError(f"{where} is unstable: its largest pole", found.pole_radius, 1.0, "", remedy)
        if found.sensitivity_peak > MAX_SENSITIVITY:
            peak = found.sensitivity_peak
            raise UnsafeRequestError(f"{where} is at the edge of stability: M_s", peak, MAX_SENSITIVITY, "", remedy)


def check_motion(motion: Motion, axes: list[DriveAxis], starts: list[float]) -> None:
    """The whole motion against the limits, before anything is enabled.

    Args:
        motion: What is asked for.
        axes: In the order of its columns.
        starts: Where each begins, in rad at the motor.

    Raises:
        UnsafeRequestError: It would leave one.
    """
    period, turn = motion.period_s, 2.0 * math.pi
    interpolation_period(period)
    for axis in axes:
        sync = axis.profile.sync
        too_short = sync.min_period_s is not None and period < sync.min_period_s
        too_long = sync.max_period_s is not None and period > sync.max_period_s
        if too_short or too_long:
            limit = (sync.min_period_s if too_short else sync.max_period_s) or 0.0
            raise UnsafeRequestError(f"the SYNC period of axis {axis.number}", period, limit, "s", "see its profile")
    for column, axis in enumerate(axes):
        limits, name = axis.table.limits, f"axis {axis.number}"
        angle = (motion.motor_angle_rad[:, column] + starts[column]) / turn
        speed = float(np.max(np.abs(np.diff(angle)))) / period
        if speed > limits.speed_rps:
            raise UnsafeRequestError(f"the speed of {name}", speed, limits.speed_rps, "rps", "slow the motion down")
        if float(angle.max()) > limits.position_max_rev:
            raise UnsafeRequestError(f"the position of {name}", float(angle.max()), limits.position_max_rev, "rev")
        if float(angle.min()) < limits.position_min_rev:
            raise UnsafeRequestError(f"the position of {name}", float(angle.min()), limits.position_min_rev, "rev")
        if motion.torque_offset_nm is not None:
            torque = float(np.max(np.abs(motion.torque_offset_nm[:, column])))
            if not torque <= limits.torque_nm:
                raise UnsafeRequestError(f"the torque offset of {name}", torque, limits.torque_nm, "N·m")
