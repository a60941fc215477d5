"""Identification of the plant of one axis without previous knowledge: slow turns, a pilot, the excitation, fit and checks."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.bench.model import IdentifiedPlant
from hil.design.estimation import EstimatedParameter, UnidentifiableError
from hil.design.friction import Friction, SlowStretch, fit_friction
from hil.design.plant_identification import PlantEstimate, fit_plant
from hil.design.plant_problem import SamplingTiming
from hil.design.plant_spectra import Spectra, Stretch, spectra
from hil.experiments.plant.checks import (
    MISFIT,
    DataCheck,
    PlantNotIdentifiedError,
    estimate_checks,
    reversal_check,
    sensor_trouble,
    tip_checks,
    torque_check,
    travel_check,
)
from hil.experiments.plant.motion import (
    TURN,
    ExcitedSignal,
    PlannedMotion,
    PlantRequest,
    Travel,
    axis_table,
    excited_motion,
    plan_travel,
    slow_motion,
    takes_torque_offset,
)
from hil.master.motion import Real, RunResult
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.robot_tables import PlantTable

PILOT_FRACTION = 0.05
"""Amplitude of the pilot run as a fraction of the torque limit."""
EXCITED_TORQUE_FRACTION = 0.6
"""Fraction of the torque limit that the whole torque may reach under the amplitude that is chosen."""
EXCITED_SPEED_FRACTION = 0.6
"""Fraction of the bias speed that the excitation may take from it."""
TIP_M_S2 = 10.0
"""Largest tip acceleration under the chosen amplitude: half of the range of the usual 2 g sensor."""
LARGEST_RISE = 10.0
"""Largest ratio of the chosen amplitude to the pilot's."""
WIDE_DEG = 30.0
"""Arm angle over which gravity's cosine can be told from a constant."""


@dataclass(frozen=True)
class PlantEvaluation:
    """Evaluation of a plant identification that passed its checks.

    Attributes:
        request: Request of the identification.
        excited: Signal to which the excitation was added.
        travel: Travel of the axis.
        amplitude_nm: Peak of the excitation.
        estimate: The plant.
        friction: Friction and gravity from the slow run.
        checks: Checks of the data; all of them hold.
        remarks: Sentences for the engineer.
        cannot_tell: Sentences on the limits of these data.
    """

    request: PlantRequest
    excited: ExcitedSignal
    travel: Travel
    amplitude_nm: float
    estimate: PlantEstimate
    friction: Friction
    checks: tuple[DataCheck, ...]
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
        names = [*PlantTable.model_fields, "antiresonance_hz", "resonance_hz", "damping"]
        errors = {name: parameters[name].standard_error for name in names}
        errors["coulomb_friction_nm"] = self.friction.coulomb_nm.standard_error
        errors["gravity_moment_nm"] = self.friction.gravity_moment_nm.standard_error
        return IdentifiedPlant(
            values=values,
            standard_error=errors,
            antiresonance_hz=plant.antiresonance_hz,
            resonance_hz=plant.resonance_hz,
            damping=parameters["damping"].value,
            cannot_tell=self.cannot_tell,
            coulomb_friction_nm=max(0.0, self.friction.coulomb_nm.value),
            gravity_moment_nm=self.friction.gravity_moment_nm.value,
            note=note,
        )


