"""Identify the plant of one axis from no knowledge of it: slow turns, a pilot, the excitation, the fit, the checks."""

import datetime
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drive_profiles.address import parse_address
from hil.can.channel import Channel, open_channel
from hil.design.friction import Friction, SlowStretch, fit_friction
from hil.design.plant_identification import (
    Parameter,
    PlantEstimate,
    Response,
    Spectra,
    Stretch,
    Timing,
    UnidentifiableError,
    fit_plant,
    spectra,
)
from hil.errors import NotPossibleError, SafetyStopError
from hil.experiments.plant_checks import (
    MISFIT,
    Check,
    NotIdentifiedError,
    estimate_checks,
    reversal_check,
    sensor_trouble,
    tip_checks,
    torque_check,
    travel_check,
)
from hil.experiments.plant_motion import (
    TURN,
    Kind,
    Planned,
    PlantRequest,
    Travel,
    axis_table,
    excited_motion,
    plan_travel,
    slow_motion,
)
from hil.experiments.runner import write_json
from hil.master.bench import Bench
from hil.master.identified import IdentifiedPlant, PlantTable, update_file
from hil.master.motion import Real, RunResult
from hil.master.session import Session
from hil.recording import BusLog, Recording

SCHEMA = 1

PILOT_SHARE = 0.05
"""Of the torque limit: the amplitude of the pilot run."""
TORQUE_SHARE = 0.6
"""Of the torque limit: what the whole torque may reach under the amplitude that is chosen."""
RIPPLE_SHARE = 0.6
"""Of the bias speed: what the excitation may take from it."""
TIP_M_S2 = 10.0
"""What the tip may feel under the amplitude that is chosen: half of what the usual 2 g sensor shows."""
LARGEST_RISE = 10.0
"""From the pilot's amplitude to the one that is chosen."""
WIDE_DEG = 30.0
"""Arm angle over which gravity's cosine can be told from a constant."""


@dataclass(frozen=True)
class Evaluated:
    """What came of one identification.

    Attributes:
        request: What was wanted.
        kind: Where the excitation was added.
        travel: Where the axis moved.
        amplitude_nm: Peak of the excitation.
        estimate: The plant.
        friction: From the slow run.
        checks: What was looked at; all of them hold.
        remarks: What else must be known.
        cannot_tell: What these data cannot tell.
    """

    request: PlantRequest
    kind: Kind
    travel: Travel
    amplitude_nm: float
    estimate: PlantEstimate
    friction: Friction
    checks: tuple[Check, ...]
    remarks: tuple[str, ...]
    cannot_tell: tuple[str, ...]

    def identified(self, note: str) -> IdentifiedPlant:
        """The entry of the model file."""
        plant, found = self.estimate.plant, self.estimate.parameters
        motor, arm = max(0.0, plant.motor_damping_nm_s_rad), max(0.0, plant.arm_damping_nm_s_rad)
        values = PlantTable(
            motor_inertia_kg_m2=plant.motor_inertia_kg_m2,
            motor_damping_nm_s_rad=motor,
            arm_inertia_kg_m2=plant.arm_inertia_kg_m2,
            arm_damping_nm_s_rad=arm,
            gear_stiffness_nm_rad=plant.gear_stiffness_nm_rad,
            gear_damping_nm_s_rad=max(0.0, plant.gear_damping_nm_s_rad),
        )
        told = [*PlantTable.model_fields, "antiresonance_hz", "resonance_hz", "damping"]
        errors = {name: found[name].standard_error for name in told}
        errors["coulomb_friction_nm"] = self.friction.coulomb_nm.standard_error
        errors["gravity_moment_nm"] = self.friction.gravity_moment_nm.standard_error
        return IdentifiedPlant(
            values=values,
            standard_error=errors,
            antiresonance_hz=plant.antiresonance_hz,
            resonance_hz=plant.resonance_hz,
            damping=found["damping"].value,
            cannot_tell=self.cannot_tell,
            coulomb_friction_nm=max(0.0, self.friction.coulomb_nm.value),
            gravity_moment_nm=self.friction.gravity_moment_nm.value,
            note=note,
        )


