"""Request of a run, and checks before anything is written or enabled."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from drive_profiles.standard.units import interpolation_period
from hil.bench.bench import AxisTable, Limits
from hil.control.arrays import Real
from hil.control.notch import FixedFilter, Notch
from hil.control.servo import ServoConfig
from hil.control.servo_bank import ServoBank
from hil.control.trajectory import ConstantAcceleration, PointToPoint
from hil.control.treatments import LoopName
from hil.design.frequency import margins
from hil.errors import NotPossibleError, UnsafeRequestError
from hil.master.drive.axis import DriveAxis
from hil.master.drive.mapping import CSP, mode_of
from hil.master.motion import FilterUse, Motion
from hil.master.set_point_adder import SetPointAdder
from hil.master.whereabouts import way_out

MAX_SENSITIVITY = 4.0
"""Largest M_s at which a loop is run: its distance from instability is then a quarter."""

ROUNDED = 1e-6
"""Relative rounding in the acceleration of set-points: second differences of ±22 rev every 250 µs round to 3e-7 rev/s²."""


@dataclass(frozen=True)
class RunRequest:
    """Input of one run."""

    motion: Motion
    filters: FilterUse
    loop: LoopName
    adder: SetPointAdder | None = None
    fixed: Mapping[int, FixedFilter] = field(default_factory=dict)
    shows_filter: bool = True

    @property
    def filters_in_drives(self) -> bool:
        """True if the filters act inside the drives."""
        return self.filters == "notch" and self.loop == "drive"

    @property
    def uses_torque_offset(self) -> bool:
        """True if torque offsets (60B2h) are sent."""
        return self.motion.torque_offset_nm is not None or (self.adder is not None and self.adder.uses_torque)

    def filters_of(self, axis: DriveAxis) -> tuple[Notch | FixedFilter, ...]:
        """Return the filters that act on an axis."""
        if self.loop == "drive":
            return axis.notches
        held = self.fixed.get(axis.number)
        if held is not None:
            return (held,)
        return tuple(notch.notch() for notch in axis.table.notch) if self.filters == "notch" else ()

    def check(self, axes: list[DriveAxis]) -> None:
        """Refuse combinations that are not possible.

        Raises:
            NotPossibleError: The combination is not possible; the message has the requirement.
        """
        if self.filters == "notch" and not any(axis.table.notch for axis in axes):
            names = " or ".join(f"axis.{axis.number}.notch" for axis in axes)
            raise NotPossibleError(
                f"the bench file has no {names}, which a run with the notch needs; add the table, or choose --treatment none"
            )
        if self.loop == "host" and (self.adder is not None or self.uses_torque_offset):
            raise NotPossibleError("additions to set-points and torques need a drive-closed loop (--loop drive)")
        if self.uses_torque_offset:
            for axis in axes:
                mode = mode_of(self.loop, axis.profile)
                if mode is not CSP:
                    name = "no cyclic mode" if mode is None else mode.name
                    raise NotPossibleError(f"axis {axis.number}: a torque offset needs CSP; {axis.profile.label} has {name}")
        if self.loop == "drive" and self.fixed:
            raise NotPossibleError("fixed filters need a host-closed loop (--loop host)")

    def host_loops(self, axes: list[DriveAxis]) -> ServoBank | None:
        """Return the host's loops, ready to cycle; None if drives close them.

        Args:
            axes: The axes, in the order of the motion's columns.

        Raises:
            UnsafeRequestError: By its model a loop is unstable, or at the edge of stability.
        """
        if self.loop == "drive":
            return None
        period_s, configs = self.motion.period_s, []
        for axis in axes:
            table, held = axis.table, self.fixed.get(axis.number)
            gains = table.gains(f"axis {axis.number} closed by the host")
            check_host_loop(axis.number, table, period_s, with_notch=self.filters == "notch", held=held)
            configs.append(ServoConfig(gains.cascade(), table.limits.torque_nm, self.filters_of(axis)))
        return ServoBank(configs, period_s)


def check_host_loop(number: int, table: AxisTable, period_s: float, *, with_notch: bool, held: FixedFilter | None = None) -> None:
    """Refuse a loop over the bus that is nearly or actually unstable.

    By its model; a loop without a model is accepted.

    Args:
        held: A filter that acts at every speed.

    Raises:
        UnsafeRequestError: The loop is refused; the error holds value and limit.
    """
    model = table.loop(period_s, 1, with_notch=with_notch)
    if model is None:
        return
    if held is not None:
        model = replace(model, fixed=(held,))
    where = f"axis {number} closed over the bus at {1e3 * period_s:g} ms"
    remedy = "shorten bus.host_sync_period_s, lower the gains, or close the loop in the drive (--loop drive)"
    for speed in (0.0, *(speed for n in model.notches for speed in np.linspace(n.start_rps, n.end_rps, 5).tolist())):
        left = margins(model, speed)
        if not left.stable:
            raise UnsafeRequestError(f"{where} is unstable: its largest pole", left.pole_radius, 1.0, "", remedy)
        if left.sensitivity_peak > MAX_SENSITIVITY:
            peak = left.sensitivity_peak
            raise UnsafeRequestError(f"{where} is at the edge of stability: M_s", peak, MAX_SENSITIVITY, "", remedy)


def check_acceleration(table: AxisTable, axis: int, trajectory: ConstantAcceleration | PointToPoint) -> None:
    """Refuse a ramp beyond the acceleration limit or the torque limit.

    The torque gives motor and arm α ≤ τ/(2π (J_m + J_l/N²)) in rev/s².

    Args:
        table: Table of the axis in the bench file; without plant and motor inertia, the torque is not checked.

    Raises:
        UnsafeRequestError: It would be larger.
    """
    limits = table.limits
    wanted = {name: value for name, value in vars(trajectory).items() if name.endswith("celeration_rps_s")}
    name, value = max(wanted.items(), key=lambda item: item[1])
    what = f"the {name.removesuffix('_rps_s')} of axis {axis}"
    stated = limits.acceleration_rps_s
    if stated is not None and value > stated:
        raise UnsafeRequestError(what, value, stated, "rev/s²", f"lower {name}, or raise axis.{axis}.limits.acceleration_rps_s")
    inertia, model = table.motor_inertia_kg_m2, table.model
    if model is not None:
        inertia = model.motor_inertia_kg_m2 + model.arm_inertia_kg_m2 / table.reduction_ratio**2
    if inertia is None:
        return
    most_rps_s = limits.torque_nm / (2.0 * math.pi * inertia)
    if value > most_rps_s:
        remedy = f"torque_nm = {limits.torque_nm:g} cannot accelerate {inertia:.3g} kg·m² at the motor faster; lower {name}"
        raise UnsafeRequestError(what, value, most_rps_s, "rev/s²", remedy)


def check_set_points(axis: int, limits: Limits, angle_rad: Real, period_s: float) -> None:
    """Refuse set-points that accelerate an axis from rest beyond its limit.

    Args:
        angle_rad: Set-points; shape (n,).

    Raises:
        UnsafeRequestError: They do.
    """
    most = limits.acceleration_rps_s
    if most is None:
        return
    changes = np.diff(np.concatenate([angle_rad[:1], angle_rad]), 2)
    fastest = float(np.max(np.abs(changes), initial=0.0)) / period_s**2 / math.tau
    if fastest > most * (1.0 + ROUNDED):
        raise UnsafeRequestError(f"the acceleration of axis {axis}", fastest, most, "rev/s²", "slow the motion down")


def check_motion(motion: Motion, axes: list[DriveAxis], starts: list[float]) -> None:
    """Check the whole motion against the limits, before anything is enabled.

    Set-points are known to the last digit, so a limit that the master holds alone needs no more room here than one that the drive
    holds as well: what drives do beside their set-points is watched while they move.

    Args:
        axes: The axes, in the order of the motion's columns.
        starts: Start of each axis, in rad at the motor.

    Raises:
        UnsafeRequestError: The motion would leave a limit.
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
        way = motion.motor_angle_rad[:, column] / turn
        angle = way + starts[column] / turn
        speed = float(np.max(np.abs(np.diff(angle)))) / period
        if speed > limits.speed_rps:
            raise UnsafeRequestError(f"the speed of {name}", speed, limits.speed_rps, "rev/s", "slow the motion down")
        plain = motion.motor_angle_rad if motion.excitation_rad is None else motion.motor_angle_rad - motion.excitation_rad
        check_set_points(axis.number, limits, np.append(plain[:, column], plain[-1, column]), period)  # it ends at rest, too
        remedy = ""
        if not motion.starts_at_home:
            remedy = way_out(axis.number, starts[column] / turn, limits, float(way.min()), float(way.max()))
        if float(angle.max()) > limits.position_max_rev:
            raise UnsafeRequestError(f"the position of {name}", float(angle.max()), limits.position_max_rev, "rev", remedy)
        if float(angle.min()) < limits.position_min_rev:
            raise UnsafeRequestError(f"the position of {name}", float(angle.min()), limits.position_min_rev, "rev", remedy)
        if motion.torque_offset_nm is not None:
            torque = float(np.max(np.abs(motion.torque_offset_nm[:, column])))
            if not torque <= limits.torque_nm:
                raise UnsafeRequestError(f"the torque offset of {name}", torque, limits.torque_nm, "N·m")
