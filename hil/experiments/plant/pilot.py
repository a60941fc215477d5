"""Evaluation of a pilot run."""

import math
from dataclasses import dataclass

import numpy as np

from hil.control.arrays import Complex, Real
from hil.control.cancellation_table import LIMIT_USED
from hil.control.cascade import Cascade
from hil.design.frequency import Loop
from hil.design.plant_identification import PlantEstimate
from hil.design.plant_problem import SamplingTiming, tip_response
from hil.design.plant_spectra import Spectra
from hil.experiments.plant.motion import ExcitedSignal, Travel

PILOT_FRACTION = 0.05
"""Measured with `RIGID`, where the first pilot is enough: amplitude of the pilot run as a fraction of the torque limit."""
LARGEST_RISE = 10.0
"""Measured with `RIGID`, 1.3 to 7.1, so that other limits bind: largest ratio of the main run's amplitude to the pilot's."""
EXCITED_FRACTION = 0.6
"""Measured with `RIGID`, where the speed binds before either: fraction of the torque limit, and of the accelerometer's range,
that the whole of either may reach."""
EXCITED_SPEED_FRACTION = 0.75
"""Measured: fraction of the bias speed that excitation and transmission error may take from it: with it no motor of the drawn
robots 10700 to 10764 turned back."""
SET_POINTS = "speed of the set-points"
"""Name of that limit, beside those of `Room`."""
ROUGH_ANTIRESONANCE, ROUGH_STIFFNESS = 0.05, 0.5
"""Measured with `RIGID`, 0.011 and 0.067 at most: relative standard errors of f_a and K_g with which a pilot is good enough to
plan the main run."""
RIGID = 0.2
"""Measured: largest relative deviation of the inertia over the band with which an axis is called rigid: it is 0.93 at least on 14
drawn robots, all with an arm (10700, 10712, 10730, 10735, 10740 to 10749)."""


@dataclass(frozen=True)
class Peaks:
    """Largest torque, speed and tip acceleration of a run.

    They are in N·m, rev/s and m/s².
    """

    torque_nm: float
    speed_rps: float
    tip_m_s2: float

    def times(self, factor: float) -> "Peaks":
        """Multiply all peaks by a factor."""
        return Peaks(factor * self.torque_nm, factor * self.speed_rps, factor * self.tip_m_s2)

    def of(self, name: str) -> float:
        """Peak by the name of its limit."""
        return {"torque": self.torque_nm, "speed": self.speed_rps, "tip": self.tip_m_s2}[name]


@dataclass(frozen=True)
class MeasuredPeaks:
    """Peaks that follow the excitation, and peaks of the rest."""

    driven: Peaks
    rest: Peaks


def measured_peaks(angle_rad: Real, torque_nm: Real, tip_m_s2: Real | None, samples: int, sync_s: float) -> MeasuredPeaks:
    """Measure the peaks of a stretch of whole periods.

    Args:
        angle_rad: Motor angle less the bias motion; shape (n,).
        torque_nm: Motor torque; shape (n,).
        tip_m_s2: Tip acceleration; shape (n,); None without an accelerometer.
        samples: Rows of a period.
    """
    speed = np.gradient(angle_rad, sync_s) / math.tau
    pairs = []
    for values in (torque_nm, speed, tip_m_s2):
        if values is None:
            pairs.append((0.0, 0.0))
            continue
        periods = (values - np.mean(values)).reshape(-1, samples)
        mean = periods.mean(axis=0)
        pairs.append((float(np.max(np.abs(mean))), float(np.max(np.abs(periods - mean)))))
    return MeasuredPeaks(Peaks(*(pair[0] for pair in pairs)), Peaks(*(pair[1] for pair in pairs)))


def told_lever_ratio(estimate: PlantEstimate) -> float | None:
    """Lever of the tip over the bench file's; None if the data do not tell it.

    With a tip in the noise, the pilot of a drawn robot (50288) gave 260 ± 20 000.
    """
    ratio = estimate.parameters.get("lever_ratio")
    return ratio.value if ratio is not None and ratio.relative < 0.2 else None


