"""Identification of the transmission error from recordings."""

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drive_profiles.standard.shown import measured
from hil.bench.bench import Bench
from hil.bench.model import SIGNIFICANT_SIGMAS, Identified, IdentifiedError, identified_axis
from hil.control.angles import ARCSEC
from hil.control.order_keys import amplitude_key, phase_key
from hil.design.ate.model import Arm
from hil.design.recorded.fit import AngleSection, SectionFit, fit_section, least_turns
from hil.design.recorded.fixed_lines import FixedFrequency, without_lines
from hil.design.recorded.joint import Change, JointFit, RecordedValue, joined, values_of, widened_by
from hil.design.recorded.order_columns import columns_of, scanned_orders
from hil.design.recorded.scan import FALSE_ALARM, BlindScan, Peak, order_scan
from hil.design.recorded.stretches import MotionStretch, parts_of, speed_of, stretches
from hil.design.recorded.swing import JointSwing
from hil.design.recorded.through_arm import RefinedArm
from hil.experiments.ate.recorded.curves import write_curves
from hil.experiments.ate.recorded.encoders import agreed_ratio, encoder_section, found_ratio, joint_swing
from hil.experiments.ate.recorded.request import (
    MOST_STRETCHES,
    ContradictedError,
    FoundStretch,
    RecordedAteError,
    RecordedRequest,
)
from hil.experiments.ate.recorded.sensed import SensedFiles, sensed_files
from hil.recordings.reading import Recorded, read_recording
from hil.results.base import RESULT_FILE, versions
from hil.results.recorded_ate import (
    Form,
    OrderChange,
    OrderEntry,
    RecordedAteResult,
    RecordedFile,
    RecordedStretch,
    ScanEntry,
)
from hil.robot_tables import TransmissionErrorTable

PART_TURNS = 1.25
"""Accuracy: revolutions of a part in which a change is looked for, by those from which a stretch tells its orders apart: a factor
of 2 changes nothing in four recordings."""
MOST_PARTS = 6
"""Accuracy: parts into which a stretch is cut, to see whether its error stays the same: a factor of 2 changes no value or error
in four recordings, and with 8 one order more is seen to change."""
SPEEDS_APART = 2.0
"""Accuracy: ratio of the speeds of two parts from which what two encoders show may be the arm's answer, which depends on the
speed: a factor of 2 changes nothing in four recordings; at any ratio errors of two of them were up to 3.8 times as large."""
TURNED_DEG = 30.0
"""Bound: difference of a phase behind which a feed-forward leaves half of the vibration: 2 sin(15°) = 0.52."""
NOT_ASKED = 0.1
"""Measured: distance from an order that was asked for within which a peak of the scan is that order: in a recording of a real
robot order 4 is at 3.95."""


@dataclass(frozen=True)
class _Fitted:
    """Fits of stretches and parts."""

    found: list[FoundStretch]
    fits: list[SectionFit]
    joint: JointFit
    parts: list[tuple[FoundStretch, SectionFit]]
    changes: dict[float, Change]


@dataclass(frozen=True)
class _Prepared:
    """Knowledge before the first fit.

    Attributes:
        form: Signal beside the motor angle.
        sensed: The recordings through the arm; None for two encoders.
        refined: The arm; None for two encoders.
        swing: Swing of the joint; None for a sensor, and if the recordings do not show it.
        ratio_found: Reduction ratio that two encoders show; None without them.
        chosen: Number of the file, file and stretch of all that are fitted.
    """

    files: list[Recorded]
    form: Form
    sensed: SensedFiles | None
    refined: RefinedArm | None
    swing: JointSwing | None
    ratio: float
    ratio_found: float | None
    chosen: list[tuple[int, Recorded, MotionStretch]]
    notes: list[str]

    def section(self, recorded: Recorded, stretch: MotionStretch) -> AngleSection:
        """Section of a stretch for the fit."""
        if self.sensed is None or self.refined is None:
            return encoder_section(recorded, stretch, self.ratio, 0.0 if self.swing is None else self.swing.per_hz2)
        return self.sensed.section(recorded, stretch, self.refined.arm)

    def moved(self, recorded: Recorded, stretch: MotionStretch) -> list[AngleSection]:
        """Sections of a stretch, each with one prior moved by its standard error."""
        if self.sensed is not None and self.refined is not None:
            return [self.sensed.section(recorded, stretch, arm) for arm in self.refined.steps]
        if self.swing is None:
            return []
        return [encoder_section(recorded, stretch, self.ratio, self.swing.per_hz2 + self.swing.error_per_hz2)]


