"""The fleet: robots with harmonic drives drawn by seed.

The ranges are those of industrial robots.

Every quantity is drawn from a generator of its own, named by seed and quantity: a further quantity changes no other.

>>> from plant_emulator.robots.fleet import draw
>>> robot = draw(7)
>>> robot == draw(7), 50 <= robot.axis[2].reduction_ratio <= 160
(True, True)
"""

import math
from typing import Any, Literal
from zlib import crc32

import numpy as np

from hil.control.angles import ARCSEC
from hil.control.order_keys import phase_key
from hil.robot_tables import ORDERS, TransmissionErrorTable
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.robots.encoders import MotorEncoder
from plant_emulator.robots.robot import BusFacts, Robot, RobotAccelerometer, RobotAxis
from plant_emulator.trials.distributions import Chance, Distributions, Even, Logarithmic, OneOf, Whole

Kind = Literal["linear", "real", "any"]
"""Gear and drive: linear gear and no lag; hysteresis up to 2 N·m, softness and lag; hysteresis up to 5 N·m."""

AXIS_NUMBERS = (2, 3, 5)
DRAWN_DIGITS = 5
"""Significant digits of a drawn value: files stay readable."""
SOFT_GEAR_NM_RAD = 50e3
"""Gears softer than this get proportionally less hysteresis: a torque that a small gear never carries would lock it."""
CONTROL_PERIOD_S = 250e-6
RANGE_M_S2 = 32.0
"""Range of the accelerometer: the most that its node can state in mm/s², a strong error at 30 Hz reaches it nearly."""

SYNC_PERIODS_S = (0.001, 0.002, 0.004, 0.008)
ARM_INERTIA_KG_M2 = (0.3, 30.0)
"""Limits of J_l, to which J_m yields."""
ANY_DEG = Even(0.0, 360.0)

RANGES: Distributions = {
    "reduction_ratio": Whole(50, 160),
    "antiresonance_hz": Logarithmic(4.0, 30.0),  # f_a of the arm on its gear
    "inertia_ratio": Logarithmic(0.5, 5.0),  # J_l/(N² J_m)
    "motor_inertia": Logarithmic(0.3e-4, 4e-4),  # kg·m²
    "motor_damping": Even(2.5, 4.5),  # D_m/J_m in 1/s
    "arm_damping": Even(0.01, 0.018),  # D_l/(J_l ω_a)
    "damping": Even(0.02, 0.05),  # ζ of the arm on its gear
    "a1": Even(0.0, 60.0),  # arcsec
    "a2": Even(3.0, 60.0),
    "a4": Even(0.0, 20.0),
    **{phase_key(order): ANY_DEG for order in ORDERS},
    "friction": Logarithmic(0.3, 3.0),  # factor of the Coulomb friction 400/s² · J_m
    "stribeck": Even(1.0, 1.5),  # static over Coulomb friction
    "stribeck_velocity": Even(0.5, 2.0),  # ω_s in rad/s
    "gravity": Even(0.0, 1.2),  # in units of the arm's mass at half the lever
    "home_deg": Even(-180.0, 180.0),
    "encoder_bits": Whole(13, 20),  # counts per motor revolution as a power of 2
    "encoder_error_1": Even(0.0, 30.0),  # arcsec, once a motor revolution
    "encoder_phase_1": ANY_DEG,
    "encoder_error_2": Even(0.0, 15.0),  # arcsec, twice
    "encoder_phase_2": ANY_DEG,
    "encoder_noise": Even(0.0, 0.5),  # standard deviation in counts
    "current_lag_s": Even(0.0, 0.5e-3),
    "hysteresis": Even(0.0, 5.0),  # Dahl torque in N·m, of gears from `SOFT_GEAR_NM_RAD` on
    "softness": Even(0.0, 0.3),  # of soft wind-up
    "wind_up_torsion": Even(30.0, 90.0),  # arcsec
    "gear_reaction": Chance(),  # the gear loads the motor through its transmission error
    "tip_lever_m": Even(0.25, 0.9),
    "noise": Logarithmic(0.2, 5.0),  # factor of the accelerometer's noise of 0.02 m/s²
    "sensor_delay_s": Even(0.0, 10e-3),
    "sensor low-pass": Chance(),
    "lowpass_hz": Logarithmic(100.0, 400.0),
    "mounting resonance": Chance(),
    "mounting_hz": Logarithmic(200.0, 800.0),
    "mounting_damping": Even(0.02, 0.1),
    "sync_period_s": OneOf(SYNC_PERIODS_S),  # one that the bus does not carry gives way to the next
    "bitrate": OneOf((500_000, 1_000_000)),
    "late answers": Chance(0.25),
    "lateness": Even(0.1, 0.9),  # of the SYNC period
}
"""Distribution of each drawn quantity."""
REAL_HYSTERESIS_NM = 2.0
"""Largest Dahl torque of the kind `real`."""