class PlantIdentification:
    """One identification on a session that has been brought up.

    Args:
        session: The master; `bring_up` has been called.
        request: What is wanted.
        announce: Called with a sentence before each run.

    Attributes:
        recordings: What was recorded so far, by name: kept whatever happens.
        checks: What was looked at so far.
        remarks: What else must be known so far.
    """

    def __init__(self, session: Session, request: PlantRequest, announce: Callable[[str], None] = lambda what: None) -> None:
        """Plan the travel; nothing is sent but a question for the position.

        Raises:
            NotPossibleError: The request makes no sense on this bench.
            UnsafeRequestError: It would leave the bench file's limits.
        """
        self.session, self.request, self._announce = session, request, announce
        self.bench = session.bench
        self.table = axis_table(self.bench, request.axis)
        self.drive = session.axes[request.axis]
        self.recordings: dict[str, Recording] = {}
        self.checks: list[Check] = []
        self.remarks: list[str] = []
        self.kind: Kind = self._kind()
        self.start_rev = self.drive.position_rad() / TURN
        self.travel = plan_travel(self.bench, request, self.start_rev, self.kind)
        self._control_s = 0.0

    def _kind(self) -> Kind:
        if self.request.excitation != "auto":
            return self.request.excitation
        capabilities = self.drive.profile.capabilities
        can = capabilities is not None and capabilities.torque_offset.answer in {"exact", "yes"}
        if not can:
            self.remarks.append(
                f"drive family {self.drive.profile.name} takes no torque offset: the reference is excited instead"
            )
        return "torque" if can else "reference"

    def perform(self) -> Evaluated:
        """Slow run, pilot, main run, fit.

        Raises:
            NotIdentifiedError: The data do not tell the plant; with every reason.
            SafetyStopError: A run was stopped.
            HilError: A run was refused.
        """
        self._announce("slow turns for friction and gravity")
        slow = slow_motion(self.bench, self.request, self.travel, self.start_rev)
        try:
            friction = self._friction(slow, self._run("slow", slow))
        except UnidentifiableError as error:
            raise NotIdentifiedError(self.request.axis, (f"friction: {error}",)) from error
        amplitude = self.request.amplitude_nm or self._pilot()
        self._announce(f"{self.request.shape} of {amplitude:.3g} N·m at {self.travel.bias_rps:.3g} rps")
        main = self._excited(amplitude, is_pilot=False)
        result = self._run("main", main)
        estimate = self._estimate(main, result, friction, amplitude)
        if estimate.misfit > MISFIT:
            self.remarks.append(
                f"the two-inertia model leaves {estimate.misfit:.1f} standard deviations of the scatter unexplained (up to "
                f"{MISFIT:g} is usual): a third inertia, or a stiffness that depends on the load; the errors are enlarged by it"
            )
        return Evaluated(
            self.request, self.kind, self.travel, amplitude, estimate, friction,
            tuple(self.checks), tuple(self.remarks), cannot_tell(estimate, friction),
        )  # fmt: skip

    # -- runs ----------------------------------------------------------------------------------------------------------

    def _excited(self, amplitude_nm: float, *, is_pilot: bool) -> Planned:
        where = self.bench, self.request, self.travel, self.start_rev
        planned = excited_motion(*where, self.kind, amplitude_nm, is_pilot=is_pilot)
        offset = planned.motion.torque_offset_nm
        if offset is None:
            return planned
        # what is sent is per mille of the rated torque
        scaling = self.drive.scaling
        sent = np.array([scaling.torque_nm(scaling.torque_per_mille(each)) for each in planned.excitation.tolist()])
        return Planned(planned.motion, planned.bias_rad, sent, planned.stretches, planned.speeds_rps)

    def _run(self, name: str, planned: Planned) -> RunResult:
        self.session.check_interrupt()
        result = self.session.run(planned.motion, "none", "drive")
        self.recordings[name] = result.recording
        self._control_s = result.control_period_s
        if result.stopped is not None:
            raise result.stopped
        return result

    def _pilot(self) -> float:
        """The amplitude at which torque, speed and tip stay well within what they may, from a run at a small one."""
        small = PILOT_SHARE * self.table.limits.torque_nm
        self._announce(f"pilot at {small:.3g} N·m")
        planned = self._excited(small, is_pilot=True)
        result = self._run("pilot", planned)
        recording, rows = result.recording, planned.stretches[0]
        torque = recording.axis(self.request.axis, "torque_nm")[rows]
        steady = float(np.mean(torque))
        allowed = TORQUE_SHARE * self.table.limits.torque_nm - abs(steady)
        ripple = self.travel.bias_rps - float(np.min(self._speed_rps(recording, planned)))
        tip = float(np.max(np.abs(recording.columns["tip_z_m_s2"][rows])))
        rises = {
            "torque": allowed / max(1e-9, float(np.max(np.abs(torque - steady)))),
            "speed": RIPPLE_SHARE * self.travel.bias_rps / max(1e-9, ripple),
            "tip": TIP_M_S2 / tip if tip > 0.0 and self.request.with_accelerometer else LARGEST_RISE,
        }
        least = min(rises, key=lambda name: rises[name])
        rise = min(LARGEST_RISE, rises[least])
        if rise < 0.2:
            raise NotIdentifiedError(
                self.request.axis,
                (f"at {small:.3g} N·m the {least} already is {1.0 / rise:.3g} times what it may be: lower --amplitude-nm",),
            )
        self.remarks.append(f"the amplitude of {rise * small:.3g} N·m was chosen from a pilot at {small:.3g} N·m ({least})")
        return rise * small

    # -- evaluation ----------------------------------------------------------------------------------------------------

    def _friction(self, planned: Planned, result: RunResult) -> Friction:
        recording, axis = result.recording, self.request.axis
        angle, torque = recording.axis(axis, "position_rad"), recording.axis(axis, "torque_nm")
        self._require([travel_check(angle, planned.bias_rad)])
        present = recording.columns["missing"] == 0
        stretches = [SlowStretch(angle[rows], torque[rows]) for rows in planned.stretches if np.all(present[rows])]
        return fit_friction(stretches, recording.period_s, self.table.reduction_ratio)

    def _speed_rps(self, recording: Recording, planned: Planned) -> Real:
        """Motor speed along the bias, over all stretches."""
        angle = recording.axis(self.request.axis, "position_rad")
        found = [
            np.diff(angle[rows]) * math.copysign(1.0, speed)
            for rows, speed in zip(planned.stretches, planned.speeds_rps, strict=True)
        ]
        return np.concatenate(found) / recording.period_s / TURN

    def _estimate(self, planned: Planned, result: RunResult, friction: Friction, amplitude: float) -> PlantEstimate:
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
            timing = Timing(recording.period_s, self._control_s, self.kind, self.table.control.cascade())
            estimate = fit_plant(data, timing, self.table.reduction_ratio, self.table.tip_lever_m, spring)
        except UnidentifiableError as error:
            raise NotIdentifiedError(axis, (str(error),)) from error
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

    def _spectra(self, planned: Planned, recording: Recording, tip: Real | None) -> Spectra:
        """The periods of all stretches; of a stretch with missing answers the longest whole part."""
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

    def _gravity_spring(self, planned: Planned, recording: Recording, friction: Friction) -> float:
        """DM/dθ_l of the gravity moment M = m g l cos(θ_l + q₀), on average over the stretches, in N·m/rad."""
        angle = recording.axis(self.request.axis, "position_rad")
        arm = np.concatenate([angle[rows] for rows in planned.stretches]) / self.table.reduction_ratio
        phase = math.radians(friction.gravity_phase_deg.value)
        return float(-friction.gravity_moment_nm.value * np.mean(np.sin(arm + phase)))

    def _require(self, checks: list[Check]) -> None:
        self.checks += checks
        reasons = tuple(check.sentence for check in checks if not check.holds)
        if reasons:
            raise NotIdentifiedError(self.request.axis, reasons)


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
    """What these data cannot tell, in words and numbers."""
    found, plant = estimate.parameters, estimate.plant
    said = [
        "all inertias, stiffnesses and dampings are in proportion to the torque that the drive reports: an error of its rated "
        "torque (6076h) is an error of each of them; f_a, f_r and ζ are free of it",
        f"D_m cannot be told from friction that grows with the speed: D_m + D_l/N² together are "
        f"{_shown(found['viscous_damping_nm_s_rad'])} N·m·s/rad in the frequency response, and the slow turns show "
        f"{_shown(friction.viscous_nm_s_rad)}; at standstill Coulomb friction hides them altogether",
        f"D_l is {_shown(found['arm_damping_nm_s_rad'])} N·m·s/rad, told only by how the damping differs between f_a and f_r; "
        f"what is known well is D_g + D_l, by ζ",
        "hysteresis of the gear looks like damping, and ζ holds for the amplitude of this run: take ζ for the notch from the "
        "transmission error's ramp where both are known",
        "a stiffness that depends on the load is here one number, for the torque of this run",
    ]
    if plant.arm_damping_nm_s_rad < 0.0 or plant.motor_damping_nm_s_rad < 0.0:
        said.append("D_m or D_l came out below 0 within its error; the model file has 0")
    if friction.arm_span_deg < WIDE_DEG:
        said.append(
            f"m g l and its phase are extrapolated: the arm turned through {friction.arm_span_deg:.0f}°, and {WIDE_DEG:.0f}° are "
            "needed to see a cosine"
        )
    if estimate.tip is None:
        said.append("the tip lever, and whether it was this axis that moved: there is no accelerometer in the fit")
    return tuple(said)


