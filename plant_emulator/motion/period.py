"""The control period of a drive: set-point, servo law, limits; compiled, all axes in one call."""

import math

import numpy as np
from numpy.typing import NDArray

from hil.control.cancellation import FADE_S, InnerCancellation, inner_cancellation
from hil.control.cascade import cascade_start, hold_integrator
from hil.control.compiled import compiled, inlined
from hil.control.notch import NOTCHES
from hil.control.records import Rows
from hil.control.servo import servo_step
from plant_emulator.motion.inputs import watch_inputs
from plant_emulator.motion.record import (
    BRAKED,
    LIMITED_TORQUE,
    POSITION,
    PROFILE,
    PROFILE_TORQUE,
    PROFILE_VELOCITY,
    STOPPED_RAD_S,
    STOPPING,
    TORQUE,
    VELOCITY,
    AxisRow,
    MotionRow,
)
from plant_emulator.motion.references import (
    interpolated_counts,
    interpolated_speed,
    profile_position,
    profile_torque,
    profile_velocity,
    ramp_down,
    set_point_fraction,
)
from plant_emulator.motion.supervision import watch_limits, watch_windows
from plant_emulator.motion.transitions import begin_stop, brake_hard
from plant_emulator.physics.angle_grid import constants
from plant_emulator.physics.changing import go_through, put_error
from plant_emulator.physics.integration import arm_acceleration, nearest_to, plant_period
from plant_emulator.physics.sensing import SectionsRow, sense

Real = NDArray[np.float64]


@inlined
def measured_counts(motor_angle: float, counts_per_rad: float) -> float:
    """The encoder's reading: the motor angle rounded to whole counts."""
    return math.floor(motor_angle * counts_per_rad + 0.5)


@inlined
def _rest(axis: AxisRow, angle: float) -> None:
    """Set law and outputs to those of a motor at rest behind a closed brake."""
    m, law = axis.motion, axis.law
    cascade_start(law.cascade_state, angle, 0.0, 0.0)
    for column in range(NOTCHES):
        law.notch_state[column].active = 0
        law.notch_state[column].speed_rps = 0.0
        law.notch_state[column].mean_nm = 0.0
    m.torque_nm, m.following_error_rad, m.cancel_fraction = 0.0, 0.0, 0.0
    m.demand_rad, m.demand_speed_rad_s, m.torque_demand_nm = angle, 0.0, 0.0
    m.limited = m.reached = m.late_periods = 0


@inlined
def _demand(m: MotionRow, angle: float, period_s: float) -> tuple[float, float, float]:
    """The mode's demand on the law in this period: position, velocity offset, torque offset."""
    position, velocity_offset, torque_offset, demand_speed = angle, 0.0, m.torque_offset_nm, 0.0
    if m.mode == POSITION:
        position = interpolated_counts(m) / m.counts_per_rad
        velocity_offset = m.velocity_offset_rad_s
        demand_speed = (position - m.demand_rad) / period_s
    elif m.mode == PROFILE:
        profile_position(m, m.target_counts / m.counts_per_rad, period_s)
        position, demand_speed = m.reference_rad, m.reference_speed_rad_s
    elif m.mode == STOPPING:
        torque_offset = 0.0
        if m.stop_direction == 0.0:
            ramp_down(m, period_s)
            position, demand_speed = m.reference_rad, m.reference_speed_rad_s
    elif m.mode == VELOCITY:
        velocity_offset = demand_speed = interpolated_speed(m)
    elif m.mode == PROFILE_VELOCITY:
        velocity_offset = demand_speed = profile_velocity(m, period_s)
        torque_offset = 0.0
    elif m.mode == TORQUE and m.extrapolation_periods > 0:
        set_point_fraction(m)  # the torque acts at once: all that counts of the interval is its end
    m.demand_rad, m.demand_speed_rad_s = position, demand_speed
    return position, velocity_offset, torque_offset


