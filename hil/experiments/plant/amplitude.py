"""Dependence of a gear on the amplitude.

A pilot at a small torsion is compared with the main run.
"""

import math
from dataclasses import replace

import numpy as np

from hil.control.angles import ARCSEC
from hil.design.estimation import SURE_SIGMAS, EstimatedParameter
from hil.design.plant_identification import PlantEstimate

VISCOUS, D_M = "viscous_damping_nm_s_rad", "motor_damping_nm_s_rad"
"""Names of D_m + D_l/N² and of D_m."""
LEAST = {"antiresonance_hz": 0.003, "damping": 0.15}
"""Least relative difference between two runs that is worth a word."""
PRIOR_LOSS = 0.2
"""Measured: prior part of hysteresis in ζ of a gear that has any: 0.26 (rms), 0.17 (median) on the real robots 10730 to 10764."""
OPEN = {
    "damping": 0.5,
    "antiresonance_hz": 0.3,
    "resonance_hz": 0.5,
    "gear_stiffness_nm_rad": 0.5,
    "arm_inertia_kg_m2": 0.5,
    "motor_inertia_kg_m2": 2.3,
    "lever_ratio": 0.5,
    "arm_damping_nm_s_rad": 0.4,
}
"""Errors over the part of ζ that is hysteresis': of ζ itself and of D_l's part of it, and relative ones of the others.

A friction's torque is not linear, and the sine at which it is the same differs with the frequency. On the real gears of the drawn
robots 10630 to 10674 an rms of z of 1 needs 0.46 for ζ, 0.39 for f_a, 0.54 to 0.59 for J_l, K_g and f_r, and 2.3 for J_m; with
`spring_error` beside it, 0.3 for f_a on those of 10600 to 10619 and 50880 to 51004. For D_l the rms is 1.19 with 0.3, 0.88 with
0.5 and 3.1 without on those of 51105 to 51204.
"""
PRIOR_SLOPE = 0.03
"""Measured: prior standard deviation of d ln K_g/d ln a of such a gear: 0.034 (rms) on the real robots 10730 to 10764."""


def with_amplitude_dependence(main: PlantEstimate, pilot: PlantEstimate) -> tuple[PlantEstimate, str | None]:
    """Widen an estimate's errors by what the gear's hysteresis leaves open.

    Returns a sentence too if the gear depends on the amplitude.

    A linear gear gives one plant at any amplitude. Hysteresis makes it stiffer and lossier at small torsions, softness around
    zero torque makes it softer there; the estimate holds at the torsion of the main run.
    """
    parameters = {name: _with_error(value, error * value.value) for name, value, error in _disagreements(main, pilot)}
    lossy, soft = loss_error(main, pilot), spring_error(main, pilot)
    of_spring = {
        "gear_stiffness_nm_rad": soft,
        "arm_inertia_kg_m2": soft,
        "antiresonance_hz": 0.5 * soft,
        "resonance_hz": 0.5 * soft,
    }
    sizes = {name: math.hypot(size * lossy, of_spring.get(name, 0.0)) for name, size in OPEN.items() if name in parameters}
    sizes["damping"] /= parameters["damping"].value
    of_arm = sizes.pop("arm_damping_nm_s_rad") * 2.0 * math.sqrt(main.plant.gear_stiffness_nm_rad * main.plant.arm_inertia_kg_m2)
    for name, per in (("arm_damping_nm_s_rad", 1.0), (D_M, 1.0 / main.plant.reduction_ratio**2)):
        parameters[name] = _with_error(parameters[name], of_arm * per)  # D_m is what D_l leaves of both
    for name, size in (sizes | {"gear_damping_nm_s_rad": sizes["damping"]}).items():
        parameters[name] = _with_error(parameters[name], size * parameters[name].value)
    if "torque_lag_s" in parameters:  # lag and motor inertia stand for each other
        motor = parameters["motor_inertia_kg_m2"]
        error = main.values.with_marginal("motor_inertia_kg_m2", motor.value, motor.standard_error).standard_error("torque_lag_s")
        parameters["torque_lag_s"] = EstimatedParameter(parameters["torque_lag_s"].value, error)
    if not any(_differs(main, pilot, name) for name in LEAST):
        return replace(main, parameters=parameters), None
    return replace(main, parameters=parameters), _words(main, pilot)