class Draws:
    """Named draws of one robot."""

    def __init__(self, seed: int, ranges: Distributions, prefix: str = "") -> None:
        self._seed, self._ranges, self._prefix = seed, ranges, prefix

    def __call__(self, name: str, like: str | None = None) -> float:
        """Draw a quantity, rounded as in a file; `like` names its distribution where another quantity has it too."""
        source = np.random.default_rng((self._seed, crc32(f"{self._prefix}{name}".encode())))
        return rounded(self._ranges[like or name].draw(source))


def rounded(value: float) -> float:
    """Round a value to as many digits as a file has."""
    return float(f"{value:.{DRAWN_DIGITS}g}")


def draw(seed: int, ranges: Distributions = RANGES, *, kind: Kind = "any", axes: int = 1) -> Robot:
    """Draw a robot of the fleet; equal arguments give equal robots.

    Args:
        kind: Linear or real gear and drive; robots of equal seeds differ in nothing else.
        axes: Number of axes, 1 to 3.

    Raises:
        ValueError: The robot cannot have so many axes, or the seed is negative.
    """
    if not 1 <= axes <= len(AXIS_NUMBERS):
        raise ValueError(f"{axes} axes: a robot of the fleet has 1 to {len(AXIS_NUMBERS)}")
    if seed < 0:
        raise ValueError(f"seed {seed} is negative")
    if kind == "real":
        ranges = {**ranges, "hysteresis": Even(0.0, REAL_HYSTERESIS_NM)}
    bus = Draws(seed, ranges)
    bitrate = int(bus("bitrate"))
    drawn_s, least_s = bus("sync_period_s"), least_sync_period_s(axes, bitrate)
    sync_period_s = min((each for each in SYNC_PERIODS_S if each >= max(drawn_s, least_s)), default=drawn_s)
    is_late = bus("late answers")
    late_us = round(1e6 * sync_period_s * bus("lateness")) if is_late else 0
    numbers = AXIS_NUMBERS[:axes]
    return Robot(
        name=f"fleet-{kind}-{seed}",
        seed=seed,
        control_period_s=CONTROL_PERIOD_S,
        sync_period_s=sync_period_s,
        bus=BusFacts(bitrate=bitrate),
        axis={number: _axis(Draws(seed, ranges, f"axis {number} "), kind, number, late_us) for number in numbers},
        accelerometer=accelerometer(bus),
    )


def least_sync_period_s(axes: int, bitrate: int) -> float:
    """Return a SYNC period that a bus carries with some margin.

    Integrators choose no shorter one.

    `hil plan` has 0.88 ms in a cycle of one drive at 500 kbit/s, and finds that three fit at 1 Mbit/s every 2 ms.
    """
    return (0.5e-3 + 0.75e-3 * axes) * 500_000 / bitrate


def accelerometer(draws: Draws) -> RobotAccelerometer:
    """Return the sensor with noise, delay and mounting."""
    has_lowpass, is_loose = draws("sensor low-pass"), draws("mounting resonance")
    return RobotAccelerometer(
        node_id=16,
        range_m_s2=RANGE_M_S2,
        noise_m_s2=rounded(0.02 * draws("noise")),
        delay_s=draws("sensor_delay_s"),
        lowpass_hz=draws("lowpass_hz") if has_lowpass else None,
        mounting_resonance_hz=draws("mounting_hz") if is_loose else None,
        mounting_damping=draws("mounting_damping") if is_loose else 0.05,
    )