@inlined
def _with_cancellation(
    axis: AxisRow, angle: float, period_s: float, position: float, velocity_offset: float, torque_offset: float
) -> tuple[float, float, float]:
    """The demand with the drive's own cancellation of the transmission error, faded in or out.

    Args:
        axis: The axis; the fraction to which the cancellation is faded in moves on.
        angle: θ_m in rad, as measured.
        period_s: The control period.
        position: Demand without cancellation, in rad.
        velocity_offset: The same in rad/s.
        torque_offset: The same in N·m.
    """
    m = axis.motion
    m.cancel_fraction = min(1.0, max(0.0, m.cancel_fraction + math.copysign(period_s / FADE_S, m.cancel_mode - 0.5)))
    if m.mode in (POSITION, PROFILE):
        known = InnerCancellation(
            m.cancel_a2_rad,
            m.cancel_phi2_rad,
            m.cancel_a4_rad,
            m.cancel_phi4_rad,
            m.cancel_inertia_kg_m2,
            m.cancel_damping_nm_s_rad,
            m.cancel_a1_rad,
            m.cancel_phi1_rad,
        )
        speed = axis.law.cascade_state.speed_rad_s
        reference, rate, more = inner_cancellation(known, axis.law.cascade_config.lowpass_hz, period_s, angle, speed)
        position += m.cancel_fraction * reference
        velocity_offset += m.cancel_fraction * rate
        torque_offset += m.cancel_fraction * more
    return position, velocity_offset, torque_offset


@inlined
def _used_torque(axis: AxisRow, period_s: float, previous_integral_nm: float, torque_nm: float) -> float:
    """The torque that the mode uses: the law's, or its own.

    Args:
        axis: The axis.
        period_s: The control period.
        previous_integral_nm: The integrator before this period, in N·m.
        torque_nm: The law's torque.
    """
    m = axis.motion
    if m.mode == TORQUE:
        return float(m.target_torque_nm + m.torque_offset_nm)
    if m.mode == PROFILE_TORQUE:
        return profile_torque(m, period_s)
    if m.mode == STOPPING and m.stop_direction != 0.0:
        return brake_hard(axis, previous_integral_nm)
    return torque_nm


@inlined
def _limited_torque(axis: AxisRow, previous_integral_nm: float, torque_nm: float) -> float:
    """The torque within its limits; where these cut it, the integrator does not wind up."""
    m = axis.motion
    if m.torque_low_nm < torque_nm < m.torque_high_nm:
        return torque_nm
    limited = float(min(m.torque_high_nm, max(m.torque_low_nm, torque_nm)))
    if torque_nm != limited:
        hold_integrator(axis.law.cascade_state, previous_integral_nm, torque_nm - limited)
    m.limited |= LIMITED_TORQUE
    return limited


@inlined
def _supervise(axis: AxisRow, was_stopping: bool, counts: float, angle: float) -> None:
    """Note what is reached; hold the axis against its limits, and begin a stop where one is broken."""
    m, s = axis.motion, axis.law.cascade_state
    if m.mode not in (POSITION, TORQUE, VELOCITY):
        watch_windows(m, s.speed_rad_s, angle)
    if m.mode == STOPPING:
        if m.reference_speed_rad_s == 0.0 and m.stop_direction == 0.0 and abs(s.speed_rad_s) < STOPPED_RAD_S:
            m.stopped = 1
    else:
        watch_limits(m, s.speed_rad_s, counts)
        if m.trip != 0 and not was_stopping:
            begin_stop(axis, m.stop_deceleration_rad_s2)


@inlined
def command(axis: AxisRow, motor_angle: float, period_s: float) -> float:
    """One control period of a drive: measure, set-point, law, limits; the torque in N·m, 0 behind a closed brake."""
    m = axis.motion
    counts = measured_counts(motor_angle, m.counts_per_rad)
    angle = counts / m.counts_per_rad
    if m.input_mask != 0 or m.edge_mask != 0:
        watch_inputs(m, counts)
    elif m.is_watching != 0:
        m.is_watching = 0
    if m.mode == BRAKED:
        _rest(axis, angle)
        return 0.0
    was_stopping = m.mode == STOPPING
    m.limited = 0
    position, velocity_offset, torque_offset = _demand(m, angle, period_s)
    if m.cancel_mode != 0 or m.cancel_fraction > 0.0:
        position, velocity_offset, torque_offset = _with_cancellation(
            axis, angle, period_s, position, velocity_offset, torque_offset
        )
    previous_integral_nm = axis.law.cascade_state.integral_nm
    # the law runs in torque modes too: it keeps the speed estimate, and its torque is passed over
    torque = servo_step(axis.law, period_s, m.torque_limit_nm, position, velocity_offset, torque_offset, angle)
    torque = _limited_torque(axis, previous_integral_nm, _used_torque(axis, period_s, previous_integral_nm, torque))
    m.torque_nm, m.torque_demand_nm, m.following_error_rad = torque, torque, position - angle
    _supervise(axis, was_stopping, counts, angle)
    return torque


