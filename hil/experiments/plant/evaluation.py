"""Evaluation of a plant identification."""

from dataclasses import dataclass, replace

import numpy as np

from drive_profiles.standard.shown import measured
from hil.bench.model import Correlation, IdentifiedMode, IdentifiedPlant
from hil.control.angles import ARCSEC
from hil.design.estimation import EstimatedMode, EstimatedParameter
from hil.design.friction import Friction
from hil.design.plant_identification import PlantEstimate
from hil.experiments.plant.motion import ExcitedSignal, PlantRequest, Travel
from hil.results.plant import PlantCheck
from hil.robot_tables import PlantTable

WIDE_DEG = 30.0
"""Bound: arm angle over which gravity's cosine is told from a constant: at its top it falls by 1 − cos 15° = 3 %."""
TIP_DELAY = "accelerometer_delay_s"
"""The one parameter that is there with an accelerometer only."""


@dataclass(frozen=True)
class PlantEvaluation:
    """Evaluation of a plant identification that passed its checks.

    Attributes:
        excited: Signal to which the excitation was added.
        friction: Friction and gravity from the slow run.
        checks: Checks of the data; all of them hold.
    """

    request: PlantRequest
    excited: ExcitedSignal
    travel: Travel
    amplitude_nm: float
    estimate: PlantEstimate
    friction: Friction
    checks: tuple[PlantCheck, ...]
    remarks: tuple[str, ...]
    cannot_tell: tuple[str, ...]

    def identified(self, note: str) -> IdentifiedPlant:
        """Plant as an entry of the model file."""
        plant, parameters = self.estimate.plant, self.estimate.parameters
        motor, arm = max(0.0, plant.motor_damping_nm_s_rad), max(0.0, plant.arm_damping_nm_s_rad)
        values = PlantTable(
            motor_inertia_kg_m2=plant.motor_inertia_kg_m2,
            motor_damping_nm_s_rad=motor,
            arm_inertia_kg_m2=plant.arm_inertia_kg_m2,
            arm_damping_nm_s_rad=arm,
            gear_stiffness_nm_rad=plant.gear_stiffness_nm_rad,
            gear_damping_nm_s_rad=max(0.0, plant.gear_damping_nm_s_rad),
        )
        names = [*PlantTable.model_fields, "antiresonance_hz", "resonance_hz", "damping", "torque_lag_s", TIP_DELAY]
        errors = {name: parameters[name].standard_error for name in names if name in parameters}
        errors["coulomb_friction_nm"] = self.friction.coulomb_nm.standard_error
        errors["gravity_moment_nm"] = self.friction.gravity_moment_nm.standard_error
        # what widens the errors beyond the fit's is independent
        fitted = self.estimate.values.part([name for name in errors if name in self.estimate.values.names])
        square = fitted.covariance.copy()
        np.fill_diagonal(square, [errors[name] ** 2 for name in fitted.names])
        return IdentifiedPlant(
            values=values,
            correlation=Correlation.of(replace(fitted, covariance=square)),
            standard_error=errors,
            antiresonance_hz=plant.antiresonance_hz,
            resonance_hz=plant.resonance_hz,
            damping=parameters["damping"].value,
            torsion_arcsec=self.estimate.torsion_rad / ARCSEC,
            cannot_tell=self.cannot_tell,
            coulomb_friction_nm=max(0.0, self.friction.coulomb_nm.value),
            gravity_moment_nm=self.friction.gravity_moment_nm.value,
            torque_lag_s=parameters["torque_lag_s"].value,
            accelerometer_delay_s=parameters[TIP_DELAY].value if TIP_DELAY in parameters else None,
            note=note,
            modes=tuple(_entry(mode) for mode in self.estimate.modes),
        )


def _entry(mode: EstimatedMode) -> IdentifiedMode:
    found = {name: value for name, value in vars(mode).items() if value is not None}
    errors = {name: value.standard_error for name, value in found.items()}
    return IdentifiedMode(**{name: value.value for name, value in found.items()}, standard_error=errors)


def cannot_tell(estimate: PlantEstimate, friction: Friction, viscous: EstimatedParameter) -> tuple[str, ...]:
    """Sentences on the limits of the data, with numbers.

    `viscous` is D_m + D_l/N² of the frequency response alone.
    """
    parameters, plant = estimate.parameters, estimate.plant
    sentences = [
        "all inertias, stiffnesses and dampings are proportional to the torque that the drive reports; an error of its rated "
        "torque (6076h) is an error of each; f_a, f_r and ζ do not depend on it",
        f"D_m cannot be separated from friction that grows with the speed; D_m + D_l/N² together are "
        f"{_shown(viscous)} N·m·s/rad in the frequency response, and the slow turns show "
        f"{_shown(friction.viscous_nm_s_rad)}, where hysteresis of the gear adds nothing: D_m is from both, by their errors",
        f"D_l is {_shown(parameters['arm_damping_nm_s_rad'])} N·m·s/rad, and follows only from the difference in damping "
        f"between f_a and f_r; D_g + D_l is well known, from ζ",
        f"hysteresis of the gear looks like damping and stiffness: f_a, K_g and ζ hold for a torsion of "
        f"{estimate.torsion_rad / ARCSEC:.0f} arcsec, the amplitude of this run; for a notch, prefer the ζ of "
        "hil identify ate",
        "a stiffness that depends on the load appears as one number, for the torque of this run",
    ]
    if plant.arm_damping_nm_s_rad < 0.0 or plant.motor_damping_nm_s_rad < 0.0:
        sentences.append("D_m or D_l came out below 0 within its error; the model file has 0")
    if friction.arm_span_deg < WIDE_DEG:
        sentences.append(
            f"m g l and its phase are extrapolated: the arm turned through {friction.arm_span_deg:.0f}°, and {WIDE_DEG:.0f}° are "
            "needed to see a cosine"
        )
    if estimate.modes:
        sentences.append(
            "J_l and K_g are those of the leading mode alone, which fit its f_a and the tip; one run does not show whether modes "
            "depend on amplitude or load, nor how they move with the posture"
        )
    if estimate.tip is None:
        sentences.append("the tip is not in the fit, so the tip lever is not checked, nor that this axis moved the tip")
    return tuple(sentences)


def _shown(parameter: EstimatedParameter) -> str:
    return measured(parameter.value, parameter.standard_error)
