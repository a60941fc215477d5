"""Unknowns of a plant, their spread, and plants drawn from them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drive_profiles.files.toml import Table
from hil.control.angles import ARCSEC
from hil.robot_tables import NotNegative
from plant_emulator.robots.encoders import MotorEncoder
from plant_emulator.robots.robot import RobotAccelerometer, RobotAxis
from plant_emulator.trials.distributions import Chance, Distribution, Even, Logarithmic

UnknownKind = Literal["factor", "up_to", "either", "circle", "switch"]


class PlantSpread(Table):
    """Spread of each unknown around its value in the robot file.

    0 keeps the unknown constant.

    `…_percent` of a quantity is a factor, log-uniform from 1/(1 + p/100) to 1 + p/100, so that it is as likely to be too
    small as too large, and never below 0. Effects that the file need not have are uniform from 0 to the value, and are added
    to the file's. Angles, and values described so, are uniform up to the value in both directions. The defaults are the
    uncertainties of data sheets; they are not measured.

    Attributes:
        gear_stiffness_percent: K_g; with the next one it moves the resonance.
        arm_inertia_percent: J_l.
        motor_inertia_percent: J_m.
        gear_damping_percent: D_g.
        arm_damping_percent: D_l.
        motor_damping_percent: D_m.
        gravity_percent: Moment of the arm's weight.
        coulomb_friction_percent: τ_C, and τ_S with it.
        stribeck_rise_percent: τ_S − τ_C.
        stribeck_velocity_percent: ω_s.
        hysteresis_arcsec: Width of the gear's hysteresis at no torque, 2 F/K_g.
        wind_up_softness: Fraction of K_g that is missing near no torsion.
        a1_arcsec: Amplitude of the 1st order of the transmission error; its phase is anything.
        a2_percent: Amplitude of the 2nd order.
        a4_percent: Amplitude of the 4th order.
        phases_deg: Errors of the phases of the 2nd and 4th order, up to the value in both directions.
        current_time_constant_ms: Lag of the current loop.
        gear_reaction_share: Fraction of plants whose gear loads the motor through its transmission error, as energy demands.
        encoder_error_1_arcsec: Once per motor revolution, on the motor side; its phase is anything.
        encoder_error_2_arcsec: Twice per revolution.
        encoder_noise_counts: Standard deviation of the noise of each sample.
        accelerometer_sensitivity_percent: Error of the sensitivity, up to the value in both directions.
        accelerometer_cross_axis_percent: Fraction of the radial acceleration in the reading, in both directions.
        accelerometer_noise_percent: Noise of each sample.
        accelerometer_delay_ms: Age of a sample at its SYNC.
    """

    gear_stiffness_percent: NotNegative = 15.0
    arm_inertia_percent: NotNegative = 15.0
    motor_inertia_percent: NotNegative = 5.0
    gear_damping_percent: NotNegative = 50.0
    arm_damping_percent: NotNegative = 50.0
    motor_damping_percent: NotNegative = 50.0
    gravity_percent: NotNegative = 10.0
    coulomb_friction_percent: NotNegative = 50.0
    stribeck_rise_percent: NotNegative = 50.0
    stribeck_velocity_percent: NotNegative = 50.0
    hysteresis_arcsec: NotNegative = 10.0
    wind_up_softness: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.4
    a1_arcsec: NotNegative = 5.0
    a2_percent: NotNegative = 10.0
    a4_percent: NotNegative = 10.0
    phases_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 180.0
    current_time_constant_ms: Annotated[float, Field(ge=0.0, le=20.0)] = 0.2
    gear_reaction_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    encoder_error_1_arcsec: NotNegative = 30.0
    encoder_error_2_arcsec: NotNegative = 15.0
    encoder_noise_counts: NotNegative = 0.5
    accelerometer_sensitivity_percent: Annotated[float, Field(ge=0.0, lt=100.0)] = 3.0
    accelerometer_cross_axis_percent: Annotated[float, Field(ge=0.0, lt=100.0)] = 2.0
    accelerometer_noise_percent: NotNegative = 50.0
    accelerometer_delay_ms: Annotated[float, Field(ge=0.0, le=20.0)] = 2.0


@dataclass(frozen=True)
class Unknown:
    """One number of a plant that is drawn.

    Attributes:
        name: Column of the table of draws; its unit is in the name, a factor has none.
        kind: `factor` (log-uniform about 1), `up_to`, `either` (uniform in both directions), `circle` (any angle, in degrees) or
            `switch` (0 or 1).
    """

    name: str
    key: str
    kind: UnknownKind
    label: str

    def distribution(self, spread: PlantSpread) -> Distribution:
        """Return how it is drawn with this spread."""
        reach: float = getattr(spread, self.key)
        match self.kind:
            case "factor":
                return Logarithmic(1.0 / (1.0 + reach / 100.0), 1.0 + reach / 100.0)
            case "up_to":
                return Even(0.0, reach)
            case "either":
                return Even(-reach, reach)
            case "circle":
                return Even(0.0, 360.0)
            case "switch":
                return Chance(reach)

    def is_open(self, spread: PlantSpread) -> bool:
        """Return True if the unknown differs from plant to plant."""
        reach: float = getattr(spread, self.key)
        return 0.0 < reach < 1.0 if self.kind == "switch" else reach > 0.0


def _factor(stem: str, label: str) -> Unknown:
    return Unknown(f"{stem}_factor", f"{stem}_percent", "factor", label)


AXIS_UNKNOWNS: tuple[Unknown, ...] = (
    _factor("gear_stiffness", "gear stiffness"),
    _factor("arm_inertia", "arm inertia"),
    _factor("motor_inertia", "motor inertia"),
    _factor("gear_damping", "gear damping"),
    _factor("arm_damping", "arm damping"),
    _factor("motor_damping", "motor damping"),
    _factor("gravity", "gravity"),
    _factor("coulomb_friction", "Coulomb friction"),
    _factor("stribeck_rise", "Stribeck friction"),
    _factor("stribeck_velocity", "Stribeck speed"),
    Unknown("hysteresis_arcsec", "hysteresis_arcsec", "up_to", "gear hysteresis"),
    Unknown("wind_up_softness", "wind_up_softness", "up_to", "soft wind-up"),
    Unknown("a1_arcsec", "a1_arcsec", "up_to", "ATE order 1, amplitude"),
    Unknown("phi1_deg", "a1_arcsec", "circle", "ATE order 1, phase"),
    _factor("a2", "ATE order 2, amplitude"),
    Unknown("phi2_deg", "phases_deg", "either", "ATE order 2, phase"),
    _factor("a4", "ATE order 4, amplitude"),
    Unknown("phi4_deg", "phases_deg", "either", "ATE order 4, phase"),
    Unknown("current_time_constant_ms", "current_time_constant_ms", "up_to", "current-loop lag"),
    Unknown("gear_reaction", "gear_reaction_share", "switch", "gear's reaction"),
    Unknown("encoder_error_1_arcsec", "encoder_error_1_arcsec", "up_to", "encoder error, once a turn"),
    Unknown("encoder_phase_1_deg", "encoder_error_1_arcsec", "circle", "encoder error 1, phase"),
    Unknown("encoder_error_2_arcsec", "encoder_error_2_arcsec", "up_to", "encoder error, twice a turn"),
    Unknown("encoder_phase_2_deg", "encoder_error_2_arcsec", "circle", "encoder error 2, phase"),
    Unknown("encoder_noise_counts", "encoder_noise_counts", "up_to", "encoder noise"),
)
"""Drawn for each axis, in this order; a later one is appended, so that equal seeds keep giving equal plants."""

SENSOR_UNKNOWNS: tuple[Unknown, ...] = (
    Unknown("accelerometer_sensitivity_percent", "accelerometer_sensitivity_percent", "either", "accelerometer sensitivity"),
    Unknown("accelerometer_cross_axis_percent", "accelerometer_cross_axis_percent", "either", "accelerometer cross-axis"),
    _factor("accelerometer_noise", "accelerometer noise"),
    Unknown("accelerometer_delay_ms", "accelerometer_delay_ms", "up_to", "accelerometer delay"),
)
"""Drawn once for the tip."""

Values = Mapping[str, float]


def drawn(unknowns: tuple[Unknown, ...], spread: PlantSpread, generator: np.random.Generator) -> dict[str, float]:
    """Draw a value for each unknown, by name."""
    return {unknown.name: float(unknown.distribution(spread).draw(generator)) for unknown in unknowns}


def nominal(unknowns: tuple[Unknown, ...]) -> dict[str, float]:
    """Return the values that leave a plant as in its file."""
    return {unknown.name: 1.0 if unknown.kind == "factor" else 0.0 for unknown in unknowns}


def drawn_axis(axis: RobotAxis, values: Values) -> RobotAxis:
    """Return the axis with drawn values of `AXIS_UNKNOWNS`."""
    stiffness = axis.gear_stiffness_nm_rad * values["gear_stiffness_factor"]
    coulomb = axis.coulomb_friction_nm * values["coulomb_friction_factor"]
    rise = (axis.static_friction_nm - axis.coulomb_friction_nm) * values["coulomb_friction_factor"]
    return axis.model_copy(
        update={
            "gear_stiffness_nm_rad": stiffness,
            "arm_inertia_kg_m2": axis.arm_inertia_kg_m2 * values["arm_inertia_factor"],
            "motor_inertia_kg_m2": axis.motor_inertia_kg_m2 * values["motor_inertia_factor"],
            "gear_damping_nm_s_rad": axis.gear_damping_nm_s_rad * values["gear_damping_factor"],
            "arm_damping_nm_s_rad": axis.arm_damping_nm_s_rad * values["arm_damping_factor"],
            "motor_damping_nm_s_rad": axis.motor_damping_nm_s_rad * values["motor_damping_factor"],
            "gravity_moment_nm": axis.gravity_moment_nm * values["gravity_factor"],
            "coulomb_friction_nm": coulomb,
            "static_friction_nm": coulomb + rise * values["stribeck_rise_factor"],
            "stribeck_velocity_rad_s": axis.stribeck_velocity_rad_s * values["stribeck_velocity_factor"],
            "hysteresis_torque_nm": axis.hysteresis_torque_nm + 0.5 * stiffness * values["hysteresis_arcsec"] * ARCSEC,
            "wind_up_softness": axis.wind_up_softness + values["wind_up_softness"],
            "current_time_constant_s": axis.current_time_constant_s + 1e-3 * values["current_time_constant_ms"],
            "gear_reaction": axis.gear_reaction or values["gear_reaction"] > 0.0,
            "ate": axis.ate.model_copy(update=_drawn_error(axis, values)),
            "encoder": _drawn_encoder(axis.encoder, values),
        }
    )


def _drawn_error(axis: RobotAxis, values: Values) -> dict[str, float]:
    """Return the changed fields of the ATE."""
    ate = axis.ate
    first = _phasor(ate.a1_arcsec, ate.phi1_deg) + _phasor(values["a1_arcsec"], values["phi1_deg"])
    return {
        "a1_arcsec": float(abs(first)),
        "phi1_deg": math.degrees(float(np.angle(first))),
        "a2_arcsec": ate.a2_arcsec * values["a2_factor"],
        "phi2_deg": ate.phi2_deg + values["phi2_deg"],
        "a4_arcsec": ate.a4_arcsec * values["a4_factor"],
        "phi4_deg": ate.phi4_deg + values["phi4_deg"],
    }


def _drawn_encoder(encoder: MotorEncoder, values: Values) -> MotorEncoder:
    """Return the encoder with drawn errors, which are summed with the file's as phasors."""
    changed = {"noise_counts": math.hypot(encoder.noise_counts, values["encoder_noise_counts"])}
    for order in (1, 2):
        names = f"error_{order}_arcsec", f"phase_{order}_deg"
        drawn = f"encoder_error_{order}_arcsec", f"encoder_phase_{order}_deg"
        if not values[drawn[0]]:
            continue
        if not getattr(encoder, names[0]):
            changed |= {name: values[of] for name, of in zip(names, drawn, strict=True)}
            continue
        total = _phasor(*(getattr(encoder, name) for name in names)) + _phasor(*(values[name] for name in drawn))
        changed |= {names[0]: float(abs(total)), names[1]: math.degrees(float(np.angle(total)))}
    return encoder.model_copy(update=changed)


def _phasor(amplitude: float, phase_deg: float) -> complex:
    return complex(amplitude * np.exp(1j * math.radians(phase_deg)))


def drawn_sensor(sensor: RobotAccelerometer, values: Values) -> RobotAccelerometer:
    """Return the accelerometer with drawn values of `SENSOR_UNKNOWNS`."""
    return sensor.model_copy(
        update={
            "sensitivity_percent": sensor.sensitivity_percent + values["accelerometer_sensitivity_percent"],
            "cross_axis_percent": sensor.cross_axis_percent + values["accelerometer_cross_axis_percent"],
            "noise_m_s2": sensor.noise_m_s2 * values["accelerometer_noise_factor"],
            "delay_s": sensor.delay_s + 1e-3 * values["accelerometer_delay_ms"],
        }
    )
