"""The fleet: robots with harmonic drives drawn by seed.

The ranges are those of industrial robots.

Every quantity is drawn from a generator of its own, named by seed and quantity: a further quantity changes no other.

>>> from plant_emulator.robots.fleet import draw
>>> robot = draw(7)
>>> robot == draw(7), 50 <= robot.axis[2].reduction_ratio <= 160
(True, True)
"""

import math
from dataclasses import dataclass
from typing import Literal
from zlib import crc32

import numpy as np

from hil.control.angles import ARCSEC
from hil.robot_tables import ORDERS, TransmissionErrorTable, amplitude_key, phase_key
from plant_emulator.robots.behaviour import Behaviour
from plant_emulator.robots.motor_encoder import MotorEncoder
from plant_emulator.robots.robot import BusFacts, Robot, RobotAccelerometer, RobotAxis

Kind = Literal["linear", "real", "any"]
"""Gear and drive: linear gear and no lag; hysteresis up to 2 N·m, softness and lag; hysteresis up to 5 N·m."""

Range = tuple[float, float]

AXIS_NUMBERS = (2, 3, 5)
DRAWN_DIGITS = 5
"""Significant digits of a drawn value: files stay readable."""
SOFT_GEAR_NM_RAD = 50e3
"""Gears softer than this get proportionally less hysteresis: a torque that a small gear never carries would lock it."""
CONTROL_PERIOD_S = 250e-6
RANGE_M_S2 = 32.0
"""Range of the accelerometer: the most that its node can state in mm/s², a strong error at 30 Hz reaches it nearly."""


@dataclass(frozen=True)
class Ranges:
    """Ranges of the drawn quantities.

    Factors are drawn uniformly in their logarithm.

    Attributes:
        reduction_ratio: N, in whole steps.
        antiresonance_hz: f_a of the arm on its gear; logarithmic.
        inertia_ratio: J_l/(N² J_m); logarithmic.
        motor_inertia_kg_m2: J_m; logarithmic.
        arm_inertia_kg_m2: Limits of J_l, to which J_m yields.
        damping: Damping ratio ζ of the arm on its gear.
        a1_arcsec: Amplitude of order 1.
        a2_arcsec: Amplitude of order 2.
        a4_arcsec: Amplitude of order 4.
        friction: Factor of the Coulomb friction 400/s² · J_m; logarithmic.
        stribeck: Static friction over Coulomb friction.
        stribeck_velocity_rad_s: ω_s.
        gravity: Gravity's moment in units of that of the arm's mass at half the lever.
        encoder_bits: Counts per motor revolution as a power of 2, whole.
        encoder_error_1_arcsec: Error of the motor's encoder once a revolution; any phase.
        encoder_error_2_arcsec: The same, twice a revolution.
        encoder_noise_counts: Standard deviation of its noise.
        current_lag_s: Time constant of the current loop.
        hysteresis_nm: Dahl torque on the gear, of gears from `SOFT_GEAR_NM_RAD` on.
        softness: Soft wind-up.
        noise: Factor of the sensor's noise of 0.02 m/s²; logarithmic.
        sensor_delay_s: Delay of the accelerometer.
        mounting_hz: Resonance of the accelerometer's mounting; logarithmic.
        tip_lever_m: Lever of the tip.
        sync_period_s: SYNC periods; one that the bus does not carry gives way to the next.
        bitrates: Bit rates.
    """

    reduction_ratio: Range = (50.0, 160.0)
    antiresonance_hz: Range = (4.0, 30.0)
    inertia_ratio: Range = (0.5, 5.0)
    motor_inertia_kg_m2: Range = (0.3e-4, 4e-4)
    arm_inertia_kg_m2: Range = (0.3, 30.0)
    damping: Range = (0.02, 0.05)
    a1_arcsec: Range = (0.0, 60.0)
    a2_arcsec: Range = (3.0, 60.0)
    a4_arcsec: Range = (0.0, 20.0)
    friction: Range = (0.3, 3.0)
    stribeck: Range = (1.0, 1.5)
    stribeck_velocity_rad_s: Range = (0.5, 2.0)
    gravity: Range = (0.0, 1.2)
    encoder_bits: Range = (13, 20)
    encoder_error_1_arcsec: Range = (0.0, 30.0)
    encoder_error_2_arcsec: Range = (0.0, 15.0)
    encoder_noise_counts: Range = (0.0, 0.5)
    current_lag_s: Range = (0.0, 0.5e-3)
    hysteresis_nm: Range = (0.0, 5.0)
    softness: Range = (0.0, 0.3)
    noise: Range = (0.2, 5.0)
    sensor_delay_s: Range = (0.0, 10e-3)
    mounting_hz: Range = (200.0, 800.0)
    tip_lever_m: Range = (0.25, 0.9)
    sync_period_s: tuple[float, ...] = (0.001, 0.002, 0.004, 0.008)
    bitrates: tuple[int, ...] = (500_000, 1_000_000)


RANGES = Ranges()
REAL_HYSTERESIS_NM = 2.0
"""Largest Dahl torque of the kind `real`."""


