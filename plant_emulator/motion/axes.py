"""All axes of a robot as arrays for `period.h`, and the tip."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.control.notch import NO_NOTCH, NOTCHES
from plant_emulator.core import CORE
from plant_emulator.motion.arm import CoupledArm
from plant_emulator.motion.record import AXIS, BRAKED, NO_SET_POINT, UNTIL_WRITTEN
from plant_emulator.physics.axis import hang_at_rest
from plant_emulator.physics.sensing import SensorResponse
from plant_emulator.physics.tip import MovedTip, TipSensor
from plant_emulator.robots.gear_change import write_change
from plant_emulator.robots.robot import Robot, RobotAccelerometer

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


class FollowedRun(NamedTuple):
    """A run of cyclic set-points, at the instants at which they take effect.

    Attributes:
        position_counts: Encoders; shape (n, axes).
        arm_angle_rad: True arm angles; shape (n, axes).
        torque_nm: Motor torques; shape (n, axes).
        tip_m_s2: True acceleration (X, Y, Z) of the tip; shape (n, 3).
        sensed_m_s2: What the accelerometer passes on of it, without noise and steps; shape (n, 3).
    """

    position_counts: NDArray[np.int64]
    arm_angle_rad: Real
    torque_nm: Real
    tip_m_s2: Real
    sensed_m_s2: Real

    def since(self, first: int) -> "FollowedRun":
        """Return the run from a row on."""
        counts, arm, torque, tip, sensed = self
        return FollowedRun(counts[first:], arm[first:], torque[first:], tip[first:], sensed[first:])


class Axes:
    """Mechanics of a robot and process data of its drives.

    Row i is the i-th axis of the file, in rising order.

    Attributes:
        numbers: Axis number of each row.
        rows: `AXIS` array, shape (n_axes,): all that the compiled period works on. The others are views of its fields.
        notch_config: `NOTCH_CONFIG` array, shape (n_axes, NOTCHES), and so is `notch_state`.
        processes: `PROCESS` array, shape (n_axes,): the drives' values as PDOs bring them.
        shared: All that the compiled periods work on.
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
            write_change(axis.ate_change, axis.ate, axis.temperature, rows[row])
            axis.encoder.write(rows["encoder"][row], axis.encoder_counts_per_rev, robot.seed + number)
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
        self.tip = tip_of(robot)
        self.processes = np.zeros(count, CORE.dtype("process"))
        self._response = response_of(robot)
        self._axes = CORE.pointer(rows, "axis")
        self._prepared = CORE.pointer(np.zeros(count, CORE.dtype("prepared")), "prepared")
        self.shared, self._has_room_for = CORE.new("mechanics"), 0
        self._share()
        self._bind()

    def _share(self) -> None:
        """Give C the arrays."""
        shared = self.shared
        shared.axes, shared.prepared, shared.count, shared.tip = self._axes, self._prepared, len(self.numbers), self.tip.shared
        shared.period_s, shared.substeps = self.robot.control_period_s, self.robot.plant_substeps
        if self.arm is not None:
            shared.arm, shared.sensed = self.arm.shared, self.arm.felt_by
        if self._response is not None:
            shared.sections, shared.ring, shared.size, shared.sensed = self._response.shared

    def _bind(self) -> None:
        """Take hold of what every SYNC reads and writes."""
        motion = self.motion
        self._mode = live(motion, "mode")
        self._elapsed_periods, self._span = live(motion, "elapsed_periods"), live(motion, "periods_per_set_point")
        self._previous_speed, self._target_speed = live(motion, "previous_speed_rad_s"), live(motion, "target_speed_rad_s")
        self._control_period_s = self.robot.control_period_s

    def row(self, number: int) -> int:
        """Row of an axis."""
        return self.numbers.index(number)

    def advance(self, periods: int) -> None:
        """Advance everything by some control periods."""
        self.make_room(periods)
        CORE.call.advance_all([self.shared], 1, periods)

    def make_room(self, periods: int) -> None:
        """Make room for the arms' states and the tip after each of so many control periods, where the sensor filters."""
        if periods <= self._has_room_for or self._response is None:
            return
        self._has_room_for = periods
        self._room = CORE.pointer(np.empty((periods, len(self.numbers), 3))), CORE.pointer(np.empty((periods, 3)))
        self.shared.trace, self.shared.tips = self._room

    def follow(self, rows: Sequence[int], set_points: Real, periods: int) -> FollowedRun:
        """Give some axes in cyclic position mode one set-point after the other.

        The same as `set_point` and `advance` in turn.

        Args:
            set_points: In counts; shape (n, axes).
            periods: Control periods from one set-point to the next.
        """
        return follow_alike([self], rows, set_points, periods)[0]

    def counts(self, row: int) -> int:
        """The encoder's reading of an axis now."""
        return int(CORE.call.read_counts(self._axes + row))

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
        """Change an axis' mode under torque without a jump; see `begin_mode`."""
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
        """Give an axis in cyclic position mode its next set-point; see `period.h`."""
        CORE.call.set_point(self._axes + row, target_counts, self._control_period_s)

    def set_speed(self, row: int, speed_rad_s: float) -> None:
        """Give an axis in cyclic velocity mode its next set-point.

        The axis goes there from the last one in one interpolation period.
        """
        fraction = min(1.0, max(0.0, self._elapsed_periods[row] / self._span[row]))
        last, start = self._target_speed[row], self._previous_speed[row]
        self._previous_speed[row] = start + (last - start) * fraction
        self._target_speed[row], self._elapsed_periods[row] = speed_rad_s, 0

    def tip_acceleration(self) -> tuple[float, float, float]:
        """Return the tip's true acceleration (X, Y, Z) in m/s², without gravity.

        While a single brake is open the sensor sits on that axis' lever, as in the single-axis experiments: Z is L θ̈_l, X points
        inwards. Otherwise the planar chain of the geometry moves it; a robot without a geometry adds the levers up. The links of
        an arm move it in the frame of the base, whatever its brakes do.
        """
        if self.arm is not None:
            return self.arm.acceleration()
        CORE.call.tip_now(self.tip.shared, self._axes, len(self.numbers), self.tip.now_by)
        x, y, z = self.tip.now.tolist()
        return x, y, z

    def sensed_acceleration(self) -> tuple[float, float, float]:
        """Return the acceleration that the accelerometer passes on.

        It is `tip_acceleration` behind mounting, low-pass and delay, without noise and steps.

        One that is fixed to a link of an arm gives what it feels there, along its own axes.
        """
        CORE.call.sense_now(self.shared, self.tip.now_by)
        x, y, z = self.tip.now.tolist()
        return x, y, z


