"""Checks of an identified plant."""

import math

import numpy as np

from hil.control.arrays import Real
from hil.design.estimation import SURE_SIGMAS
from hil.design.plant_identification import PlantEstimate, ResponseEstimate
from hil.design.plant_problem import LEVER_RATIO, OUTSIDE
from hil.errors import HilError, RefusalCause
from hil.experiments.measurement import MAX_MISSED
from hil.experiments.plant.motion import PlantRequest
from hil.experiments.plant.pilot import told_lever_ratio
from hil.results.plant import PlantCheck

SATURATED_FRACTION = 1e-3
"""Measured: fraction of the rows that may be at the torque limit: 0 on the drawn robots 10700 to 10764."""
REVERSED_FRACTION = 5e-3
"""Measured with `SATURATED_FRACTION`, 0: fraction of the rows in which the motor may turn against its bias."""
AT_RANGE_ROWS = 4
"""Measured with `SATURATED_FRACTION`, at most 2 on 30 robots: rows in which the accelerometer may show its very largest value."""
TIP_COHERENCE = 0.5
"""Measured: median coherence of the tip with the motor that shows that it is this axis' tip: 0.77 at least on the 14 drawn robots
of `LEVER_RATIO`, and 0.10 to 0.28 in the pilots of three, whose tip is left out."""
ANTIRESONANCE_PCT, STIFFNESS_PCT = 1.0, 5.0
"""Measured with `SATURATED_FRACTION`, 0.24 and 1.3 at most: standard errors with which a plant is accepted, %."""


class PlantNotIdentifiedError(HilError):
    """Error: the data do not identify the plant.

    Nothing is written to the model file.
    """

    exit_code = 9

    def __init__(self, axis: int, reasons: tuple[str, ...], causes: tuple[RefusalCause, ...] = ()) -> None:
        """Keep the reasons, one sentence each, and their causes."""
        self.axis, self.reasons, self.causes = axis, reasons, causes
        super().__init__(f"axis {axis} is not identified: {'; '.join(reasons)}")


def torque_check(torque_nm: Real, limit_nm: float, amplitude_nm: float) -> PlantCheck:
    """Check that the torque, shape (n,), stayed below its limit."""
    fraction = float(np.mean(np.abs(torque_nm) >= 0.985 * limit_nm))
    remedy = (
        f"the torque reached {np.max(np.abs(torque_nm)):.3g} of {limit_nm:.3g} N·m; try --amplitude-nm {0.6 * amplitude_nm:.2g}"
    )
    return PlantCheck(
        "fraction of the time at the torque limit", fraction, SATURATED_FRACTION, "", fraction <= SATURATED_FRACTION, remedy,
        ("limits",),
    )  # fmt: skip


def reversal_check(speed_rps: Real, bias_rps: float, amplitude_nm: float) -> PlantCheck:
    """Check that the motor kept its direction.

    At a reversal Coulomb friction is not a constant. `speed_rps` is along the bias.
    """
    fraction = float(np.mean(speed_rps <= 0.0))
    ripple = bias_rps - float(np.min(speed_rps))
    calm = 0.7 * amplitude_nm * bias_rps / max(ripple, 1e-9)
    remedy = f"raise --bias-rps to {1.2 * ripple:.2g} or lower --amplitude-nm to {calm:.2g}"
    return PlantCheck(
        "fraction of the time in which the motor turned back",
        fraction,
        REVERSED_FRACTION,
        "",
        fraction <= REVERSED_FRACTION,
        remedy,
    )


def travel_check(angle_rad: Real, bias_rad: Real, motion: str) -> PlantCheck:
    """Check that the requested axis has moved."""
    fraction = float(np.ptp(angle_rad)) / max(float(np.ptp(bias_rad)), 1e-9)
    remedy = "check that the encoder is the axis' own, and that its brake is open"
    least, most = 0.8, 1.25
    what, bound = f"fraction of the travel that the motor angle shows {motion}", most if fraction > most else least
    return PlantCheck(what, fraction, bound, "", least <= fraction <= most, remedy, ("wrong axis or wiring",))


def sensor_trouble(tip_m_s2: Real, missed: int, rows: int, sensor: str = "accelerometer") -> str | None:
    """Reason why the accelerometer is left out, or None.

    Args:
        tip_m_s2: Acceleration of the tip; shape (n,).
        missed: Number of cycles that lack it.
        rows: Number of all cycles.
    """
    if missed > MAX_MISSED * rows:
        most = math.floor(MAX_MISSED * rows)
        return f"the {sensor} was missing in {missed} of {rows} cycles; at most {most} are allowed"
    largest = float(np.max(np.abs(tip_m_s2)))
    if largest == 0.0 or float(np.ptp(tip_m_s2)) == 0.0:
        return f"the {sensor} shows {float(tip_m_s2[0]):.3g} m/s² only"
    often = int(np.count_nonzero(np.abs(tip_m_s2) >= largest * (1.0 - 1e-9)))
    if often > AT_RANGE_ROWS:
        return (
            f"the {sensor} is at the end of its range, {largest:.3g} m/s², in {often} rows; at most {AT_RANGE_ROWS} are allowed; "
            f"lower --amplitude-nm"
        )
    return None