def _prepared(request: RecordedRequest, bench: Bench | None, identified: Identified | None) -> _Prepared:
    """Read the recordings, and find their stretches, the ratio and the arm."""
    files = [read_recording(path, request.said, request.axis) for path in request.files]
    form = _form(files, request, is_told_by_joints=_tells_tip(request, bench, identified))
    notes = [f"{recorded.path.name}: {note}" for recorded in files for note in recorded.notes]
    sensed = None if form == "two encoders" else sensed_files(files, request, form, bench, identified)
    even = files if sensed is None else sensed.files
    moved = [(number, each, _stretches(each, sensed)) for number, each in enumerate(even)]
    turns = least_turns(request.orders)
    enough = [(number, recorded, [one for one in each if one.turns >= turns]) for number, recorded, each in moved]
    notes += _too_short(moved, enough, request)
    if sensed is None or bench is None:
        ratio, ratio_found, more = _ratio(enough, request)
        notes += more
    else:
        ratio, ratio_found = bench.axis[request.axis].reduction_ratio, None
    chosen = sorted(((n, each, one) for n, each, all_of in enough for one in all_of), key=lambda row: -row[2].turns)
    chosen = sorted(chosen[:MOST_STRETCHES], key=lambda row: (row[0], row[2].from_s))
    swing = joint_swing([(each, one) for _, each, one in chosen], ratio, request.orders) if sensed is None else None
    refined = None if sensed is None else sensed.refine([(n, one) for n, _, one in chosen], request.orders)
    return _Prepared(files, form, sensed, refined, swing, ratio, ratio_found, chosen, notes)


def identify_recorded(
    request: RecordedRequest, directory: Path, bench: Bench | None = None, identified: Identified | None = None
) -> RecordedAteResult:
    """Identify a transmission error from recordings.

    Args:
        bench: Bench with lever and plant for a sensor; None if two encoders need neither.
        identified: Model file with the plant; None without one.

    Raises:
        RecordingFileError: A recording cannot be read.
        ContradictedError: A recording contradicts its description, or lacks the plant that gives an angle.
        RecordedAteError: The recordings do not show the error.
    """
    ready = _prepared(request, bench, identified)
    files, form, sensed, refined = ready.files, ready.form, ready.sensed, ready.refined
    fitted = _fit(ready, request)
    scan, cleaned, lines = _scan(fitted)
    scale = ARCSEC if form == "two encoders" else 1.0
    speeds = [speed_of(each.section.angle_rad, _times(each)) for each in fitted.found]
    write_curves(directory, scan, cleaned, fitted.fits, speeds, scale)
    part = _entry(fitted.joint, files, refined, is_torque=form == "motor torque")
    notes = [*ready.notes, *_swing_notes(ready, fitted), *_notes(fitted, scan, lines, request)]
    result = RecordedAteResult(
        robot=request.said.robot or (request.files[0].name.split(".")[0] if bench is None else bench.name),
        axis=request.axis,
        started_utc=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        versions=versions(),
        form=form,
        reduction_ratio=ready.ratio,
        ratio_found=ready.ratio_found,
        orders=request.orders,
        files=tuple(
            _file_entry(each, None if sensed is None else sensed.clocks[number].words) for number, each in enumerate(files)
        ),
        stretches=tuple(_stretch_entry(each, fit) for each, fit in zip(fitted.found, fitted.fits, strict=True)),
        parts=tuple(_stretch_entry(each, fit) for each, fit in fitted.parts),
        changes=tuple(OrderChange(is_seen=each.is_seen, **vars(each)) for each in fitted.changes.values()),
        scan=_scan_entry(scan, lines, scale),
        ate=part,
        is_identified=_is_identified(fitted.joint),
        notes=tuple(notes),
        plant=None if sensed is None or refined is None else _arm_words(refined.arm, sensed.source),
    )
    result.write(directory / RESULT_FILE)
    return result


