"""Text of a robot's bench file before any measurement."""

import math
from dataclasses import replace

from drive_profiles.address import parse_address
from drive_profiles.files.toml import Table, table_lines, toml_value
from hil.arm.mounting import Mounting
from hil.arm.straight_line import JointLimits
from hil.arm.tables import ArmTable
from hil.control.trajectory import reach_rps
from plant_emulator.robots.arm_motions import arm_ramp, first_line
from plant_emulator.robots.drawn_arms import arm_facts
from plant_emulator.robots.fleet import antiresonance_hz
from plant_emulator.robots.robot import ArmAxis, ArmRobot, Robot, RobotAxis

TABLE_3 = {"order": 2, "start_rps": 4.0, "end_rps": 9.0, "offset_hz": 0.5, "zeta_rn": 0.028, "zeta_rdth": 0.1}
"""The paper's notch of axis 2, copied without a thought to the robot that it was not made for."""
ROTOR_BANDWIDTH_HZ = 100.0
"""Bandwidth of the velocity loop on the rotor's inertia."""
INTEGRATOR_PER_S = 20.0
"""K_vi/K_vp."""
POSITION_GAIN_PER_S, GAIN_HZ = 25.0, 12.0
"""K_pp of a robot whose arm rings at 12 Hz; others in proportion to the root of their frequency."""
TRAVEL = 0.4
"""Position limits in units of N revolutions: ±144° of the joint."""
LEAST_SPEED_RPS, SPEED_PER_HZ = 15.0, 1.5
ACCELERATIONS_RPS_S = (4.0, 6.0, 8.0, 12.0, 16.0, 20.0)
DECELERATION_RPS_S = 20.0
_LARGEST_COUNTS_S2 = 2**32 - 1
"""Largest acceleration that 60C5h and 60C6h can hold, in counts/s²."""
BAND_OVER_MODE = (0.55, 2.4)
"""Band in which an arm's line is judged over the frequency at which it is seen to ring: that of the reference arm."""
SECOND_ORDER_END = 0.68
"""The motion's end over f_a: it passes the resonance of order 2, as the working speeds of such a robot do."""


def blank_bench(robot: Robot, address: str = "local:/tmp/robot.sock", drawing: ArmTable | None = None) -> str:
    """Return the text of a bench file without a model.

    Gains are those of an integrator: the velocity loop from the rotor's inertia, K_pp from the resonance of the arm.

    Args:
        address: The bus; the robot's bit rate is added if its file states one.
        drawing: The arm as in the robot's own file if that names a URDF file, which the bench file names as well.
    """
    bus = parse_address(address)
    lines = [
        f"name = {toml_value(robot.name)}",
        "settle_s = 0.5",
        "approach_rps = 8.0",
        "",
        "[bus]",
        f"address = {toml_value(str(replace(bus, bitrate=robot.bus.bitrate or bus.bitrate)))}",
        f"sync_period_s = {toml_value(robot.sync_period_s)}",
        "",
        "[accelerometer]",
        f"node_id = {robot.accelerometer.node_id}",
        f"range_m_s2 = {toml_value(robot.accelerometer.range_m_s2)}",
    ]
    if isinstance(robot, ArmRobot):
        low_hz, high_hz = (round(2.0 * factor * arm_facts(robot)["mode_1_hz"]) / 2.0 for factor in BAND_OVER_MODE)
        lines += ["", "[specification]", f"band_hz = {toml_value([low_hz, high_hz])}"]
    if robot.links is not None:
        lines += _arm_lines(drawing or robot.links, robot.accelerometer.mounting)
    for number, axis in sorted(robot.axis.items()):
        lines += _axis_lines(number, axis, robot.node_ids[number], robot.links)
    acceleration, end_rps = _motion(min(robot.axis.values(), key=travel_rev))
    if robot.links is not None:
        lines += _line_lines(robot, robot.links)
        joints = [robot.axis[number] for number in robot.links.axes]
        acceleration, end_rps = arm_ramp(joints, 0.85 * min(map(speed_limit_rps, joints)), DECELERATION_RPS_S)
    lines += ["", "[constant_acceleration]", f"acceleration_rps_s = {acceleration:g}", f"end_rps = {end_rps:g}"]
    lines += [f"deceleration_rps_s = {DECELERATION_RPS_S:g}", "dwell_s = 0.2", "tail_s = 0.5", ""]
    return "\n".join(lines)


def _arm_lines(arm: ArmTable, mounting: Mounting | None) -> list[str]:
    """Return the lines about an arm that an engineer knows."""
    lines = []
    if mounting is not None:
        lines += ["", "[accelerometer.mounting]", *_given(mounting, "misalignment_deg")]
    lines += ["", "[arm]", *_given(arm, "link", "payload")]
    for link in arm.link:
        lines += ["", "[[arm.link]]", *_given(link, "body")]
    return lines


