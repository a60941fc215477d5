"""All axes of a robot as arrays.

The control period of `period.h` works on them, and the tip feels them.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.control.notch import NO_NOTCH, NOTCHES
from plant_emulator.core import CORE
from plant_emulator.motion.arm import CoupledArm
from plant_emulator.motion.record import (
    AXIS,
    BRAKED,
    NO_SET_POINT,
    SET_POINT_RANGE,
    SET_POINT_STEP,
    UNTIL_WRITTEN,
)
from plant_emulator.physics.axis import hang_at_rest
from plant_emulator.physics.sensing import SensorResponse
from plant_emulator.physics.tip import chain_acceleration, lever_acceleration
from plant_emulator.robots.gear_change import write_change
from plant_emulator.robots.robot import Robot

Real = NDArray[np.float64]


AT_REST = (
    "previous_speed_rad_s",
    "target_speed_rad_s",
    "reference_speed_rad_s",
    "demand_speed_rad_s",
    "target_torque_nm",
    "torque_demand_nm",
    "following_count",
    "position_window_count",
    "velocity_window_count",
    "velocity_threshold_count",
    "stop_direction",
    "late_periods",
    "limited",
    "reached",
    "trip",
    "stopped",
)
"""Fields of `MOTION` that are 0 when a brake opens."""


def live(array: Any, field: str) -> Any:
    """Writable view of one field over all axes, exchanging plain numbers.

    A record's field costs 370 ns to read and 410 ns to write, an element of this view 26 ns and 49 ns (CPython 3.11).
    """
    return memoryview(array[field])


class Axes:
    """Mechanics of a robot and process data of its drives.

    Row i is the i-th axis of the file, in rising order.

    Attributes:
        numbers: Axis number of each row.
        rows: `AXIS` array, shape (n_axes,): all that the compiled period works on. The others are views of its fields.
        plant: `PLANT` array, shape (n_axes,).
        plant_state: `PLANT_STATE` array, shape (n_axes,).
        motion: `MOTION` array, shape (n_axes,).
        cascade_config: `CASCADE_CONFIG` array, shape (n_axes,).
        cascade_state: `CASCADE_STATE` array, shape (n_axes,).
        notch_config: `NOTCH_CONFIG` array, shape (n_axes, NOTCHES).
        notch_state: `NOTCH_STATE` array, shape (n_axes, NOTCHES).
        arm: The arm whose links couple the axes; None if each turns an inertia of its own.
    """

    def __init__(self, robot: Robot) -> None:
        """Lay out the arrays.

        All brakes are closed, and the arms hang at rest at home.
        """
        self.robot = robot
        self.numbers = tuple(sorted(robot.axis))
        count = len(self.numbers)
        self.rows = rows = np.zeros(count, AXIS)
        self.plant, self.plant_state, self.motion, law = rows["plant"], rows["plant_state"], rows["motion"], rows["law"]
        self.cascade_config, self.cascade_state = law["cascade_config"], law["cascade_state"]
        self.notch_config, self.notch_state = law["notch_config"], law["notch_state"]
        for row, number in enumerate(self.numbers):
            axis = robot.axis[number]
            axis.write(self.plant[row], robot.home_angle(number))
            write_change(axis, rows[row])
            hang_at_rest(self.plant[row], self.plant_state[row])
            motion = self.motion[row]
            motion["mode"] = BRAKED
            motion["counts_per_rad"] = axis.encoder_counts_per_rev / (2.0 * math.pi)
            motion["counts_per_rev"] = axis.encoder_counts_per_rev
            motion["periods_per_set_point"] = 1
            motion["torque_limit_nm"] = motion["torque_high_nm"] = axis.torque_limit_nm
            motion["torque_low_nm"] = -axis.torque_limit_nm
            for field, value in UNTIL_WRITTEN.items():
                motion[field] = value
            for switch in ("home", "probe_1", "probe_2"):  # nowhere
                motion[f"{switch}_low_counts"], motion[f"{switch}_high_counts"] = math.inf, -math.inf
            if axis.control is not None:
                axis.control.cascade().write(self.cascade_config[row])
            for column in range(NOTCHES):
                NO_NOTCH.write(self.notch_config[row, column])
        self.arm = None if robot.links is None else CoupledArm(robot.links, self.numbers, rows, robot.accelerometer.mounting)
        self._chain = robot.geometry.chain() if robot.geometry is not None else None
        home = robot.home_joints()
        self._home = None if home is None else home.tolist()
        self._chain_rows = [] if home is None else [self.row(number) for number in robot.chain_axes]
        self._levers = [robot.axis[number].tip_lever_m for number in self.numbers]
        self._response = response_of(robot)
        self._axes = CORE.pointer(rows, "axis")
        self._bind()

    def _bind(self) -> None:
        """Take hold of what every SYNC reads and writes."""
        motion, state = self.motion, self.plant_state
        self._mode, self._trip = live(motion, "mode"), live(motion, "trip")
        self._counts_per_rad, self._max_speed = live(motion, "counts_per_rad"), live(motion, "max_speed_rad_s")
        self._previous, self._target = live(motion, "previous_counts"), live(motion, "target_counts")
        self._elapsed_periods, self._span = live(motion, "elapsed_periods"), live(motion, "periods_per_set_point")
        self._extrapolate = live(motion, "extrapolation_periods")
        self._previous_speed, self._target_speed = live(motion, "previous_speed_rad_s"), live(motion, "target_speed_rad_s")
        self._low, self._high = live(motion, "low_counts"), live(motion, "high_counts")
        self._motor_angle, self._arm_angle = live(state, "motor_angle_rad"), live(state, "arm_angle_rad")
        self._arm_speed, self._arm_acceleration = live(state, "arm_speed_rad_s"), live(state, "arm_acceleration_rad_s2")
        self._control_period_s = self.robot.control_period_s
        self._substeps = self.robot.plant_substeps

    def row(self, number: int) -> int:
        """Row of an axis."""
        return self.numbers.index(number)

    def advance(self, periods: int) -> None:
        """Advance everything by some control periods."""
        row = None if self._response is None or self.arm is not None else self._single_row()
        if self._response is None or row is None:
            self.advance_chain(periods)
            return
        _, _, trace, tips = self._buffers_of(periods)
        timing, axes = (periods, self._control_period_s, self._substeps), (self._axes, len(self.numbers))
        CORE.call.advance_sensed(*timing, *axes, trace, row, self._levers[row], tips, *self._response.shared)

    def advance_chain(self, periods: int) -> None:
        """`advance` where several axes move the tip, or the sensor remembers nothing."""
        if self.arm is not None:
            self._advance_arm(self.arm, periods)
            return
        axes = self._axes, len(self.numbers)
        if self._response is None:
            CORE.call.advance(periods, self._control_period_s, self._substeps, *axes, CORE.NULL)
            return
        states, tips, trace, _ = self._buffers_of(periods)
        CORE.call.advance(periods, self._control_period_s, self._substeps, *axes, trace)
        self._fill(tips, states)
        self._response.drive(tips)

    def _advance_arm(self, arm: CoupledArm, periods: int) -> None:
        """`advance` where links couple the axes."""
        timing = periods, self._control_period_s, self._substeps
        if self._response is None:
            arm.advance(*timing)
            return
        _, tips, _, _ = self._buffers_of(periods)
        arm.advance(*timing, tips)
        self._response.drive(tips)

    def counts(self, row: int) -> int:
        """The encoder's reading of an axis now."""
        # `measured_counts` of `period.h`, whose call costs more than the arithmetic
        counts: int = math.floor(self._motor_angle[row] * self._counts_per_rad[row] + 0.5)
        return counts

    def open_brake(self, row: int, mode: int, periods_per_set_point: int = 1) -> int:
        """Open the brake of an axis in a mode of `motion.record`.

        The set-point is the present motor position, in counts; it is returned.
        """
        motion, counts = self.motion[row], self.counts(row)
        motion["previous_counts"] = motion["target_counts"] = counts
        motion["elapsed_periods"] = NO_SET_POINT
        motion["periods_per_set_point"] = periods_per_set_point
        motion["reference_rad"] = motion["demand_rad"] = counts / motion["counts_per_rad"]
        for field in AT_REST:
            motion[field] = 0
        motion["mode"] = mode
        return counts

    def change_mode(self, row: int, mode: int, periods_per_set_point: int = 1) -> None:
        """Change the mode of an axis under torque without a jump.

        See `begin_mode` of `transitions.h`.
        """
        if self._mode[row] == BRAKED:
            raise ValueError(f"axis {self.numbers[row]} has its brake closed; open_brake opens it")
        self.motion[row]["periods_per_set_point"] = periods_per_set_point
        CORE.call.begin_mode(self._axes + row, mode)

    def stop(self, row: int, deceleration_rad_s2: float) -> None:
        """Begin a ramp to rest.

        An infinite deceleration brakes with all the torque that the limits allow.
        """
        CORE.call.begin_stop(self._axes + row, deceleration_rad_s2)

    def set_point(self, row: int, target_counts: int) -> None:
        """Give an axis in cyclic position mode its next set-point.

        The axis goes there from its present demand in one interpolation period.

        One outside the position limits, or faster than the motor may turn, trips the axis and is not followed. A SYNC that falls
        a control period early, as those of a busy bus do, finds the axis that much behind its last set-point: what counts is
        the step from that.
        """
        span, elapsed = self._span[row], self._elapsed_periods[row]
        fraction = elapsed / span
        last, start = self._target[row], self._previous[row]
        if fraction <= 1.0:
            start += (last - start) * fraction
        else:  # late: the set-point has been held, or led on
            start += (last - start) * min(fraction, 1.0 + self._extrapolate[row] / span)
        target = float(target_counts)
        reach = self._max_speed[row] * self._counts_per_rad[row] * span * self._control_period_s
        if not self._low[row] <= target <= self._high[row]:
            self._trip[row] |= SET_POINT_RANGE
            target = start
        elif abs(target - (last if elapsed >= span - 1 else start)) > reach + 1.0:
            self._trip[row] |= SET_POINT_STEP
            target = start
        self._previous[row], self._target[row], self._elapsed_periods[row] = start, target, 0

    def set_speed(self, row: int, speed_rad_s: float) -> None:
        """Give an axis in cyclic velocity mode its next set-point.

        The axis goes there from the last one in one interpolation period.
        """
        fraction = min(1.0, max(0.0, self._elapsed_periods[row] / self._span[row]))
        last, start = self._target_speed[row], self._previous_speed[row]
        self._previous_speed[row] = start + (last - start) * fraction
        self._target_speed[row], self._elapsed_periods[row] = speed_rad_s, 0

    def tip_acceleration(self) -> tuple[float, float, float]:
        """Return the true acceleration (X, Y, Z) of the tip in m/s².

        Gravity is left out.

        While a single brake is open the sensor sits on that axis' lever, as in the single-axis experiments: Z is L θ̈_l, X points
        inwards. Otherwise the planar chain of the geometry moves it; a robot without a geometry adds the levers up. The links of
        an arm move it in the frame of the base, whatever its brakes do.
        """
        if self.arm is not None:
            return self.arm.acceleration()
        speeds, accelerations = self._arm_speed.tolist(), self._arm_acceleration.tolist()
        row = self._single_row()
        if row is not None:
            return lever_acceleration(self._levers[row], speeds[row], accelerations[row])
        return self._joint_acceleration(self._arm_angle, speeds, accelerations)

    def sensed_acceleration(self) -> tuple[float, float, float]:
        """Return the acceleration that the accelerometer passes on.

        It is `tip_acceleration` behind mounting, low-pass and delay, without noise and steps.

        One that is fixed to a link of an arm gives what it feels there, along its own axes.
        """
        if self._response is not None:
            return self._response.acceleration_m_s2
        return self.tip_acceleration() if self.arm is None else self.arm.felt()

    def _single_row(self) -> int | None:
        """Return the row that alone moves the tip.

        Its brake alone is open, or it is the only row; None if several rows, or none, move the tip.
        """
        modes = self._mode.tolist()
        if len(modes) == 1 and self._chain is None:
            return 0
        if len(modes) - modes.count(BRAKED) != 1:
            return None
        return next(row for row, mode in enumerate(modes) if mode != BRAKED)

    def _buffers_of(self, periods: int) -> tuple[Real, Real, Any, Any]:
        """Return arrays for the arms' states and the tip.

        They have a row for each of so many control periods; the same follows in C.
        """
        states, tips = np.empty((periods, len(self.numbers), 3)), np.empty((periods, 3))
        return states, tips, CORE.pointer(states), CORE.pointer(tips)

    def _fill(self, tips: Real, trace: Real) -> None:
        """Write the true acceleration of a tip that several axes move.

        It is that after each control period; shape (periods, 3).
        """
        for i, (angles, speeds, accelerations) in enumerate(trace.transpose(0, 2, 1).tolist()):
            tips[i] = self._joint_acceleration(angles, speeds, accelerations)

    def _joint_acceleration(
        self, bent: Sequence[float], speeds: Sequence[float], accelerations: Sequence[float]
    ) -> tuple[float, float, float]:
        """Acceleration of the tip where all axes move it."""
        if self._chain is None or self._home is None:
            x = -sum(lever * speed * speed for lever, speed in zip(self._levers, speeds, strict=True))
            return x, 0.0, sum(lever * a for lever, a in zip(self._levers, accelerations, strict=True))
        (i, j, k), (home_i, home_j, home_k) = self._chain_rows, self._home
        angles = home_i + bent[i], home_j + bent[j], home_k + bent[k]
        return chain_acceleration(
            self._chain, angles, (speeds[i], speeds[j], speeds[k]), (accelerations[i], accelerations[j], accelerations[k])
        )


def response_of(robot: Robot) -> SensorResponse | None:
    """Return the response of the robot's accelerometer.

    None if it shows the tip's acceleration of the instant.
    """
    sensor = robot.accelerometer
    if not sensor.filters:
        return None
    return SensorResponse(
        robot.control_period_s,
        delay_s=sensor.delay_s,
        lowpass_hz=sensor.lowpass_hz,
        mounting_resonance_hz=sensor.mounting_resonance_hz,
        mounting_damping=sensor.mounting_damping,
    )
