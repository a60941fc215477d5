"""Dependence of a gear on the amplitude: what a pilot at a small torsion found, beside the main run."""

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
OF_MOTOR = 0.04
"""Relative error of J_m on a gear that depends on the amplitude: what hysteresis adds at f_a and f_r differs, and J_m yields."""

OF_ARM = 0.002
"""Relative error of f_a on such a gear: gravity winds it up to another point of its curve in each stretch of arm angle."""
OF_LOSS = 0.1
"""Relative error of f_a over the difference of ζ: hysteresis stiffens as it damps, and a soft wind-up may hide it."""


def with_amplitude_dependence(main: PlantEstimate, pilot: PlantEstimate) -> tuple[PlantEstimate, str | None]:
    """The estimate with errors that hold between the two amplitudes, and a sentence where the gear depends on them.

    A linear gear gives one plant at any amplitude. Hysteresis makes it stiffer and lossier at small torsions, softness around
    zero torque makes it softer there; the value that another motion will meet lies beside that of the main run by about as much
    as the two runs differ.
    """
    parameters = dict(main.parameters)
    for name, part in PART.items():
        value, other = parameters[name], pilot.parameters[name]
        apart = max(0.0, (value.value - other.value) ** 2 - other.standard_error**2 - value.standard_error**2)
        parameters[name] = _with_error(value, part * math.sqrt(apart))
    if not any(_differs(main, pilot, name) for name in LEAST):
        return replace(main, parameters=parameters), None
    loss = abs(parameters["damping"].value - pilot.parameters["damping"].value)
    f_a = parameters["antiresonance_hz"]
    parameters["antiresonance_hz"] = _with_error(f_a, math.hypot(OF_ARM, OF_LOSS * loss) * f_a.value)
    for name, size in (("motor_inertia_kg_m2", OF_MOTOR), ("arm_inertia_kg_m2", 0.5 * OF_MOTOR), ("lever_ratio", OF_MOTOR)):
        if name in parameters:
            parameters[name] = _with_error(parameters[name], size * parameters[name].value)
    return replace(main, parameters=parameters), _words(main, pilot)


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
            f"f_a {f_a.value:.4g} Hz, K_g {estimate.plant.gear_stiffness_nm_rad:.3g} N·m/rad and ζ {zeta.value:.2g} at a torsion "
            f"of {estimate.torsion_rad / ARCSEC:.0f} arcsec"
        )
    return f"the gear depends on the amplitude (hysteresis, or a soft wind-up): {parts[0]}; {parts[1]}"