@inlined
def age(axis: AxisRow, period_s: float) -> None:
    """Give the gear of an axis the error that it has after this control period; only for one that changes."""
    go_through(axis.change, axis.past, axis.plant, axis.plant_state, axis.motion.mode == BRAKED, period_s)
    put_error(axis.change, axis.past, axis.plant)


@compiled
def advance(periods: int, period_s: float, substeps: int, axes: Rows[AxisRow]) -> None:
    """Advance all axes by some control periods: measure, set-point, servo law, limits, plant.

    A broken limit turns the axis to its stop ramp in the very period in which it is seen; the drive's state machine follows.

    Args:
        periods: Number of control periods.
        period_s: The control period, 250 µs.
        substeps: Runge-Kutta steps of the plant per period.
        axes: `AXIS` array, shape (n_axes,); changed in place.
    """
    for row in range(len(axes)):  # an axis feels nothing of the others: each goes through all periods alone
        axis = axes[row]
        m, mechanics = axis.motion, axis.plant_state
        k = constants(axis.plant)
        near = nearest_to(k, mechanics)
        for _ in range(periods):
            torque = command(axis, mechanics.motor_angle_rad, period_s)
            near = plant_period(k, near, mechanics, torque, m.mode == BRAKED, period_s, substeps)
            if axis.change.is_changing > 0.0:
                age(axis, period_s)
                k = constants(axis.plant)
                near = nearest_to(k, mechanics)
        if m.trip != 0 or m.event != 0:
            m.wake = 1
        else:
            m.wake = 0
        if periods > 0:
            mechanics.arm_acceleration_rad_s2 = arm_acceleration(k, mechanics)


@compiled
def advance_traced(periods: int, period_s: float, substeps: int, axes: Rows[AxisRow], trace: Real) -> None:
    """`advance`, with the arms' states after every control period, for a sensor that remembers them.

    Args:
        periods: Number of control periods.
        period_s: The control period, 250 µs.
        substeps: Runge-Kutta steps of the plant per period.
        axes: `AXIS` array, shape (n_axes,); changed in place.
        trace: θ_l, θ̇_l and θ̈_l of each axis; shape (periods, n_axes, 3), written.
    """
    for row in range(len(axes)):
        axis = axes[row]
        m, mechanics = axis.motion, axis.plant_state
        k = constants(axis.plant)
        near = nearest_to(k, mechanics)
        for period in range(periods):
            torque = command(axis, mechanics.motor_angle_rad, period_s)
            near = plant_period(k, near, mechanics, torque, m.mode == BRAKED, period_s, substeps)
            if axis.change.is_changing > 0.0:
                age(axis, period_s)
                k = constants(axis.plant)
                near = nearest_to(k, mechanics)
            mechanics.arm_acceleration_rad_s2 = arm_acceleration(k, mechanics)
            trace[period, row, 0] = mechanics.arm_angle_rad
            trace[period, row, 1] = mechanics.arm_speed_rad_s
            trace[period, row, 2] = mechanics.arm_acceleration_rad_s2
        if m.trip != 0 or m.event != 0:
            m.wake = 1
        else:
            m.wake = 0


@compiled
def advance_sensed(
    periods: int,
    period_s: float,
    substeps: int,
    axes: Rows[AxisRow],
    trace: Real,
    row: int,
    lever_m: float,
    tips: Real,
    sensor: SectionsRow,
    ring: Real,
    sensed: Real,
) -> None:
    """`advance_traced`, the tip that one axis alone moves on its lever, and the sensor that feels it: one call instead of three.

    Args:
        periods: Number of control periods.
        period_s: The control period.
        substeps: Runge-Kutta steps of the plant per period.
        axes: `AXIS` array, shape (n_axes,); changed in place.
        trace: θ_l, θ̇_l and θ̈_l of each axis; shape (periods, n_axes, 3), written.
        row: Row of the axis that moves the tip.
        lever_m: Its lever.
        tips: The tip's acceleration after each period; shape (periods, 3), written.
        sensor: Sections and delay of the sensor; changed in place.
        ring: Its latest samples; shape (rows, 3), changed in place.
        sensed: Its output after the last period; shape (3,), written.
    """
    advance_traced(periods, period_s, substeps, axes, trace)
    for period in range(periods):
        speed = trace[period, row, 1]
        tips[period, 0], tips[period, 1], tips[period, 2] = -lever_m * speed * speed, 0.0, lever_m * trace[period, row, 2]
    sense(sensor, ring, tips, sensed)