class Draws:
    """Named draws of one robot."""

    def __init__(self, seed: int, prefix: str = "") -> None:
        self._seed, self._prefix = seed, prefix

    def even(self, name: str, limits: Range) -> float:
        """Return a number between two limits, all equally probable."""
        return rounded(float(self._generator(name).uniform(*limits)))

    def logarithmic(self, name: str, limits: Range) -> float:
        """Return a number between two limits, all ratios equally probable."""
        low, high = (math.log(limit) for limit in limits)
        return rounded(math.exp(self._generator(name).uniform(low, high)))

    def whole(self, name: str, limits: Range) -> int:
        """Return a whole number between two limits, both included."""
        return int(self._generator(name).integers(round(limits[0]), round(limits[1]), endpoint=True))

    def one_of(self, name: str, choices: tuple[float, ...]) -> float:
        """Return one of some values."""
        return choices[int(self._generator(name).integers(len(choices)))]

    def chance(self, name: str, probability: float = 0.5) -> bool:
        """Return True with a probability."""
        return bool(self._generator(name).random() < probability)

    def _generator(self, name: str) -> np.random.Generator:
        return np.random.default_rng((self._seed, crc32(f"{self._prefix}{name}".encode())))


def rounded(value: float) -> float:
    """Round a value to as many digits as a file has."""
    return float(f"{value:.{DRAWN_DIGITS}g}")


def draw(seed: int, ranges: Ranges = RANGES, *, kind: Kind = "any", axes: int = 1) -> Robot:
    """Draw a robot of the fleet; equal arguments give equal robots.

    Args:
        seed: Seed of all draws, and of the robot's own noise.
        ranges: Ranges of the quantities.
        kind: Linear or real gear and drive; robots of equal seeds differ in nothing else.
        axes: Number of axes, 1 to 3.

    Raises:
        ValueError: The robot cannot have so many axes, or the seed is negative.
    """
    if not 1 <= axes <= len(AXIS_NUMBERS):
        raise ValueError(f"{axes} axes: a robot of the fleet has 1 to {len(AXIS_NUMBERS)}")
    if seed < 0:
        raise ValueError(f"seed {seed} is negative")
    bus = Draws(seed)
    bitrate = int(bus.one_of("bitrate", tuple(map(float, ranges.bitrates))))
    drawn_s, least_s = bus.one_of("sync_period_s", ranges.sync_period_s), least_sync_period_s(axes, bitrate)
    sync_period_s = min((each for each in ranges.sync_period_s if each >= max(drawn_s, least_s)), default=drawn_s)
    is_late = bus.chance("late answers", 0.25)
    late_us = round(1e6 * sync_period_s * bus.even("lateness", (0.1, 0.9))) if is_late else 0
    numbers = AXIS_NUMBERS[:axes]
    return Robot(
        name=f"fleet-{kind}-{seed}",
        seed=seed,
        control_period_s=CONTROL_PERIOD_S,
        sync_period_s=sync_period_s,
        bus=BusFacts(bitrate=bitrate),
        axis={number: _axis(Draws(seed, f"axis {number} "), ranges, kind, number, late_us) for number in numbers},
        accelerometer=accelerometer(bus, ranges),
    )


def least_sync_period_s(axes: int, bitrate: int) -> float:
    """Return a SYNC period that a bus carries with some margin.

    Integrators choose no shorter one.

    `hil plan` has 0.88 ms in a cycle of one drive at 500 kbit/s, and finds that three fit at 1 Mbit/s every 2 ms.
    """
    return (0.5e-3 + 0.75e-3 * axes) * 500_000 / bitrate


def accelerometer(draws: Draws, ranges: Ranges) -> RobotAccelerometer:
    """Return the sensor with noise, delay and mounting."""
    has_lowpass, is_loose = draws.chance("sensor low-pass"), draws.chance("mounting resonance")
    return RobotAccelerometer(
        node_id=16,
        range_m_s2=RANGE_M_S2,
        noise_m_s2=rounded(0.02 * draws.logarithmic("noise", ranges.noise)),
        delay_s=draws.even("sensor_delay_s", ranges.sensor_delay_s),
        lowpass_hz=draws.logarithmic("lowpass_hz", (100.0, 400.0)) if has_lowpass else None,
        mounting_resonance_hz=draws.logarithmic("mounting_hz", ranges.mounting_hz) if is_loose else None,
        mounting_damping=draws.even("mounting_damping", (0.02, 0.1)) if is_loose else 0.05,
    )