def driven(draws: Draws, ratio: float, motor: float, inertia: float, antiresonance_hz: float) -> dict[str, Any]:
    """Draw motor, gear and encoder for the inertias J_m and J_l."""
    omega = 2.0 * math.pi * antiresonance_hz
    bearing = rounded(draws("arm_damping") * inertia * omega)
    coulomb = rounded(400.0 * motor * draws("friction"))
    return {
        "reduction_ratio": ratio,
        "motor_inertia_kg_m2": motor,
        "motor_damping_nm_s_rad": rounded(motor * draws("motor_damping")),
        "arm_damping_nm_s_rad": bearing,
        "gear_stiffness_nm_rad": rounded(inertia * omega**2),
        "gear_damping_nm_s_rad": rounded(max(0.1 * bearing, 2.0 * draws("damping") * inertia * omega - bearing)),
        "coulomb_friction_nm": coulomb,
        "static_friction_nm": rounded(coulomb * draws("stribeck")),
        "stribeck_velocity_rad_s": draws("stribeck_velocity"),
        "encoder_counts_per_rev": 2 ** int(draws("encoder_bits")),
        "encoder": MotorEncoder(
            error_1_arcsec=draws("encoder_error_1"),
            phase_1_deg=draws("encoder_phase_1"),
            error_2_arcsec=draws("encoder_error_2"),
            phase_2_deg=draws("encoder_phase_2"),
            noise_counts=draws("encoder_noise"),
        ),
        "ate": TransmissionErrorTable.of(
            {order: draws(f"a{order}") for order in ORDERS}, {order: draws(phase_key(order)) for order in ORDERS}
        ),
        "gear_reaction": bool(draws("gear_reaction")),
    }


def _axis(draws: Draws, kind: Kind, number: int, late_us: int) -> RobotAxis:
    """Draw one axis: inertias first, all else in proportion."""
    ratio = draws("reduction_ratio")
    arms = draws("inertia_ratio") * ratio**2
    low, high = (limit / arms for limit in ARM_INERTIA_KG_M2)
    motor = rounded(min(high, max(low, draws("motor_inertia"))))
    arm = rounded(motor * arms)
    drive, lever = driven(draws, ratio, motor, arm, draws("antiresonance_hz")), draws("tip_lever_m")
    gravity = rounded(draws("gravity") * arm * 9.81 / (2.0 * lever))
    is_linear = kind == "linear"
    hysteresis = draws("hysteresis") * min(1.0, drive["gear_stiffness_nm_rad"] / SOFT_GEAR_NM_RAD)
    lag_s = draws("current_lag_s")
    step_s = CONTROL_PERIOD_S / 4.0  # the solver's, of which a lag must be at least half
    return RobotAxis(
        **drive,
        node_id=number,
        arm_inertia_kg_m2=arm,
        gravity_moment_nm=gravity,
        home_deg=draws("home_deg"),
        torque_limit_nm=rounded(9000.0 * (motor + arm / ratio**2) + 1.5 * gravity / ratio + 3.0 * drive["static_friction_nm"]),
        tip_lever_m=lever,
        wind_up_softness=0.0 if is_linear else draws("softness"),
        wind_up_torsion_arcsec=draws("wind_up_torsion"),
        hysteresis_torque_nm=0.0 if is_linear else rounded(hysteresis),
        hysteresis_torsion_arcsec=20.0,
        current_time_constant_s=0.0 if is_linear or lag_s < 0.5 * step_s else lag_s,
        behaviour=Behaviour(tpdo_delay_us=late_us),
    )


def antiresonance_hz(axis: RobotAxis) -> float:
    """Return f_a = √(K_g/J_l)/2π with the gear's nominal stiffness."""
    return math.sqrt(axis.gear_stiffness_nm_rad / axis.arm_inertia_kg_m2) / (2.0 * math.pi)


def small_motion_antiresonance_hz(axis: RobotAxis) -> float:
    """Return f_a for the smallest motions.

    There wind-up softens the gear, and hysteresis stiffens it.
    """
    stiffness = axis.gear_stiffness_nm_rad * (1.0 - axis.wind_up_softness)
    stiffness += axis.hysteresis_torque_nm / (axis.hysteresis_torsion_arcsec * ARCSEC)
    return math.sqrt(stiffness / axis.arm_inertia_kg_m2) / (2.0 * math.pi)