def _shown(parameter: Parameter) -> str:
    return f"{parameter.value:.3g} ± {parameter.standard_error:.1g}"


# -- files -------------------------------------------------------------------------------------------------------------


def run_identify_plant(
    bench: Bench,
    request: PlantRequest,
    out: Path,
    *,
    model: Path | None = None,
    channel: Channel | None = None,
    overload: bool = False,
    announce: Callable[[str], None] = lambda what: None,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, Any]:
    """Identify, and keep what it gave: `out/runs/*.csv`, `out/bus.log`, `out/result.json`, and the model file.

    The recordings and a result with the reasons are written even where the plant was not identified; the model file only where
    it was.

    Returns:
        What result.json holds.

    Raises:
        NotPossibleError: The bus does not carry the run; nothing has been sent.
        HilError: As `PlantIdentification`.
        ChannelError: The bus is not there, or was lost.
        FileError: The model file is not one, or cannot be written.
    """
    (out / "runs").mkdir(parents=True, exist_ok=True)
    opened = channel or open_channel(parse_address(bench.bus.address))
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    kept: dict[str, Any] = {
        "schema": SCHEMA,
        "kind": "identify plant",
        "bench": {"name": bench.name, "bus": bench.bus.address, "started_utc": started, "file": bench.model_dump(mode="json")},
        "axis": request.axis,
        "request": asdict(request),
    }
    identification: PlantIdentification | None = None
    not_restored: list[str] = []
    try:
        if not overload:
            _check_load(bench, opened, request.axis)
        with Session(bench, opened, BusLog(out / "bus.log", opened.address.interface), progress) as session:
            not_restored = session.not_restored
            session.bring_up()
            identification = PlantIdentification(session, request, announce)
            evaluated = identification.perform()
        entry = evaluated.identified(f"identified {started}, {evaluated.kind} excitation of {evaluated.amplitude_nm:.3g} N·m")
        kept |= document(evaluated) | {"identified": entry.model_dump(mode="json")}
        if model is not None:
            update_file(model, bench.name, request.axis, entry)
            kept["model_file"] = str(model)
    except NotIdentifiedError as error:
        kept["not_identified"] = list(error.reasons)
        raise
    except SafetyStopError as error:
        kept["stopped"] = str(error)
        raise
    finally:
        if channel is None:
            opened.close()
        if identification is not None:
            kept["checks"] = [asdict(check) for check in identification.checks]
            kept["remarks"] = list(identification.remarks)
            kept["recordings"] = {}
            for name, recording in identification.recordings.items():
                path = out / "runs" / f"identify-plant-axis{request.axis}-{name}.csv"
                recording.save(path)
                kept["recordings"][name] = path.relative_to(out).as_posix()
            if not_restored:
                kept["not_restored"] = not_restored
            write_json(out / "result.json", kept)
    return kept


