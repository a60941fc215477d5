"""Identification of the plant of one axis."""

import math
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from hil.control.arrays import Real
from hil.design.estimation import UnidentifiableError
from hil.design.friction import Friction, SlowStretch, fit_friction
from hil.design.modes.fit import fit_modes
from hil.design.plant_identification import PlantEstimate, fit_plant
from hil.design.plant_problem import SamplingTiming
from hil.design.plant_spectra import Spectra, Stretch, spectra
from hil.errors import RefusalCause
from hil.experiments.bus_demand import takes_torque_offset
from hil.experiments.decision import MOST_RUNS
from hil.experiments.plant.amplitude import VISCOUS, with_amplitude_dependence, with_slow_turns
from hil.experiments.plant.bands import fast_speed, highest_hz, loop_period_s, main_band, pilot_band
from hil.experiments.plant.checks import (
    PlantNotIdentifiedError,
    estimate_checks,
    misfit_words,
    modes_words,
    reversal_check,
    sensor_trouble,
    tip_trouble,
    torque_check,
    travel_check,
)
from hil.experiments.plant.evaluation import PlantEvaluation, cannot_tell
from hil.experiments.plant.motion import (
    FAST_FRACTION,
    Band,
    ExcitedSignal,
    PlannedMotion,
    PlantRequest,
    Travel,
    axis_table,
    excited_motion,
    plan_travel,
    slow_motion,
    with_wave,
)
from hil.experiments.plant.pilot import (
    LARGEST_RISE,
    PILOT_FRACTION,
    SET_POINTS,
    Room,
    is_rough,
    measured_peaks,
    predicted_peaks,
    rigid_inertia,
    set_point_room_nm,
)
from hil.experiments.plant.probe import probe_motion, probe_trouble
from hil.master.motion import RunResult
from hil.master.session import Session
from hil.recording import Recording
from hil.reporter import SILENT, Reporter
from hil.results.plant import PlantCheck
from hil.robot_tables import ORDERS

PILOTS = 3
"""Bound: pilot runs, each stronger until the resonances are roughly known: 0.05 · 5² of the torque limit is more than it."""
PILOT_RISE = 5.0
"""Measured: largest ratio of the amplitudes of two pilots: on 14 drawn robots (10700, 10712, 10730, 10735, 10740 to 10749) the
first was enough."""
CALMER = 0.6
"""Measured: factor of the amplitude where the motor turned back under one that was chosen: on none of the drawn robots 10700 to
10764."""


