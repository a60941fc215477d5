"""One axis over time: classical Runge-Kutta with fixed sub-steps, one control period after the other."""

from hil.control.compiled import compiled, inlined
from plant_emulator.physics.angle_grid import AxisState, Constants, GridPoint, constants, grid_angles, grid_point, nearest, rates
from plant_emulator.physics.axis import PlantRow, PlantStateRow


@inlined
def nearest_to(k: Constants, s: PlantStateRow) -> GridPoint:
    """The grid point nearest to a state, from which `plant_period` begins."""
    return nearest(k, s.motor_angle_rad, s.arm_angle_rad)


@inlined
def plant_period(
    k: Constants, near: GridPoint, s: PlantStateRow, command: float, braked: bool, period_s: float, substeps: int
) -> GridPoint:
    """One control period under a constant torque command: classical Runge-Kutta, fixed sub-steps; θ̈_l is left as it was.

    Args:
        k: `constants` of the axis.
        near: The grid point nearest to a state of a short while ago.
        s: The state; changed in place.
        command: Torque command in N·m, held over the period.
        braked: Whether the brake holds the motor.
        period_s: The control period.
        substeps: Runge-Kutta steps per period.

    Returns:
        The grid point for the next period.
    """
    th, wm, tl, wl = s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s
    z, tau = s.hysteresis_nm, s.torque_nm
    if braked:
        wm, tau = 0.0, 0.0
    elif k.current_time_constant <= 0.0:
        tau = command
    h = period_s / substeps
    half, sixth = 0.5 * h, h / 6.0
    for _ in range(substeps):
        motor, arm = grid_angles(k, th, tl)
        if motor != near.motor or arm != near.arm:
            near = grid_point(k, motor, arm)
        a1, b1, c1, d1 = rates(k, near, command, braked, AxisState(th, wm, tl, wl, z, tau))
        wm2, wl2 = wm + half * a1, wl + half * b1
        at = AxisState(th + half * wm, wm2, tl + half * wl, wl2, z + half * c1, tau + half * d1)
        a2, b2, c2, d2 = rates(k, near, command, braked, at)
        wm3, wl3 = wm + half * a2, wl + half * b2
        at = AxisState(th + half * wm2, wm3, tl + half * wl2, wl3, z + half * c2, tau + half * d2)
        a3, b3, c3, d3 = rates(k, near, command, braked, at)
        wm4, wl4 = wm + h * a3, wl + h * b3
        at = AxisState(th + h * wm3, wm4, tl + h * wl3, wl4, z + h * c3, tau + h * d3)
        a4, b4, c4, d4 = rates(k, near, command, braked, at)
        th += sixth * (wm + 2.0 * (wm2 + wm3) + wm4)
        tl += sixth * (wl + 2.0 * (wl2 + wl3) + wl4)
        wm += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        wl += sixth * (b1 + 2.0 * (b2 + b3) + b4)
        z += sixth * (c1 + 2.0 * (c2 + c3) + c4)
        tau += sixth * (d1 + 2.0 * (d2 + d3) + d4)
    s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s = th, wm, tl, wl
    s.hysteresis_nm, s.torque_nm = z, tau
    return near


@inlined
def arm_acceleration(k: Constants, s: PlantStateRow) -> float:
    """θ̈_l of a state; it does not depend on the torque command, which the motor feels first."""
    at = AxisState(s.motor_angle_rad, s.motor_speed_rad_s, s.arm_angle_rad, s.arm_speed_rad_s, s.hysteresis_nm, s.torque_nm)
    _, acceleration, _, _ = rates(k, nearest_to(k, s), 0.0, True, at)
    return acceleration


@compiled
def plant_step(p: PlantRow, s: PlantStateRow, command: float, braked: bool, period_s: float, substeps: int) -> None:
    """`plant_period` of one axis by itself, and θ̈_l after it: the seam at which tests hold the plant against other solvers.

    Args:
        p: The axis' constants.
        s: Its state; changed in place.
        command: Torque command in N·m, held over the period.
        braked: Whether the brake holds the motor.
        period_s: The control period.
        substeps: Runge-Kutta steps per period.
    """
    k = constants(p)
    plant_period(k, nearest_to(k, s), s, command, braked, period_s, substeps)
    s.arm_acceleration_rad_s2 = arm_acceleration(k, s)