def _check_load(bench: Bench, channel: Channel, axis: int) -> None:
    """Refuse what does not fit between two SYNCs, where the bit rate is known."""
    if channel.address.bitrate is None:
        return
    from hil.master.plan_check import check  # noqa: PLC0415 - a bus without bit times does not need it

    where = bench.model_copy(update={"bus": bench.bus.model_copy(update={"address": str(channel.address)})})
    period_s = bench.bus.sync_period_s
    verdict = check(where, (axis,), "drive", period_s, with_notch=False)
    if verdict.fits is False:
        raise NotPossibleError(f"a run of axis {axis} at a SYNC period of {1e3 * period_s:g} ms: {verdict.sentence} (--overload)")


def document(evaluated: Evaluated) -> dict[str, Any]:
    """The result as JSON: SI units, every number with its standard error."""
    estimate, friction, travel = evaluated.estimate, evaluated.friction, evaluated.travel
    parameters = {name: asdict(parameter) for name, parameter in estimate.parameters.items()}
    for name in ("coulomb_nm", "viscous_nm_s_rad", "gravity_moment_nm", "gravity_phase_deg"):
        parameters[f"friction_{name}" if "gravity" not in name else name] = asdict(getattr(friction, name))
    return {
        "plan": {
            "excitation": evaluated.kind,
            "amplitude_nm": evaluated.amplitude_nm,
            "crest_factor": travel.wave.crest_factor,
            "bias_rps": travel.bias_rps,
            "period_s": travel.wave.period_s,
            "periods": estimate.periods,
            "travel_rev": [travel.low_rev, travel.high_rev],
        },
        "plant": asdict(estimate.plant),
        "parameters": parameters,
        "misfit": estimate.misfit,
        "cannot_tell": list(evaluated.cannot_tell),
        "response": _response(estimate.response),
        "tip_response": None if estimate.tip is None else _response(estimate.tip),
        "friction": {
            "residual_nm": friction.residual_nm,
            "arm_span_deg": friction.arm_span_deg,
            **{
                name: getattr(friction, name).tolist()
                for name in ("speed_rad_s", "arm_angle_rad", "torque_nm", "model_nm", "gravity_nm")
            },
        },
    }


def _response(response: Response) -> dict[str, list[float]]:
    return {
        "frequency_hz": response.frequency_hz.tolist(),
        "real": response.value.real.tolist(),
        "imaginary": response.value.imag.tolist(),
        "deviation": response.deviation.tolist(),
        "radius": response.radius.tolist(),
        "coherence": response.coherence.tolist(),
    }
