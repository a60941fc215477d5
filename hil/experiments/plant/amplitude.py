"""Dependence of a gear on the amplitude.

A pilot at a small torsion is compared with the main run.
"""

import math
from dataclasses import replace

from hil.control.angles import ARCSEC
from hil.design.estimation import EstimatedParameter
from hil.design.plant_identification import PlantEstimate

DIFFERENT_SIGMAS = 4.0
"""Standard errors from which two runs differ."""
LEAST = {"antiresonance_hz": 0.003, "damping": 0.15}
"""Least relative difference between two runs that is worth a word."""
PART = {
    "antiresonance_hz": 0.25,
    "resonance_hz": 0.25,
    "gear_stiffness_nm_rad": 0.25,
    "arm_inertia_kg_m2": 0.25,
    "damping": 0.5,
    "gear_damping_nm_s_rad": 0.5,
}
"""Parts of the difference between pilot and main run that go into the standard error: the motion that matters turns the gear by
more than the pilot did, and its stiffness lies nearer to the main run's."""
PRIOR_LOSS = 0.2
"""Prior part of hysteresis in ζ at the torsion of a main run, for a gear that has any: half of all gears do."""
OF_ARM = 0.002
"""Relative error of f_a on such a gear: gravity winds it up to another point of its curve in each stretch of arm angle."""
OF_LOSS = {
    "antiresonance_hz": 0.5,
    "resonance_hz": 0.7,
    "gear_stiffness_nm_rad": 1.0,
    "arm_inertia_kg_m2": 1.0,
    "motor_inertia_kg_m2": 2.0,
    "lever_ratio": 1.0,
}
"""Relative errors over the part of ζ that is hysteresis': with a loss goes a stiffness of up to as much, which depends on the
frequency and on how many of them there are. f_a moves by no more than ζ; between f_a and f_r the inertias yield, J_m most. On the
real gears of 10242 to 10341 the rms of z of f_r is 0.8 with 1."""


def with_amplitude_dependence(main: PlantEstimate, pilot: PlantEstimate) -> tuple[PlantEstimate, str | None]:
    """Widen an estimate's errors to hold between two amplitudes.

    Returns a sentence too if the gear depends on the amplitude.

    A linear gear gives one plant at any amplitude. Hysteresis makes it stiffer and lossier at small torsions, softness around
    zero torque makes it softer there; the value that another motion will meet lies beside that of the main run by about as much
    as the two runs differ.
    """
    parameters = {name: _with_error(value, error * value.value) for name, value, error in _disagreements(main, pilot)}
    for name, part in PART.items():
        value, other = main.parameters[name], pilot.parameters[name]
        apart = max(0.0, (value.value - other.value) ** 2 - other.standard_error**2 - value.standard_error**2)
        parameters[name] = _with_error(parameters[name], part * math.sqrt(apart))
    lossy = loss_error(main, pilot)
    for name, size in OF_LOSS.items():
        if name in parameters:
            parameters[name] = _with_error(parameters[name], size * lossy * parameters[name].value)
    damping = parameters["damping"]
    for name in ("damping", "gear_damping_nm_s_rad"):
        parameters[name] = _at_least(parameters[name], lossy / damping.value * abs(parameters[name].value))
    if not any(_differs(main, pilot, name) for name in LEAST):
        return replace(main, parameters=parameters), None
    f_a = parameters["antiresonance_hz"]
    parameters["antiresonance_hz"] = _with_error(f_a, OF_ARM * f_a.value)
    return replace(main, parameters=parameters), _words(main, pilot)


def loss_error(main: PlantEstimate, pilot: PlantEstimate) -> float:
    """Rms part of ζ that is hysteresis, as two runs show it.

    It applies to the torsion of the main run.

    The loss of hysteresis is in inverse proportion to the torsion, so that x = (ζ' − ζ)/(ρ − 1) with the main run's torsion over
    the pilot's, ρ. What an inexact pilot, or one at nearly the same torsion, cannot exclude keeps its prior probability.
    """
    one, other = main.parameters["damping"], pilot.parameters["damping"]
    lever = main.torsion_rad / max(pilot.torsion_rad, 1e-30) - 1.0
    lever = math.copysign(max(abs(lever), 1e-3), lever)
    loss = (other.value - one.value) / lever
    noise = (one.standard_error**2 + other.standard_error**2) / lever**2
    prior = (PRIOR_LOSS * one.value) ** 2
    weight = prior / max(prior + noise, 1e-300)
    odds = math.sqrt(1.0 - weight) * math.exp(min(300.0, 0.5 * loss**2 * weight / max(noise, 1e-300)))
    return math.sqrt(odds / (1.0 + odds) * weight * (weight * loss**2 + noise))


def _disagreements(main: PlantEstimate, pilot: PlantEstimate) -> list[tuple[str, EstimatedParameter, float]]:
    """Main run's parameters with the relative errors of disagreement.

    Only the inertias count, which no torsion changes.

    There the model is wrong, not the gear another. K_g follows J_l at a given f_a, and f_r follows both inertias.
    """
    motor, arm = (_disagreement(main, pilot, name) for name in ("motor_inertia_kg_m2", "arm_inertia_kg_m2"))
    plant = main.plant
    ratio = plant.arm_inertia_kg_m2 / (plant.reduction_ratio**2 * plant.motor_inertia_kg_m2)
    errors = {
        "motor_inertia_kg_m2": motor,
        "arm_inertia_kg_m2": arm,
        "gear_stiffness_nm_rad": arm,
        "resonance_hz": 0.5 * ratio / (1.0 + ratio) * math.hypot(motor, arm),
    }
    return [(name, value, errors.get(name, 0.0)) for name, value in main.parameters.items()]


def _disagreement(main: PlantEstimate, pilot: PlantEstimate, name: str) -> float:
    """Relative error of a value that two runs should share.

    It is what enlarges both runs' errors alike, beyond the value's own error.

    Source: Particle Data Group, Review of Particle Physics, section "Unconstrained averaging": the scale factor S.
    """
    one, other = main.parameters[name], pilot.parameters[name]
    scale = abs(one.value - other.value) / max(math.hypot(one.standard_error, other.standard_error), 1e-300)
    return one.relative * math.sqrt(max(0.0, scale**2 - 1.0))


def _at_least(parameter: EstimatedParameter, least: float) -> EstimatedParameter:
    return EstimatedParameter(parameter.value, max(parameter.standard_error, least))


def _with_error(parameter: EstimatedParameter, more: float) -> EstimatedParameter:
    return EstimatedParameter(parameter.value, math.hypot(parameter.standard_error, more))


def _differs(main: PlantEstimate, pilot: PlantEstimate, name: str) -> bool:
    one, other = main.parameters[name], pilot.parameters[name]
    apart = abs(one.value - other.value)
    error = (one.standard_error**2 + other.standard_error**2) ** 0.5
    return apart > DIFFERENT_SIGMAS * error and apart > LEAST[name] * abs(one.value)


def _words(main: PlantEstimate, pilot: PlantEstimate) -> str:
    parts = []
    for estimate in (pilot, main):
        f_a, zeta = estimate.parameters["antiresonance_hz"], estimate.parameters["damping"]
        parts.append(
            f"f_a {f_a.value:.4g} Hz, K_g {1e-3 * estimate.plant.gear_stiffness_nm_rad:.3g} kN·m/rad and ζ {zeta.value:.2g} at a "
            f"torsion of {estimate.torsion_rad / ARCSEC:.0f} arcsec"
        )
    return f"the gear depends on the amplitude (hysteresis, or a soft wind-up): {parts[0]}; {parts[1]}"