def with_slow_turns(estimate: PlantEstimate, viscous: EstimatedParameter) -> PlantEstimate:
    """Combine D_m of the frequency response with the viscous friction of slow turns, D_m + D_l/N².

    Hysteresis of the gear looks like a damping of the motor in the response, not while the motor turns one way. Each counts by
    its error; J_m and the others stay, since what hysteresis adds to D_m does not tell of them. On 60 drawn robots (51105 to
    51164) the rms error of D_m over J_m ω_a falls from 2.0 to 1.1 %, that of real gears from 2.7 to 1.35 %.
    """
    names, errors = estimate.values.names, estimate.parameters
    square = estimate.values.covariance.copy()
    np.fill_diagonal(square, [errors[name].standard_error ** 2 for name in names])
    row = np.array([[float(name == VISCOUS) for name in names]])
    seen = np.array([viscous.value]), np.array([viscous.standard_error**2])
    values = replace(estimate.values, covariance=square).observed(row, *seen, only=(VISCOUS, D_M))
    found = {name: EstimatedParameter(values.value(name), values.standard_error(name)) for name in (VISCOUS, D_M)}
    plant = replace(estimate.plant, motor_damping_nm_s_rad=found[D_M].value)
    return replace(estimate, plant=plant, values=values, parameters={**errors, **found})


def loss_error(main: PlantEstimate, pilot: PlantEstimate) -> float:
    """Rms part of ζ that is hysteresis, as two runs show it.

    The loss of hysteresis is in inverse proportion to the torsion, so that x = (ζ' − ζ)/(ρ − 1) with the main run's torsion over
    the pilot's, ρ. What an inexact pilot, or one at nearly the same torsion, cannot exclude keeps its prior probability.
    """
    one, other = main.parameters["damping"], pilot.parameters["damping"]
    lever = _apart(main.torsion_rad / max(pilot.torsion_rad, 1e-30) - 1.0)
    noise = (one.standard_error**2 + other.standard_error**2) / lever**2
    return _rms_if_any((other.value - one.value) / lever, noise, (PRIOR_LOSS * one.value) ** 2)


def spring_error(main: PlantEstimate, pilot: PlantEstimate) -> float:
    """Rms error of ln K_g where the gear is a spring that is stiffer, or softer, at large torsions.

    The stated torsion is that of the sine that meets the same friction; a spring is as stiff as to a sine of another amplitude.
    """
    return abs(math.log(main.spring_torsion_rad / main.torsion_rad)) * slope_error(main, pilot)


def slope_error(main: PlantEstimate, pilot: PlantEstimate) -> float:
    """Rms slope d ln K_g/d ln a of the stiffness over the torsion a, as f_a of two runs shows it."""
    one, other = main.parameters["antiresonance_hz"], pilot.parameters["antiresonance_hz"]
    lever = _apart(math.log(main.torsion_rad / max(pilot.torsion_rad, 1e-30)))
    noise = 4.0 * (one.relative**2 + other.relative**2) / lever**2
    return _rms_if_any(2.0 * math.log(one.value / other.value) / lever, noise, PRIOR_SLOPE**2)


def _apart(difference: float) -> float:
    """Difference of two torsions that is never 0."""
    return math.copysign(max(abs(difference), 1e-3), difference)


def _rms_if_any(value: float, noise: float, prior: float) -> float:
    """Posterior rms of what half of all gears have, with a prior variance, from a value and its variance."""
    weight = prior / max(prior + noise, 1e-300)
    odds = math.sqrt(1.0 - weight) * math.exp(min(300.0, 0.5 * value**2 * weight / max(noise, 1e-300)))
    return math.sqrt(odds / (1.0 + odds) * weight * (weight * value**2 + noise))


def _disagreements(main: PlantEstimate, pilot: PlantEstimate) -> list[tuple[str, EstimatedParameter, float]]:
    """Main run's parameters with the relative errors of disagreement.

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


def _with_error(parameter: EstimatedParameter, more: float) -> EstimatedParameter:
    return EstimatedParameter(parameter.value, math.hypot(parameter.standard_error, more))


def _differs(main: PlantEstimate, pilot: PlantEstimate, name: str) -> bool:
    one, other = main.parameters[name], pilot.parameters[name]
    apart = abs(one.value - other.value)
    error = (one.standard_error**2 + other.standard_error**2) ** 0.5
    return apart > SURE_SIGMAS * error and apart > LEAST[name] * abs(one.value)


def _words(main: PlantEstimate, pilot: PlantEstimate) -> str:
    parts = []
    for estimate in (pilot, main):
        f_a, zeta = estimate.parameters["antiresonance_hz"], estimate.parameters["damping"]
        parts.append(
            f"f_a {f_a.value:.4g} Hz, K_g {1e-3 * estimate.plant.gear_stiffness_nm_rad:.3g} kN·m/rad and ζ {zeta.value:.2g} at a "
            f"torsion of {estimate.torsion_rad / ARCSEC:.0f} arcsec"
        )
    return f"the gear depends on the amplitude (hysteresis, or a soft wind-up): {parts[0]}; {parts[1]}"
