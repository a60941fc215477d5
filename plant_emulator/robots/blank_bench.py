"""Text of a robot's bench file with what an engineer knows before anything has been measured."""

import math

from drive_profiles.files.toml import toml_value
from plant_emulator.robots.robot import Robot, RobotAxis
from plant_emulator.robots.stable import antiresonance_hz

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
SECOND_ORDER_END = 0.68
"""The motion's end over f_a: it passes the resonance of order 2, as the working speeds of such a robot do."""


def blank_bench(robot: Robot, address: str = "local:/tmp/robot.sock") -> str:
    """Text of a bench file: ratios, levers, limits, gains, a copied notch and a motion; no model.

    Gains are as an integrator sets them: the velocity loop by the rotor's inertia, K_pp by the frequency at which the arm rings.

    Args:
        robot: The robot.
        address: The bus; the robot's bit rate is added where it says one.
    """
    bitrate = robot.bus.bitrate
    lines = [
        f"name = {toml_value(robot.name)}",
        "settle_s = 0.5",
        "approach_rps = 8.0",
        "",
        "[bus]",
        f"address = {toml_value(address if bitrate is None else f'{address}@{bitrate}')}",
        f"sync_period_s = {toml_value(robot.sync_period_s)}",
        "",
        "[accelerometer]",
        f"node_id = {robot.accelerometer.node_id}",
        f"range_m_s2 = {toml_value(robot.accelerometer.range_m_s2)}",
    ]
    for number, axis in sorted(robot.axis.items()):
        lines += _axis_lines(number, axis, robot.node_ids[number])
    acceleration, end_rps = _motion(min(robot.axis.values(), key=_reach))
    lines += ["", "[constant_acceleration]", f"acceleration_rps_s = {acceleration:g}", f"end_rps = {end_rps:g}"]
    lines += [f"deceleration_rps_s = {DECELERATION_RPS_S:g}", "dwell_s = 0.2", "tail_s = 0.5", ""]
    return "\n".join(lines)


def _axis_lines(number: int, axis: RobotAxis, node_id: int) -> list[str]:
    gain = _digits(2.0 * math.pi * ROTOR_BANDWIDTH_HZ * axis.motor_inertia_kg_m2)
    position_gain, reach = position_gain_per_s(axis), travel_rev(axis)
    limits = {
        "torque_nm": axis.torque_limit_nm,
        "speed_rps": speed_limit_rps(axis),
        "position_min_rev": -reach,
        "position_max_rev": reach,
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
        f"reduction_ratio = {toml_value(axis.reduction_ratio)}",
        f"tip_lever_m = {toml_value(axis.tip_lever_m)}",
        f"limits = {toml_value(limits)}",
        f"control = {toml_value(control)}",
        "",
        f"[[axis.{number}.notch]]",
        *(f"{key} = {toml_value(value)}" for key, value in TABLE_3.items()),
    ]


def position_gain_per_s(axis: RobotAxis) -> float:
    """K_pp by the frequency at which the arm rings."""
    return _digits(POSITION_GAIN_PER_S * math.sqrt(antiresonance_hz(axis) / GAIN_HZ))


def speed_limit_rps(axis: RobotAxis) -> float:
    """Largest motor speed: order 1 meets the arm's resonance below it."""
    return max(LEAST_SPEED_RPS, math.ceil(SPEED_PER_HZ * antiresonance_hz(axis)))


def travel_rev(axis: RobotAxis) -> float:
    """Reach of the motor to either side, whole revolutions."""
    return float(math.floor(TRAVEL * axis.reduction_ratio))


def _reach(axis: RobotAxis) -> float:
    return travel_rev(axis)


def _motion(axis: RobotAxis) -> tuple[float, float]:
    """Acceleration and end speed of a motion from the middle of the travel, in rev/s² and rev/s."""
    acceleration, end = ACCELERATIONS_RPS_S[0], 0.0
    for acceleration in ACCELERATIONS_RPS_S:
        room = 0.9 * travel_rev(axis) / (0.5 / acceleration + 0.5 / DECELERATION_RPS_S)
        end = min(0.85 * speed_limit_rps(axis), math.sqrt(room))
        if end >= SECOND_ORDER_END * antiresonance_hz(axis):
            break
    return acceleration, math.floor(10.0 * end) / 10.0


def _digits(value: float) -> float:
    return float(f"{value:.4g}")