class PlantIdentification:
    """Identification of a plant on a session that has been brought up.

    Attributes:
        recordings: Recordings so far, by name, also where the identification fails.
    """

    def __init__(self, session: Session, request: PlantRequest, reporter: Reporter = SILENT) -> None:
        """Plan the travel.

        The drive is asked for its position only.

        Raises:
            NotPossibleError: The request makes no sense on this bench.
            UnsafeRequestError: It would leave the bench file's limits.
        """
        self.session, self.request, self._reporter = session, request, reporter
        self.bench = session.bench
        self.table = axis_table(self.bench, request.axis)
        if request.with_accelerometer:
            self.table.felt_lever_m(f"identify plant --axis {request.axis}")
        self.drive = session.axes[request.axis]
        self.recordings: dict[str, Recording] = {}
        self.checks: list[PlantCheck] = []
        self.remarks: list[str] = []
        self.excited: ExcitedSignal = self._excited_signal()
        self.start_rev = self.drive.position_rad() / math.tau
        self.travel = self._travel(pilot_band(request, self.bench.bus.sync_period_s))
        self._control_s, words = loop_period_s(self.drive)
        self.remarks += words
        self._uses_tip = request.with_accelerometer
        self._limited_by = ""

    def _travel(self, band: Band, *, is_pilot: bool = False) -> Travel:
        return plan_travel(self.bench, self.request, band, self.start_rev, self.excited, is_pilot=is_pilot)

    def _excited_signal(self) -> ExcitedSignal:
        if self.request.excitation != "auto":
            return self.request.excitation
        can = takes_torque_offset(self.drive.profile)
        if not can:
            self.remarks.append(f"drive family {self.drive.profile.label} has no torque offset: the reference is excited instead")
        return "torque" if can else "reference"

    def perform(self) -> PlantEvaluation:
        """Make all runs and fit the plant.

        Raises:
            PlantNotIdentifiedError: The data do not identify the plant; with every reason.
            SafetyStopError: A run was stopped.
            HilError: A run was refused.
        """
        self._probe()
        rough, room = self._pilot()
        sync_s, limit_rps, is_arm = self.bench.bus.sync_period_s, self.table.limits.speed_rps, self.bench.arm is not None
        band = main_band(self.request, sync_s, rough.plant, limit_rps, is_wide=is_arm)
        self.travel = self._travel(band)
        amplitude = self.request.amplitude_nm or self._chosen(rough, room)
        self._reporter.step("slow turns for friction and gravity")
        fastest = fast_speed(rough.plant.antiresonance_hz, FAST_FRACTION * self.table.limits.speed_rps)
        slow = slow_motion(self.bench, self.request, self.travel, self.start_rev, fastest)
        try:
            friction = self._friction(slow, self._run("slow", slow), rough.plant.gear_stiffness_nm_rad)
        except UnidentifiableError as error:
            raise self._refused(f"friction: {error}") from error
        estimate, amplitude = self._main(amplitude, friction, rough, room, band)
        estimate, words = self._compared(estimate, rough)
        self.remarks += [each for each in (words, misfit_words(estimate)) if each is not None]
        viscous = estimate.parameters[VISCOUS]
        estimate = with_slow_turns(estimate, friction.viscous_nm_s_rad)
        return PlantEvaluation(
            self.request, self.excited, self.travel, amplitude, estimate, friction,
            tuple(self.checks), tuple(self.remarks), cannot_tell(estimate, friction, viscous),
        )  # fmt: skip

    def _refused(self, *reasons: str, causes: tuple[RefusalCause, ...] = ()) -> PlantNotIdentifiedError:
        return PlantNotIdentifiedError(self.request.axis, reasons, causes)

    # -- runs ----------------------------------------------------------------------------------------------------------

    def _excited(self, travel: Travel, amplitude_nm: float) -> PlannedMotion:
        planned = excited_motion(self.bench, self.request, travel, self.start_rev, self.excited, amplitude_nm)
        offset = planned.motion.torque_offset_nm
        if offset is None:
            return planned
        # the bus carries per mille of the rated torque
        scaling = self.drive.scaling
        sent = np.array([scaling.torque_nm(scaling.torque_per_mille(each)) for each in planned.excitation.tolist()])
        return replace(planned, excitation=sent)

    def _run(self, name: str, planned: PlannedMotion) -> RunResult:
        self.session.check_interrupt()
        result = self.session.run(planned.motion, "none", "drive")
        self.recordings[name] = result.recording
        if result.stopped is not None:
            raise result.stopped
        return result

    def _probe(self) -> None:
        """Turn the motor a third of a turn and back.

        Faults that must not be found at full travel are found here.
        """
        self._reporter.step("a third of a turn and back")
        planned = probe_motion(self.bench, self.request, self.start_rev)
        self.session.check_interrupt()
        result = self.session.run(planned.motion, "none", "drive")
        self.recordings["probe"] = result.recording
        limit, ratio = self.table.limits.torque_nm, self.table.reduction_ratio
        trouble = probe_trouble(planned, result.recording, self.request.axis, limit, ratio)
        if trouble is not None:
            raise self._refused(trouble.sentence, causes=("wrong axis or wiring",)) from result.stopped
        if result.stopped is not None:
            raise result.stopped
        self._require(
            [travel_check(result.recording.axis(self.request.axis, "position_rad"), planned.bias_rad, "in a third of a turn")]
        )

    def _pilot(self) -> tuple[PlantEstimate, Room]:
        """Estimate the plant roughly by short runs at small amplitudes.

        Returns also the room that the main run's excitation has.
        """
        band = pilot_band(self.request, self.bench.bus.sync_period_s)
        travel = self._travel(band, is_pilot=True)
        small, within_nm = PILOT_FRACTION * self.table.limits.torque_nm, self._set_point_room_nm(travel)
        small = min(small, within_nm) if self.request.amplitude_nm is None else min(small, self.request.amplitude_nm)
        for number in range(1, PILOTS + 1):
            self._reporter.step(f"pilot at {small:.3g} N·m")
            planned = self._excited(travel, small)
            result = self._run("pilot", planned)
            recording, rows = result.recording, planned.stretches[0]
            tip = self._tip(recording, result)
            angle = recording.axis(self.request.axis, "position_rad")
            torque = recording.axis(self.request.axis, "torque_nm")
            seen = None if tip is None else tip[rows]
            peaks = measured_peaks((angle - planned.bias_rad)[rows], torque[rows], seen, travel.samples, recording.period_s)
            known = None if self.bench.accelerometer is None else self.bench.accelerometer.free_range_m_s2
            reach = math.inf if tip is None or known is None else known
            room = Room(self.table.limits.torque_nm, float(np.mean(torque[rows])), travel.bias_rps, reach, peaks.rest)
            largest, self._limited_by = min(room.largest(peaks.driven.times(1.0 / small)), (within_nm, SET_POINTS))
            data = self._pilot_spectra(travel, planned, recording)
            estimate = None
            if rigid_inertia(data, self._timing()) is not None:
                break
            with suppress(UnidentifiableError):
                estimate = self._with_modes(data, 0.0)
            if estimate is not None and is_rough(estimate):
                return self._with_right_tip(estimate, data), room
            if number < PILOTS and largest > 1.2 * small and self.request.amplitude_nm is None:
                small *= min(PILOT_RISE, largest / small)
                continue
            break
        causes: tuple[RefusalCause, ...] = ("limits", "cycle") if self._is_cut_by_sync(band) else ("limits",)
        raise self._refused(self._unseen(data, estimate, band, small, largest), causes=causes)

    def _pilot_spectra(self, travel: Travel, planned: PlannedMotion, recording: Recording) -> Spectra:
        try:
            return self._spectra(travel, [(planned, recording)])
        except UnidentifiableError as error:
            raise self._refused(f"pilot: {error}") from error

    def _unseen(self, data: Spectra, estimate: PlantEstimate | None, band: Band, amplitude: float, largest: float) -> str:
        """Reason why no pilot showed the resonances."""
        inertia = rigid_inertia(data, self._timing())
        if inertia is not None:
            return (
                f"motor and arm turn as one inertia of {inertia:.2g} kg·m² from {band.low_hz:g} to {band.high_hz:.3g} Hz; there "
                f"is no resonance of the arm in this band; {self._reach_words(band)}"
            )
        reach = f"{band.low_hz:g} and {band.high_hz:.3g} Hz"
        why = f"at {amplitude:.3g} N·m the motor's motion does not show the resonances between {reach}"
        if estimate is not None:
            f_a, stiffness = estimate.parameters["antiresonance_hz"], estimate.parameters["gear_stiffness_nm_rad"]
            why += f" (f_a {f_a.value:.3g} ± {f_a.standard_error:.2g} Hz, K_g ± {100.0 * stiffness.relative:.0f} %)"
        if self.request.amplitude_nm is not None and largest > 1.2 * amplitude:
            return f"{why}; the limits allow {largest:.2g} N·m: leave out --amplitude-nm"
        return f"{why}, and the {self._limited_by} allows no more than {largest:.2g} N·m; {self._reach_words(band)}"

    def _is_cut_by_sync(self, band: Band) -> bool:
        """True if the SYNC period limits the band."""
        return self.request.high_hz is None and band.high_hz >= 0.9 * highest_hz(self.bench.bus.sync_period_s)

    def _reach_words(self, band: Band) -> str:
        sync = self.bench.bus.sync_period_s
        if not self._is_cut_by_sync(band):
            return "a wider band (--low-hz, --high-hz), or the arm without a brace, may show it"
        return f"a SYNC period of {1e3 * sync:g} ms carries no more than {highest_hz(sync):.3g} Hz; a shorter one carries more"

    def _with_right_tip(self, estimate: PlantEstimate, data: Spectra, spring_nm_rad: float = 0.0) -> PlantEstimate:
        """Fit again without the accelerometer if its signal is wrong."""
        trouble = tip_trouble(estimate, self.table.tip_lever_m) if self._uses_tip else None
        if trouble is None:
            return estimate
        self._leave_out_tip(trouble)
        return self._with_modes(replace(data, tip=None), spring_nm_rad, estimate)

    def _with_modes(self, data: Spectra, spring_nm_rad: float, near: PlantEstimate | None = None) -> PlantEstimate:
        """Fit the plant, for an arm with several modes."""
        timing, table = self._timing(), self.table
        single = fit_plant(data, timing, table.reduction_ratio, table.tip_lever_m, spring_nm_rad, near)
        if self.bench.arm is None:
            return single
        return fit_modes(data, timing, table.reduction_ratio, table.tip_lever_m, spring_nm_rad, single)

    def _compared(self, estimate: PlantEstimate, rough: PlantEstimate) -> tuple[PlantEstimate, str | None]:
        """Widen the errors for other torsions, and describe the gear.

        Several modes are not compared between amplitudes, since a pilot may have shown fewer.
        """
        words = modes_words(estimate)
        return with_amplitude_dependence(estimate, rough) if words is None else (estimate, words)

    def _set_point_room_nm(self, travel: Travel) -> float:
        return set_point_room_nm(travel, self.excited, self.table.limits.speed_rps)

    def _chosen(self, rough: PlantEstimate, room: Room) -> float:
        """Amplitude at which torque, speed and tip stay well within their limits."""
        small = PILOT_FRACTION * self.table.limits.torque_nm
        amplitude = self._largest(rough, room)
        if amplitude <= 0.02 * small:
            raise self._refused(
                f"no amplitude fits: without any excitation the {self._limited_by} is at its limit already (transmission error "
                f"at {self.travel.bias_rps:.2g} rev/s: {room.rest.speed_rps:.2g} rev/s, {room.rest.tip_m_s2:.2g} m/s²); choose "
                "another --bias-rps, away from the resonance",
                causes=("limits",),
            )
        self.remarks.append(f"a pilot run chose the amplitude of {amplitude:.3g} N·m; the {self._limited_by} limits it")
        return amplitude

    def _largest(self, rough: PlantEstimate, room: Room) -> float:
        """Largest amplitude of the travel's wave within all limits."""
        law = self.table.gains("its plant").cascade()
        per_nm = predicted_peaks(rough, self.travel, self.excited, law, self._control_s, self.table.tip_lever_m)
        here = replace(room, bias_rps=self.travel.bias_rps)
        largest, self._limited_by = min(here.largest(per_nm), (self._set_point_room_nm(self.travel), SET_POINTS))
        return min(largest, LARGEST_RISE * PILOT_FRACTION * self.table.limits.torque_nm)

    def _main(
        self, amplitude: float, friction: Friction, near: PlantEstimate, room: Room, band: Band
    ) -> tuple[PlantEstimate, float]:
        """Fit the plant to as many main runs as needed, each with a wave of its own.

        Returns also the amplitude of the last runs.
        """
        runs: list[tuple[PlannedMotion, Recording]] = []
        calmed = False
        for number in range(1, MOST_RUNS + 1):
            if runs:
                self.travel = with_wave(self.travel, len(runs), self.bench, self.request, band, self.excited)
            if runs and self.request.amplitude_nm is None:
                amplitude = (CALMER if calmed else 1.0) * self._largest(near, room)
            self._reporter.step(f"{self.request.shape} of {amplitude:.3g} N·m at {self.travel.bias_rps:.3g} rev/s")
            planned = self._excited(self.travel, amplitude)
            result = self._run("main" if number == 1 else f"main-{number}", planned)
            troubles = self._main_checks(planned, result.recording, amplitude)
            if any(not check.holds for check in troubles) and self.request.amplitude_nm is None and not calmed:
                amplitude, calmed = CALMER * amplitude, True
                self.remarks.append(f"the motor turned back or met its torque limit; the runs go on with {amplitude:.3g} N·m")
                continue
            self._require(troubles)
            runs.append((planned, result.recording))
            self._tip(result.recording, result)
            try:
                data, spring = self._spectra(self.travel, runs), self._gravity_spring(planned, result.recording, friction)
                estimate = self._with_right_tip(self._with_modes(data, spring, near), data, spring)
            except UnidentifiableError as error:
                raise self._refused(str(error)) from error
            checks = estimate_checks(estimate, amplitude, self.request, self._limited_by)
            if all(check.holds for check in checks):
                break
        if any(not check.holds for check in checks):
            _, words = self._compared(estimate, near)
            self._require(checks, *([] if words is None else [words]))
        self._require(checks)
        return estimate, amplitude

    # -- evaluation ----------------------------------------------------------------------------------------------------

    def _friction(self, planned: PlannedMotion, result: RunResult, stiffness_nm_rad: float) -> Friction:
        recording, axis = result.recording, self.request.axis
        angle, torque = recording.axis(axis, "position_rad"), recording.axis(axis, "torque_nm")
        self._require([travel_check(angle, planned.bias_rad, "in slow turns")])
        present = recording.columns["missing"] == 0
        stretches = [SlowStretch(angle[rows], torque[rows]) for rows in planned.stretches if np.all(present[rows])]
        return fit_friction(stretches, recording.period_s, self.table.reduction_ratio, stiffness_nm_rad)

    def _speed_rps(self, recording: Recording, planned: PlannedMotion) -> Real:
        """Motor speed along the bias, over all stretches."""
        angle = recording.axis(self.request.axis, "position_rad")
        speeds = [
            np.diff(angle[rows]) * math.copysign(1.0, speed)
            for rows, speed in zip(planned.stretches, planned.speeds_rps, strict=True)
        ]
        return np.concatenate(speeds) / recording.period_s / math.tau

    def _main_checks(self, planned: PlannedMotion, recording: Recording, amplitude: float) -> list[PlantCheck]:
        torque = recording.axis(self.request.axis, "torque_nm")
        counted = np.concatenate([torque[rows] for rows in planned.stretches])
        return [
            torque_check(counted, self.table.limits.torque_nm, amplitude),
            reversal_check(self._speed_rps(recording, planned), self.travel.bias_rps, amplitude),
        ]

    def _timing(self) -> SamplingTiming:
        law = self.table.gains("its plant").cascade()
        return SamplingTiming(self.bench.bus.sync_period_s, self._control_s, self.excited, law)

    def _tip(self, recording: Recording, result: RunResult) -> Real | None:
        unused = f"the {self.bench.accelerometer.title} was not used"
        if not self.request.with_accelerometer and unused not in self.remarks:
            self.remarks.append(unused)
        if not self._uses_tip:
            return None
        tip = recording.felt_m_s2
        trouble = recording.doubt or sensor_trouble(tip, result.sensor_missed, result.cycles, self.bench.accelerometer.title)
        if trouble is None:
            return tip
        self._leave_out_tip(trouble)
        return None

    def _leave_out_tip(self, trouble: str) -> None:
        self._uses_tip = False
        self.remarks.append(f"{trouble}: f_a, ζ and K_g are from the motor alone, and the lever arm is not checked")

    def _spectra(self, travel: Travel, runs: list[tuple[PlannedMotion, Recording]]) -> Spectra:
        """Compute the spectra of the periods of all stretches.

        Of a stretch with missing answers only the longest whole part counts.
        """
        start, axis, samples = math.tau * self.start_rev, self.request.axis, travel.samples
        stretches, used, planned_periods = [], 0, 0
        for planned, recording in runs:
            felt = None if not self._uses_tip else recording.felt_m_s2
            angle = recording.axis(axis, "position_rad") - start - planned.bias_rad
            torque, whole = recording.axis(axis, "torque_nm"), recording.columns["missing"] == 0
            for rows, speed_rps in zip(planned.stretches, planned.speeds_rps, strict=True):
                planned_periods += (rows.stop - rows.start) // samples
                part = _longest(whole, rows, samples)
                if part.stop - part.start < 2 * samples:
                    continue
                used += (part.stop - part.start) // samples
                seen = None if felt is None else felt[part]
                orders_hz = tuple(order * abs(speed_rps) for order in ORDERS)
                stretches.append(Stretch(planned.excitation[part], angle[part], torque[part], seen, orders_hz, planned.wave))
        if used < planned_periods:
            self.remarks.append(
                f"{planned_periods - used} of {planned_periods} periods were left out: answers were missing in them"
            )
        if not stretches:
            raise UnidentifiableError("whole periods without missing answers", used, 3)
        return spectra(stretches, samples, travel.wave.lines, self.bench.bus.sync_period_s)

    def _gravity_spring(self, planned: PlannedMotion, recording: Recording, friction: Friction) -> float:
        """Mean gravity stiffness dM/dθ_l over the stretches, in N·m/rad.

        M = m g l cos(θ_l + q₀)
        """
        angle = recording.axis(self.request.axis, "position_rad")
        arm = np.concatenate([angle[rows] for rows in planned.stretches]) / self.table.reduction_ratio
        phase = math.radians(friction.gravity_phase_deg.value)
        return float(-friction.gravity_moment_nm.value * np.mean(np.sin(arm + phase)))

    def _require(self, checks: list[PlantCheck], *more: str) -> None:
        self.checks += checks
        reasons = tuple(check.sentence for check in checks if not check.holds)
        if reasons:
            causes = (cause for check in checks if not check.holds for cause in check.causes)
            raise self._refused(*more, *reasons, causes=tuple(dict.fromkeys(causes)))


def _longest(whole: np.ndarray[Any, np.dtype[np.bool_]], rows: slice, samples: int) -> slice:
    """Longest run of whole periods within a stretch."""
    best = slice(rows.start, rows.start)
    start = rows.start
    for first in range(rows.start, rows.stop - samples + 1, samples):
        if not np.all(whole[first : first + samples]):
            start = first + samples
        elif first + samples - start > best.stop - best.start:
            best = slice(start, first + samples)
    return best