def _line_lines(robot: Robot, arm: ArmTable) -> list[str]:
    """Return a straight line from home within the axes' limits, if any."""
    limits = []
    for link, home in zip(arm.link, arm.home_rad().tolist(), strict=True):
        axis = robot.axis[link.axis]
        low, high = (home + math.tau * end / axis.reduction_ratio for end in _range_rev(link.axis, axis, arm))
        fastest = math.tau * speed_limit_rps(axis) / axis.reduction_ratio
        limits.append(JointLimits(low, high, min(fastest, math.radians(link.speed_limit_deg_s or math.inf))))
    motion = first_line(arm, limits)
    return [] if motion is None else ["", "[line_motion]", *_given(motion)]


def _given(table: Table, *unknown: str) -> list[str]:
    """Return the known keys of a table that differ from defaults."""
    values = table.model_dump(exclude_none=True, exclude_defaults=True, exclude=set(unknown))
    return [f"{key} = {toml_value(value)}" for key, value in values.items()]


def _axis_lines(number: int, axis: RobotAxis, node_id: int, arm: ArmTable | None) -> list[str]:
    gain = _digits(2.0 * math.pi * ROTOR_BANDWIDTH_HZ * axis.motor_inertia_kg_m2)
    position_gain, (low, high) = position_gain_per_s(axis), _range_rev(number, axis, arm)
    limits = {
        "torque_nm": axis.torque_limit_nm,
        "speed_rps": speed_limit_rps(axis),
        "acceleration_rps_s": acceleration_limit_rps_s(axis),
        "position_min_rev": low,
        "position_max_rev": high,
        "following_error_rev": max(4.0, _digits(1.5 * speed_limit_rps(axis) / position_gain)),
    }
    control = {
        "position_gain_per_s": position_gain,
        "velocity_gain_nm_s_rad": gain,
        "velocity_integral_gain_nm_rad": _digits(INTEGRATOR_PER_S * gain),
        "lowpass_hz": 300.0,
    }
    return [
        "",
        f"[axis.{number}]",
        f"node_id = {node_id}",
        f"profile = {toml_value(axis.profile)}",
        *([f"joint = {toml_value(axis.joint)}"] if isinstance(axis, ArmAxis) and axis.joint is not None else []),
        f"reduction_ratio = {toml_value(axis.reduction_ratio)}",
        f"tip_lever_m = {toml_value(axis.tip_lever_m)}"
        if arm is None
        else f"motor_inertia_kg_m2 = {axis.motor_inertia_kg_m2:.2g}",  # as a data sheet has it
        f"limits = {toml_value(limits)}",
        f"control = {toml_value(control)}",
        "",
        f"[[axis.{number}.notch]]",
        *(f"{key} = {toml_value(value)}" for key, value in TABLE_3.items()),
    ]


def position_gain_per_s(axis: RobotAxis) -> float:
    """Return K_pp from the resonance of the arm."""
    return _digits(POSITION_GAIN_PER_S * math.sqrt(antiresonance_hz(axis) / GAIN_HZ))


def speed_limit_rps(axis: RobotAxis) -> float:
    """Return the largest motor speed, above order 1's at the arm's resonance."""
    return max(LEAST_SPEED_RPS, math.ceil(SPEED_PER_HZ * antiresonance_hz(axis)))


def acceleration_limit_rps_s(axis: RobotAxis) -> float:
    """Return the largest motor acceleration.

    It is what the torque gives rotor and arm, in two digits, as an engineer sizes a drive; at most what 60C5h can hold.
    """
    inertia = axis.motor_inertia_kg_m2 + axis.arm_inertia_kg_m2 / axis.reduction_ratio**2
    largest = _LARGEST_COUNTS_S2 / axis.encoder_counts_per_rev
    return min(float(f"{axis.torque_limit_nm / (math.tau * inertia):.2g}"), float(math.floor(largest)))


def travel_rev(axis: RobotAxis) -> float:
    """Return the motor's reach to either side, in whole revolutions."""
    return float(math.floor(TRAVEL * axis.reduction_ratio))


def _range_rev(number: int, axis: RobotAxis, arm: ArmTable | None) -> tuple[float, float]:
    """Return the motor's limits: its reach within its link's range."""
    reach = travel_rev(axis)
    if arm is None:
        return -reach, reach
    row = arm.axes.index(number)
    range_deg, home_deg = arm.link[row].range_deg, math.degrees(float(arm.home_rad()[row]))
    if range_deg is None:
        return -reach, reach
    low, high = ((end - home_deg) / 360.0 * axis.reduction_ratio for end in range_deg)
    return max(-reach, float(math.ceil(low))), min(reach, float(math.floor(high)))


def _motion(axis: RobotAxis) -> tuple[float, float]:
    """Return acceleration (rev/s²) and end speed (rev/s) from mid-travel."""
    acceleration, end = ACCELERATIONS_RPS_S[0], 0.0
    for acceleration in ACCELERATIONS_RPS_S:
        end = min(0.85 * speed_limit_rps(axis), reach_rps(0.9 * travel_rev(axis), acceleration, DECELERATION_RPS_S))
        if end >= SECOND_ORDER_END * antiresonance_hz(axis):
            break
    return acceleration, math.floor(10.0 * end) / 10.0


def _digits(value: float) -> float:
    return float(f"{value:.4g}")


def file_text(table: Table) -> str:
    """Return a robot or a bench as the text of its file."""
    return "\n".join([*table_lines(table.model_dump(exclude_none=True, exclude_defaults=True)), ""])