class PlantIdentification:
    """One identification on a session that has been brought up.

    Args:
        session: Session that has been brought up.
        request: Axis, band and excitation.
        reporter: Listener of each run.

    Attributes:
        recordings: Recordings so far, by name, also where the identification fails.
        checks: Checks so far.
        remarks: Sentences for the engineer so far.
    """

    def __init__(self, session: Session, request: PlantRequest, reporter: Reporter = SILENT) -> None:
        """Plan the travel; the only request to the drive is for its position.

        Raises:
            NotPossibleError: The request makes no sense on this bench.
            UnsafeRequestError: It would leave the bench file's limits.
        """
        self.session, self.request, self._reporter = session, request, reporter
        self.bench = session.bench
        self.table = axis_table(self.bench, request.axis)
        self.drive = session.axes[request.axis]
        self.recordings: dict[str, Recording] = {}
        self.checks: list[DataCheck] = []
        self.remarks: list[str] = []
        self.excited: ExcitedSignal = self._excited_signal()
        self.start_rev = self.drive.position_rad() / TURN
        self.travel = plan_travel(self.bench, request, self.start_rev, self.excited)
        self._control_s = 0.0

    def _excited_signal(self) -> ExcitedSignal:
        if self.request.excitation != "auto":
            return self.request.excitation
        can = takes_torque_offset(self.drive.profile)
        if not can:
            self.remarks.append(
                f"drive family {self.drive.profile.label} takes no torque offset: the reference is excited instead"
            )
        return "torque" if can else "reference"

    def perform(self) -> PlantEvaluation:
        """Make the slow run, the pilot and the main run, and fit the plant.

        Raises:
            PlantNotIdentifiedError: The data do not identify the plant; with every reason.
            SafetyStopError: A run was stopped.
            HilError: A run was refused.
        """
        self._reporter.step("slow turns for friction and gravity")
        slow = slow_motion(self.bench, self.request, self.travel, self.start_rev)
        try:
            friction = self._friction(slow, self._run("slow", slow))
        except UnidentifiableError as error:
            raise PlantNotIdentifiedError(self.request.axis, (f"friction: {error}",)) from error
        amplitude = self.request.amplitude_nm or self._pilot()
        self._reporter.step(f"{self.request.shape} of {amplitude:.3g} N·m at {self.travel.bias_rps:.3g} rev/s")
        main = self._excited(amplitude, is_pilot=False)
        result = self._run("main", main)
        estimate = self._estimate(main, result, friction, amplitude)
        if estimate.misfit > MISFIT:
            self.remarks.append(
                f"the two-inertia model leaves {estimate.misfit:.1f} standard deviations of the scatter unexplained (up to "
                f"{MISFIT:g} is usual): a third inertia, or a stiffness that depends on the load; the errors are enlarged by it"
            )
        return PlantEvaluation(
            self.request, self.excited, self.travel, amplitude, estimate, friction,
            tuple(self.checks), tuple(self.remarks), cannot_tell(estimate, friction),
        )  # fmt: skip

    # -- runs ----------------------------------------------------------------------------------------------------------

    def _excited(self, amplitude_nm: float, *, is_pilot: bool) -> PlannedMotion:
        where = self.bench, self.request, self.travel, self.start_rev
        planned = excited_motion(*where, self.excited, amplitude_nm, is_pilot=is_pilot)
        offset = planned.motion.torque_offset_nm
        if offset is None:
            return planned
        # the bus carries per mille of the rated torque
        scaling = self.drive.scaling
        sent = np.array([scaling.torque_nm(scaling.torque_per_mille(each)) for each in planned.excitation.tolist()])
        return PlannedMotion(planned.motion, planned.bias_rad, sent, planned.stretches, planned.speeds_rps)

    def _run(self, name: str, planned: PlannedMotion) -> RunResult:
        self.session.check_interrupt()
        result = self.session.run(planned.motion, "none", "drive")
        self.recordings[name] = result.recording
        self._control_s = result.control_period_s
        if result.stopped is not None:
            raise result.stopped
        return result

    def _pilot(self) -> float:
        """Amplitude at which torque, speed and tip stay well within their limits, from a run at a small one."""
        small = PILOT_FRACTION * self.table.limits.torque_nm
        self._reporter.step(f"pilot at {small:.3g} N·m")
        planned = self._excited(small, is_pilot=True)
        result = self._run("pilot", planned)
        recording, rows = result.recording, planned.stretches[0]
        torque = recording.axis(self.request.axis, "torque_nm")[rows]
        steady = float(np.mean(torque))
        allowed = EXCITED_TORQUE_FRACTION * self.table.limits.torque_nm - abs(steady)
        ripple = self.travel.bias_rps - float(np.min(self._speed_rps(recording, planned)))
        tip = float(np.max(np.abs(recording.columns["tip_z_m_s2"][rows])))
        rises = {
            "torque": allowed / max(1e-9, float(np.max(np.abs(torque - steady)))),
            "speed": EXCITED_SPEED_FRACTION * self.travel.bias_rps / max(1e-9, ripple),
            "tip": TIP_M_S2 / tip if tip > 0.0 and self.request.with_accelerometer else LARGEST_RISE,
        }
        least = min(rises, key=lambda name: rises[name])
        rise = min(LARGEST_RISE, rises[least])
        if rise < 0.2:
            raise PlantNotIdentifiedError(
                self.request.axis,
                (f"at {small:.3g} N·m the {least} already is {1.0 / rise:.3g} times what it may be: lower --amplitude-nm",),
            )
        self.remarks.append(f"the amplitude of {rise * small:.3g} N·m was chosen from a pilot at {small:.3g} N·m ({least})")
        return rise * small

    # -- evaluation ----------------------------------------------------------------------------------------------------

    def _friction(self, planned: PlannedMotion, result: RunResult) -> Friction:
        recording, axis = result.recording, self.request.axis
        angle, torque = recording.axis(axis, "position_rad"), recording.axis(axis, "torque_nm")
        self._require([travel_check(angle, planned.bias_rad)])
        present = recording.columns["missing"] == 0
        stretches = [SlowStretch(angle[rows], torque[rows]) for rows in planned.stretches if np.all(present[rows])]
        return fit_friction(stretches, recording.period_s, self.table.reduction_ratio)

    def _speed_rps(self, recording: Recording, planned: PlannedMotion) -> Real:
        """Motor speed along the bias, over all stretches."""
        angle = recording.axis(self.request.axis, "position_rad")
        speeds = [
            np.diff(angle[rows]) * math.copysign(1.0, speed)
            for rows, speed in zip(planned.stretches, planned.speeds_rps, strict=True)
        ]
        return np.concatenate(speeds) / recording.period_s / TURN

    def _estimate(self, planned: PlannedMotion, result: RunResult, friction: Friction, amplitude: float) -> PlantEstimate:
        recording, axis = result.recording, self.request.axis
        torque = recording.axis(axis, "torque_nm")
        counted = np.concatenate([torque[rows] for rows in planned.stretches])
        self._require([
            torque_check(counted, self.table.limits.torque_nm, amplitude),
            reversal_check(self._speed_rps(recording, planned), self.travel.bias_rps, amplitude),
        ])  # fmt: skip
        tip = self._tip(recording, result)
        try:
            data = self._spectra(planned, recording, tip)
            spring = self._gravity_spring(planned, recording, friction)
            timing = SamplingTiming(recording.period_s, self._control_s, self.excited, self.table.gains("its plant").cascade())
            estimate = fit_plant(data, timing, self.table.reduction_ratio, self.table.tip_lever_m, spring)
        except UnidentifiableError as error:
            raise PlantNotIdentifiedError(axis, (str(error),)) from error
        self._require([*estimate_checks(estimate, amplitude), *tip_checks(estimate, self.table.tip_lever_m)])
        return estimate

    def _tip(self, recording: Recording, result: RunResult) -> Real | None:
        if not self.request.with_accelerometer:
            self.remarks.append("the accelerometer was not used")
            return None
        tip = recording.columns["tip_z_m_s2"]
        trouble = sensor_trouble(tip, result.sensor_missed, result.cycles)
        if trouble is None:
            return tip
        self.remarks.append(f"{trouble}: f_a, ζ and K_g are from the motor alone, and the lever arm is not checked")
        return None

    def _spectra(self, planned: PlannedMotion, recording: Recording, tip: Real | None) -> Spectra:
        """Spectra of the periods of all stretches; of a stretch with missing answers the longest whole part."""
        start, samples = TURN * self.start_rev, self.travel.samples
        angle = recording.axis(self.request.axis, "position_rad") - start - planned.bias_rad
        torque = recording.axis(self.request.axis, "torque_nm")
        whole = recording.columns["missing"] == 0
        stretches, used, planned_periods = [], 0, 0
        for rows in planned.stretches:
            planned_periods += (rows.stop - rows.start) // samples
            part = _longest(whole, rows, samples)
            if part.stop - part.start < 2 * samples:
                continue
            used += (part.stop - part.start) // samples
            stretches.append(Stretch(planned.excitation[part], angle[part], torque[part], None if tip is None else tip[part]))
        if used < planned_periods:
            self.remarks.append(
                f"{planned_periods - used} of {planned_periods} periods were left out: answers were missing in them"
            )
        if not stretches:
            raise UnidentifiableError("whole periods without missing answers", used, 3)
        return spectra(stretches, samples, self.travel.wave.lines, recording.period_s)

    def _gravity_spring(self, planned: PlannedMotion, recording: Recording, friction: Friction) -> float:
        """DM/dθ_l of the gravity moment M = m g l cos(θ_l + q₀), on average over the stretches, in N·m/rad."""
        angle = recording.axis(self.request.axis, "position_rad")
        arm = np.concatenate([angle[rows] for rows in planned.stretches]) / self.table.reduction_ratio
        phase = math.radians(friction.gravity_phase_deg.value)
        return float(-friction.gravity_moment_nm.value * np.mean(np.sin(arm + phase)))

    def _require(self, checks: list[DataCheck]) -> None:
        self.checks += checks
        reasons = tuple(check.sentence for check in checks if not check.holds)
        if reasons:
            raise PlantNotIdentifiedError(self.request.axis, reasons)