def _around(response: ResponseEstimate, *frequencies_hz: float) -> Real:
    near = np.zeros(len(response.frequency_hz), dtype=np.bool_)
    for frequency in frequencies_hz:
        near |= np.abs(response.frequency_hz / frequency - 1.0) < 0.2
    return response.coherence[near] if np.any(near) else response.coherence


def tip_trouble(estimate: PlantEstimate, lever_m: float) -> str | None:
    """Reason why the tip's motion is not this axis', or None."""
    if estimate.tip is None:
        return None
    coherence = float(np.median(_around(estimate.tip, estimate.plant.antiresonance_hz)))
    if coherence < TIP_COHERENCE:
        return (
            f"coherence of the tip with the motor: {coherence:.2g} (at least {TIP_COHERENCE:g}); check that this "
            "axis moves the sensor, and that the sensor has the right orientation"
        )
    ratio = told_lever_ratio(estimate)
    if ratio is not None and max(ratio, 1.0 / max(ratio, 1e-9)) > LEVER_RATIO:
        return (
            f"the tip responds as on a lever of {ratio * lever_m:.3g} m; the bench file says {lever_m:.3g} m; "
            "check the sensor's axis, tip_lever_m, and sign and unit of the sensor's scale"
        )
    return None


def modes_words(estimate: PlantEstimate) -> str | None:
    """Describe several modes; None if the data show one."""
    if not estimate.modes:
        return None
    rings = ", ".join(f"{mode.antiresonance_hz.value:.1f}" for mode in estimate.modes)
    whole = sum(mode.inertia_kg_m2.value for mode in estimate.modes)
    return f"several modes are visible: {rings} Hz; together they are an inertia of {whole:.3g} kg·m² about the joint"


def misfit_words(estimate: PlantEstimate) -> str | None:
    """Describe a model that does not explain the data, or None."""
    if estimate.misfit <= SURE_SIGMAS:
        return None
    model = f"a model of {len(estimate.modes)} modes" if estimate.modes else "the two-inertia model"
    return (
        f"{model} leaves {estimate.misfit:.1f} standard deviations of the scatter unexplained (up to {SURE_SIGMAS:g} "
        "is usual); the arm may have a third inertia, or a stiffness that depends on the load; the errors are multiplied by it"
    )


def estimate_checks(estimate: PlantEstimate, amplitude_nm: float, request: PlantRequest, limited_by: str) -> list[PlantCheck]:
    """Check that the plant is identified well enough.

    The advice of each check can be followed. The errors are those of the noise alone, which more periods lower: the
    parameters' errors are larger by what `with_amplitude_dependence` adds. A resonance beyond the band is seen by its flank; J_m
    rests on it, and its error says how well.

    Args:
        estimate: The plant.
        amplitude_nm: Peak of the excitation.
        limited_by: Name of what allowed no larger amplitude; empty if it was requested.
    """
    high = float(estimate.response.frequency_hz[-1])
    f_r = estimate.parameters["resonance_hz"].value
    wider = "raise --high-hz" if request.high_hz is not None else "a shorter SYNC period carries more"
    checks = []
    if f_r > OUTSIDE * high:
        error = 100.0 * estimate.parameters["motor_inertia_kg_m2"].relative
        what = f"standard error of J_m, since f_r ({f_r:.3g} Hz) is beyond the band ({high:.3g} Hz)"
        checks.append(PlantCheck(what, error, STIFFNESS_PCT, "%", error <= STIFFNESS_PCT, wider, ("cycle",)))
    for name, parameter, allowed in (
        ("standard error of f_a from noise alone", estimate.parameters["antiresonance_hz"], ANTIRESONANCE_PCT),
        ("standard error of K_g from noise alone", estimate.parameters["gear_stiffness_nm_rad"], STIFFNESS_PCT),
    ):
        percent = 100.0 * parameter.relative
        times = percent / allowed
        causes: tuple[RefusalCause, ...] = ("noise",)
        if f_r > high:
            causes = ("noise", "cycle")
            more = f"the band ends at {high:.3g} Hz, below f_r = {f_r:.3g} Hz: {wider}"
        elif request.amplitude_nm is not None:
            more = f"leave out --amplitude-nm, or multiply --periods by {times**2:.2g}"
        else:
            causes = ("noise", "encoder")
            more = (
                f"the {limited_by} allows no amplitude above {amplitude_nm:.2g} N·m: multiply --periods by {times**2:.2g}, or "
                "take a finer encoder or a shorter SYNC period"
            )
        checks.append(PlantCheck(name, percent, allowed, "%", percent <= allowed, more, causes))
    return checks