def _arm_words(arm: Arm, source: str) -> str:
    return (
        f"arm on its gear at {arm.resonance_hz:.2f} Hz, ζ = {arm.damping:.3f}, sensor {1e3 * arm.delay_s:.2f} ms late; started "
        f"from {source}, refined by the recordings"
    )


def _stretches(recorded: Recorded, sensed: SensedFiles | None) -> list[MotionStretch]:
    """Stretches of a recording; for a sensor, without the beginning of one that starts in motion."""
    found = stretches(recorded.motor_rad, recorded.time_s)
    return found if sensed is None else [each for one in found if (each := sensed.without_start(recorded, one)) is not None]


def _tells_tip(request: RecordedRequest, bench: Bench | None, identified: Identified | None) -> bool:
    """True if load encoders give the tip through a known plant."""
    if bench is None or request.axis not in bench.axis or not bench.accelerometer.from_load_encoders:
        return False
    return bench.axis[request.axis].model is not None or identified_axis(identified, request.axis).plant is not None


def _form(files: Sequence[Recorded], request: RecordedRequest, *, is_told_by_joints: bool) -> Form:
    """Choose the signal that all files have beside the motor angle.

    `is_told_by_joints`: the joint's encoder gives the tip through a known plant.
    """
    roles = set.intersection(*(set(each.column) for each in files))
    if "load" in roles and not request.sensorless and not (is_told_by_joints and "acceleration" in roles):
        return "two encoders"
    if "acceleration" in roles and not request.sensorless:
        return "tip acceleration"
    if "torque" in roles:
        return "motor torque"
    raise ContradictedError(
        f"{files[0].path}: no signal except the motor angle is in every file; one of joint angle, tip "
        "acceleration or motor torque is needed; name it, for example with --column load=NAME,UNIT"
    )


def _too_short(
    moved: Sequence[tuple[int, Recorded, list[MotionStretch]]],
    enough: Sequence[tuple[int, Recorded, list[MotionStretch]]],
    request: RecordedRequest,
) -> list[str]:
    """Sentences on files without a stretch that is long enough."""
    words = []
    for (_, recorded, all_of), (_, _, long) in zip(moved, enough, strict=True):
        if not long:
            longest = max((stretch.turns for stretch in all_of), default=0.0)
            words.append(
                f"{recorded.path.name}: the motor of axis {request.axis} turns {longest:.3g} revolutions one way at most"
            )
    if len(words) == len(moved):
        orders = ", ".join(f"{order:g}" for order in request.orders)
        raise RecordedAteError(
            f"{'; '.join(words)}: orders {orders} need {least_turns(request.orders):.3g} revolutions; move further without "
            "a stop, or give fewer --orders"
        )
    return [f"{word}; that is too few, so the file is left out" for word in words]


def _ratio(
    enough: Sequence[tuple[int, Recorded, list[MotionStretch]]], request: RecordedRequest
) -> tuple[float, float, list[str]]:
    """Reduction ratio, the one that the encoders show, and sentences on it."""
    given, found, notes = request.said.reduction_ratio, math.nan, []
    for _, recorded, each in enough:
        if each:
            found = found_ratio(recorded, each)
            given, note = agreed_ratio(given, found, recorded)
            notes += [note] if note else []
    if given is None:
        raise ContradictedError("the reduction ratio is not known; give it with --ratio")
    return given, found, notes