def _longest(whole: np.ndarray[Any, np.dtype[np.bool_]], rows: slice, samples: int) -> slice:
    """The longest run of whole periods within a stretch."""
    best = slice(rows.start, rows.start)
    start = rows.start
    for first in range(rows.start, rows.stop - samples + 1, samples):
        if not np.all(whole[first : first + samples]):
            start = first + samples
        elif first + samples - start > best.stop - best.start:
            best = slice(start, first + samples)
    return best


def cannot_tell(estimate: PlantEstimate, friction: Friction) -> tuple[str, ...]:
    """Sentences on the limits of the data, with numbers."""
    parameters, plant = estimate.parameters, estimate.plant
    sentences = [
        "all inertias, stiffnesses and dampings are in proportion to the torque that the drive reports: an error of its rated "
        "torque (6076h) is an error of each of them; f_a, f_r and ζ are free of it",
        f"D_m cannot be told from friction that grows with the speed: D_m + D_l/N² together are "
        f"{_shown(parameters['viscous_damping_nm_s_rad'])} N·m·s/rad in the frequency response, and the slow turns show "
        f"{_shown(friction.viscous_nm_s_rad)}; at standstill Coulomb friction hides them altogether",
        f"D_l is {_shown(parameters['arm_damping_nm_s_rad'])} N·m·s/rad, told only by how the damping differs between f_a "
        f"and f_r; what is known well is D_g + D_l, by ζ",
        "hysteresis of the gear looks like damping, and ζ holds for the amplitude of this run: take ζ for the notch from the "
        "transmission error's ramp where both are known",
        "a stiffness that depends on the load is here one number, for the torque of this run",
    ]
    if plant.arm_damping_nm_s_rad < 0.0 or plant.motor_damping_nm_s_rad < 0.0:
        sentences.append("D_m or D_l came out below 0 within its error; the model file has 0")
    if friction.arm_span_deg < WIDE_DEG:
        sentences.append(
            f"m g l and its phase are extrapolated: the arm turned through {friction.arm_span_deg:.0f}°, and {WIDE_DEG:.0f}° are "
            "needed to see a cosine"
        )
    if estimate.tip is None:
        sentences.append("the tip lever, and whether it was this axis that moved: there is no accelerometer in the fit")
    return tuple(sentences)


def _shown(parameter: EstimatedParameter) -> str:
    return f"{parameter.value:.3g} ± {parameter.standard_error:.1g}"