def follow_alike(robots: Sequence[Axes], rows: Sequence[int], set_points: Real, periods: int) -> list[FollowedRun]:
    """Give some axes of each robot the same set-points; see `Axes.follow`.

    Robots of a core that has vectors go in lock-step, which changes no bit.

    Args:
        robots: Robots of the same periods and the same axes.
        rows: As of `Axes.follow`, like the others.
        set_points: In counts; shape (n, axes).
        periods: Control periods from one set-point to the next.
    """
    number, samples = len(robots), len(set_points)
    trace, tips = np.zeros((number, samples, len(rows), CORE.call.TRACE_COLUMNS)), np.zeros((2, number, samples, 3))
    given = CORE.pointer(np.array(rows, np.int64), "int64_t"), len(rows), CORE.pointer(np.array(set_points, np.float64))
    for each in robots:
        each.make_room(periods)
    CORE.call.follow([each.shared for each in robots], number, periods, samples, *given, *map(CORE.pointer, (trace, *tips)))
    counts = trace[..., CORE.call.TRACE_COUNTS].astype(np.int64)
    return [FollowedRun(counts[i], trace[i, :, :, 1], trace[i, :, :, 2], *tips[:, i]) for i in range(number)]


def tip_of(robot: Robot) -> MovedTip:
    """Return the tip that the axes of a robot move, in rising order."""
    numbers, home = sorted(robot.axis), robot.home_joints()
    levers = [robot.axis[number].tip_lever_m for number in numbers]
    if robot.geometry is None or home is None:
        return MovedTip(levers)
    return MovedTip(levers, robot.geometry.chain(), [numbers.index(number) for number in robot.chain_axes], home.tolist())


def response_of(robot: Robot) -> SensorResponse | None:
    """Return the accelerometer's response; None if it shows the instant's acceleration."""
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


def tip_sensor(setting: RobotAccelerometer, generator: np.random.Generator) -> TipSensor:
    """Return the sensor at the tip that a robot file describes, with its source of noise."""
    return TipSensor(setting.noise_m_s2, setting.resolution_m_s2, setting.range_m_s2, generator, setting.mixing)