def predicted_peaks(
    estimate: PlantEstimate, travel: Travel, excited: ExcitedSignal, law: Cascade, control_s: float, lever_m: float
) -> Peaks:
    """Predict the peaks under an excitation of 1 N·m.

    Args:
        excited: Signal to which the excitation is added.
        law: The drive's gains.
    """
    wave, plant = travel.wave, estimate.plant
    frequency, count = wave.frequency_hz, len(wave.wave)
    jw = 2j * math.pi * frequency
    drive = np.fft.rfft(wave.wave)[wave.lines] * np.sinc(frequency * wave.sample_s)
    if excited == "reference":
        drive = drive * law.position_gain_per_s * (law.velocity_gain_nm_s_rad + law.velocity_integral_gain_nm_rad / jw)
    motion = plant.motor_angle_per_torque(frequency) / (1.0 + jw * estimate.parameters["torque_lag_s"].value)
    torque = drive / (1.0 + motion * Loop(plant, law, (), control_s).controller(frequency))
    angle = motion * torque
    tip = tip_response(plant, frequency, lever_m * (told_lever_ratio(estimate) or 1.0)) * angle

    def peak(lines: Complex) -> float:
        spectrum = np.zeros(count // 2 + 1, dtype=np.complex128)
        spectrum[wave.lines] = lines
        return float(np.max(np.abs(np.fft.irfft(spectrum, count))))

    return Peaks(peak(torque), peak(jw * angle) / math.tau, peak(tip))


def set_point_room_nm(travel: Travel, excited: ExcitedSignal, speed_limit_rps: float) -> float:
    """Largest amplitude whose set-points keep the speed limit.

    It is infinite for an excitation of the torque.

    A torque takes a reference in proportion to it, whose speed grows with the frequency: at 90 Hz set-points are faster by far
    than the motor that follows them.

    Args:
        travel: Travel with the excitation, which begins at once.
        excited: Signal to which the excitation is added.
    """
    if excited == "torque":
        return math.inf
    wave = travel.wave
    steps = np.diff(np.concatenate([[0.0], wave.wave, wave.wave[:1]]))
    fastest_rps = float(np.max(np.abs(steps))) / wave.sample_s / math.tau
    return max(0.0, LIMIT_USED * speed_limit_rps - travel.bias_rps) / fastest_rps


@dataclass(frozen=True)
class Room:
    """Limits for an excitation, less what is there without it.

    Attributes:
        steady_nm: Mean torque of the stretch: friction and gravity.
        range_m_s2: Range of the accelerometer; infinite if it is not used.
        rest: Peaks without excitation.
    """

    torque_limit_nm: float
    steady_nm: float
    bias_rps: float
    range_m_s2: float
    rest: Peaks

    def largest(self, per_nm: Peaks) -> tuple[float, str]:
        """Find the largest amplitude and the limit that binds it.

        `per_nm` has the peaks per N·m; the amplitude is 0 if no room is left.
        """
        allowed = {
            "torque": EXCITED_FRACTION * self.torque_limit_nm - abs(self.steady_nm) - self.rest.torque_nm,
            "speed": EXCITED_SPEED_FRACTION * self.bias_rps - self.rest.speed_rps,
            "tip": EXCITED_FRACTION * self.range_m_s2 - self.rest.tip_m_s2,
        }
        limits = {name: max(0.0, each) / max(1e-12, per_nm.of(name)) for name, each in allowed.items()}
        least = min(limits, key=lambda name: limits[name])
        return limits[least], least


def is_rough(estimate: PlantEstimate) -> bool:
    """True if a pilot's estimate suffices to plan the main run."""
    parameters = estimate.parameters
    return (
        parameters["antiresonance_hz"].relative < ROUGH_ANTIRESONANCE
        and parameters["gear_stiffness_nm_rad"].relative < ROUGH_STIFFNESS
    )


def rigid_inertia(data: Spectra, timing: SamplingTiming) -> float | None:
    """Inertia of a motor without resonance in the band, in kg·m².

    None if there is a resonance, or too little is seen.
    """
    if timing.kind != "torque":
        return None
    angle, torque = data.angle.mean(axis=0), data.torque.mean(axis=0)
    jw = 2j * math.pi * data.frequency_hz
    late = np.exp(-jw * timing.sync_s)
    felt = torque + data.excitation.mean(axis=0) * ((1.0 - late) / (jw * timing.sync_s) - late)
    noise = np.std(data.angle, axis=0) / math.sqrt(data.periods)
    seen = np.abs(angle) > 3.0 * noise
    if np.mean(seen) < 0.8:
        return None
    shown = felt[seen] / (jw[seen] ** 2 * angle[seen])
    inertia, middle = np.abs(shown), float(np.median(np.abs(shown)))
    off = np.abs(shown.real / middle - 1.0)  # the imaginary part is viscous friction
    # lines are evenly spaced: a slow arm's resonance takes a twentieth of them, but more than a fifth of the octaves
    of_octaves = np.quantile(off, 0.8, weights=1.0 / data.frequency_hz[seen], method="inverted_cdf")
    is_rigid = max(float(np.quantile(np.abs(inertia / middle - 1.0), 0.95)), float(of_octaves)) < RIGID
    return middle if is_rigid else None