def _axis(draws: Draws, ranges: Ranges, kind: Kind, number: int, late_us: int) -> RobotAxis:
    """Draw one axis: inertias first, all else in proportion."""
    ratio = float(draws.whole("reduction_ratio", ranges.reduction_ratio))
    antiresonance_hz = draws.logarithmic("antiresonance_hz", ranges.antiresonance_hz)
    arms = draws.logarithmic("inertia_ratio", ranges.inertia_ratio) * ratio**2
    low, high = (limit / arms for limit in ranges.arm_inertia_kg_m2)
    motor = rounded(min(high, max(low, draws.logarithmic("motor_inertia", ranges.motor_inertia_kg_m2))))
    arm = rounded(motor * arms)
    omega = 2.0 * math.pi * antiresonance_hz
    stiffness = rounded(arm * omega**2)
    arm_damping = rounded(draws.even("arm_damping", (0.01, 0.018)) * arm * omega)
    damping = max(0.1 * arm_damping, 2.0 * draws.even("damping", ranges.damping) * arm * omega - arm_damping)
    lever = draws.even("tip_lever_m", ranges.tip_lever_m)
    coulomb = rounded(400.0 * motor * draws.logarithmic("friction", ranges.friction))
    static = rounded(coulomb * draws.even("stribeck", ranges.stribeck))
    gravity = rounded(draws.even("gravity", ranges.gravity) * arm * 9.81 / (2.0 * lever))
    is_linear = kind == "linear"
    hysteresis_nm = REAL_HYSTERESIS_NM if kind == "real" else ranges.hysteresis_nm[1]
    hysteresis = draws.even("hysteresis", (ranges.hysteresis_nm[0], hysteresis_nm)) * min(1.0, stiffness / SOFT_GEAR_NM_RAD)
    lag_s = draws.even("current_lag_s", ranges.current_lag_s)
    step_s = CONTROL_PERIOD_S / 4.0  # the solver's, of which a lag must be at least half
    return RobotAxis(
        node_id=number,
        reduction_ratio=ratio,
        motor_inertia_kg_m2=motor,
        motor_damping_nm_s_rad=rounded(motor * draws.even("motor_damping", (2.5, 4.5))),
        arm_inertia_kg_m2=arm,
        arm_damping_nm_s_rad=arm_damping,
        gear_stiffness_nm_rad=stiffness,
        gear_damping_nm_s_rad=rounded(damping),
        coulomb_friction_nm=coulomb,
        static_friction_nm=static,
        stribeck_velocity_rad_s=draws.even("stribeck_velocity", ranges.stribeck_velocity_rad_s),
        gravity_moment_nm=gravity,
        home_deg=draws.even("home_deg", (-180.0, 180.0)),
        torque_limit_nm=rounded(9000.0 * (motor + arm / ratio**2) + 1.5 * gravity / ratio + 3.0 * static),
        encoder_counts_per_rev=2 ** draws.whole("encoder_bits", ranges.encoder_bits),
        encoder=motor_encoder(draws, ranges),
        tip_lever_m=lever,
        ate=transmission_error(draws, ranges),
        gear_reaction=draws.chance("gear_reaction"),
        wind_up_softness=0.0 if is_linear else draws.even("softness", ranges.softness),
        wind_up_torsion_arcsec=draws.even("wind_up_torsion", (30.0, 90.0)),
        hysteresis_torque_nm=0.0 if is_linear else rounded(hysteresis),
        hysteresis_torsion_arcsec=20.0,
        current_time_constant_s=0.0 if is_linear or lag_s < 0.5 * step_s else lag_s,
        behaviour=Behaviour(tpdo_delay_us=late_us),
    )


def motor_encoder(draws: Draws, ranges: Ranges) -> MotorEncoder:
    """Draw the errors of an encoder, which a data sheet bounds and whose phases are anything."""
    return MotorEncoder(
        error_1_arcsec=draws.even("encoder_error_1", ranges.encoder_error_1_arcsec),
        phase_1_deg=draws.even("encoder_phase_1", (0.0, 360.0)),
        error_2_arcsec=draws.even("encoder_error_2", ranges.encoder_error_2_arcsec),
        phase_2_deg=draws.even("encoder_phase_2", (0.0, 360.0)),
        noise_counts=draws.even("encoder_noise", ranges.encoder_noise_counts),
    )


def transmission_error(draws: Draws, ranges: Ranges) -> TransmissionErrorTable:
    """Draw an ATE with any phases."""
    phases: dict[float, float] = {order: draws.even(phase_key(order), (0.0, 360.0)) for order in ORDERS}
    amplitudes: dict[float, float] = {order: draws.even(f"a{order}", getattr(ranges, amplitude_key(order))) for order in ORDERS}
    return TransmissionErrorTable.of(amplitudes, phases)


def antiresonance_hz(axis: RobotAxis) -> float:
    """Return the antiresonance f_a of an axis.

    f_a = √(K_g/J_l)/2π, with the gear at its nominal stiffness.
    """
    return math.sqrt(axis.gear_stiffness_nm_rad / axis.arm_inertia_kg_m2) / (2.0 * math.pi)


def small_motion_antiresonance_hz(axis: RobotAxis) -> float:
    """Return f_a for the smallest motions.

    There wind-up softens the gear, and hysteresis stiffens it.
    """
    stiffness = axis.gear_stiffness_nm_rad * (1.0 - axis.wind_up_softness)
    stiffness += axis.hysteresis_torque_nm / (axis.hysteresis_torsion_arcsec * ARCSEC)
    return math.sqrt(stiffness / axis.arm_inertia_kg_m2) / (2.0 * math.pi)