def _fit(ready: _Prepared, request: RecordedRequest) -> _Fitted:
    fits, kept, moves, problems = [], [], [], []
    for number, recorded, stretch in ready.chosen:
        section = ready.section(recorded, stretch)
        try:
            fit = fit_section(section, request.orders)
        except ValueError as error:
            problems.append(f"{recorded.path.name}, {stretch.from_s:.2f} s: {error}")
            continue
        fits.append(fit)
        kept.append(FoundStretch(number, recorded, stretch, section))
        if moved := ready.moved(recorded, stretch):  # the unknowns change with each prior, by its standard error
            first, *others = (fit_section(each, request.orders, repeats=0, degree=fit.degree) for each in (section, *moved))
            moves.append(np.column_stack([each.unknowns - first.unknowns for each in others]))
    if not fits:
        raise RecordedAteError("; ".join(problems))
    parts = []
    turns = PART_TURNS * least_turns(request.orders)
    for each in kept:
        for part in parts_of(each.stretch, each.recorded.motor_rad, each.recorded.time_s, turns, MOST_PARTS):
            section = ready.section(each.recorded, part)
            try:
                fit = fit_section(section, request.orders)
            except ValueError:  # a part may have too few samples where its stretch has enough
                continue
            parts.append((FoundStretch(each.file, each.recorded, part, section), fit))
    whole = joined(fits, moves or None)
    if len(parts) < 2:
        return _Fitted(kept, fits, whole, parts, {})
    by_part = joined([fit for _, fit in parts])
    speeds = [each.stretch.speed_rps for each, _ in parts]
    if ready.refined is None and max(speeds) > SPEEDS_APART * min(speeds):
        whole = widened_by(whole, by_part)
    return _Fitted(kept, fits, whole, parts, by_part.changes)


def _scan(fitted: _Fitted) -> tuple[BlindScan, list[AngleSection], list[FixedFrequency]]:
    """Blind scan of all stretches, without lines of a fixed frequency."""
    sections, lines = [each.section for each in fitted.found], []
    orders = scanned_orders()
    looks, signals = [], []
    columns = columns_of(sections, [fit.degree for fit in fitted.fits], orders)
    for place, (each, look) in enumerate(zip(fitted.found, columns, strict=True)):
        if look is not None:
            cleaned = without_lines(each.section, look, orders, _times(each))
            sections[place] = cleaned.section
            lines += cleaned.lines
            looks.append(look)
            signals.append(cleaned.signal)
    return order_scan(looks, signals, orders), sections, lines


def _times(each: FoundStretch) -> np.ndarray:
    """Time of the samples of a section; shape (n,)."""
    rows = each.recorded.time_s[each.stretch.rows]
    return np.interp(np.linspace(0.0, 1.0, len(each.section.signal)), np.linspace(0.0, 1.0, len(rows)), rows)


def _entry(joint: JointFit, files: Sequence[Recorded], refined: RefinedArm | None, *, is_torque: bool) -> IdentifiedError:
    errors: dict[str, float] = {}
    values = joint.values
    for order, value in values.items():
        errors |= {amplitude_key(order): value.a_error_arcsec, phase_key(order): value.phi_error_deg}
    phases = {order: value.phi_deg for order, value in values.items()}
    return IdentifiedError(
        values=TransmissionErrorTable.of({order: value.a_arcsec for order, value in values.items()}, phases),
        standard_error=errors,
        arm_hz=None if refined is None else refined.arm.resonance_hz,
        damping=None if refined is None else refined.arm.damping,
        accelerometer_delay_s=0.0 if refined is None or is_torque else refined.arm.delay_s,
        learnt_by="recording",
        note=f"from {', '.join(each.path.name for each in files)}",
    )


def _is_identified(joint: JointFit) -> bool:
    """True if an order exceeds the noise of one recording in 100.

    A²/2σ² > ln(orders/p)
    """
    sigmas = math.sqrt(2.0 * math.log(len(joint.values) / FALSE_ALARM))
    return any(each.a_arcsec >= max(sigmas, SIGNIFICANT_SIGMAS) * each.a_error_arcsec for each in joint.values.values())


def _is_significant(value: RecordedValue) -> bool:
    return value.a_arcsec >= SIGNIFICANT_SIGMAS * value.a_error_arcsec


def _swing_notes(ready: _Prepared, fitted: _Fitted) -> list[str]:
    """Describe what the joint of two encoders does beyond its gear."""
    if ready.sensed is not None:
        return []
    if ready.swing is not None:
        swing, at_most = ready.swing, ready.swing.highest_hz**2
        return [
            f"the joint swings {measured(100 * swing.per_hz2 * at_most, 100 * swing.error_per_hz2 * at_most)} % "
            f"wider at {swing.highest_hz:.1f} Hz than its gear moves it, as the different speeds show; the values are corrected "
            f"for that"
        ]
    seen = {order: value for order, value in fitted.joint.values.items() if _is_significant(value)}
    if not seen:
        return []
    turns = sum(each.stretch.turns for each in fitted.found)
    speed = sum(each.stretch.turns * each.stretch.speed_rps for each in fitted.found) / turns
    below = max(order * speed * math.sqrt(value.a_arcsec / value.a_error_arcsec) for order, value in seen.items())
    return [
        f"these are the amplitudes of the joint; if its arm rings below {below:.0f} Hz, the gear's amplitudes are smaller "
        "by more than a standard error; to identify those, record more slowly or at varying speeds"
    ]


def _notes(fitted: _Fitted, scan: BlindScan, lines: Sequence[FixedFrequency], request: RecordedRequest) -> list[str]:
    notes = []
    for order, change in fitted.changes.items():
        values = [values_of(fit)[order] for _, fit in fitted.parts]
        if change.is_seen and _is_significant(fitted.joint.values[order]):
            half = "; a feed-forward with one fixed phase leaves much of it" if change.phi_span_deg > TURNED_DEG else ""
            sizes = [value.a_arcsec for value in values]
            notes.append(
                f"order {order:g} changes: φ_{order:g} differs by up to {change.phi_span_deg:.0f}° and A_{order:g} from "
                f"{min(sizes):.1f} to {max(sizes):.1f} arcsec between {len(values)} parts (noise alone: "
                f"{change.probability:.1g}){half}"
            )
    for peak in scan.peaks:
        near = min(abs(peak.order - order) for order in request.orders)
        if near > max(NOT_ASKED, 1.0 / scan.turns) and peak.amplitude > peak.level:
            notes.append(f"order {peak.order:.2f} exceeds the noise but was not asked for; add it with --orders")
    notes += [
        f"a line at {line.hz:.1f} Hz, order {line.order:.2f} at most of the speeds, has a fixed frequency, so it does not come "
        f"from the gear"
        for line in lines
    ]
    weak = [f"{order:g}" for order, value in fitted.joint.values.items() if not _is_significant(value)]
    if weak:
        notes.append(f"order {', '.join(weak)}: below {SIGNIFICANT_SIGMAS:g} standard errors, which noise alone can reach")
    return notes


def _file_entry(each: Recorded, clock: str | None = None) -> RecordedFile:
    columns = tuple(column.words + (", by its name" if column.is_guessed else "") for column in each.column.values())
    return RecordedFile(
        path=str(each.path), columns=columns, rows=len(each.time_s), duration_s=float(each.time_s[-1]), period_s=each.period_s,
        jitter_s=each.jitter_s, clock=clock,
    )  # fmt: skip


def _stretch_entry(each: FoundStretch, fit: SectionFit) -> RecordedStretch:
    values, stretch = tuple(OrderEntry(order=order, **vars(value)) for order, value in values_of(fit).items()), each.stretch
    return RecordedStretch(
        file=each.file, direction=stretch.direction, turns=stretch.turns, speed_rps=stretch.speed_rps, from_s=stretch.from_s,
        to_s=stretch.to_s, degree=fit.degree, values=values,
    )  # fmt: skip


def _scan_entry(scan: BlindScan, lines: Sequence[FixedFrequency], scale: float) -> ScanEntry:
    """Convert a blind scan to its entry.

    Its amplitudes are in arcsec of the joint; those of lines are in the unit of the signal.

    `scale` is the unit of the signal.
    """

    def peak(each: Peak) -> Peak:
        return Peak(round(each.order, 3), each.amplitude / ARCSEC, each.level / ARCSEC)

    return ScanEntry(
        unit="arcsec",
        false_alarm=FALSE_ALARM,
        highest=peak(scan.highest),
        peaks=tuple(map(peak, scan.peaks[:20])),
        lines=tuple(replace(each, amplitude=each.amplitude / scale) for each in lines),
    )
