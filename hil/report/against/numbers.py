"""Headline numbers of two results side by side."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from hil.report.against.alike import RunPair
from hil.report.material import Material, run_name, treatment_name, worst_of
from hil.report.order_names import symbol_of
from hil.report.report_table import NONE, Cell, ReportTable, number, with_error
from hil.results.ate import AteResult
from hil.results.plant import PARAMETERS, PlantResult
from hil.results.runs import RunEntry

CERTAIN = 2.0
"""Standard errors beyond which a difference is told: 5 of 100 that are none lie there."""


@dataclass(frozen=True)
class NumberPair:
    """A number of both results.

    Attributes:
        old: Value of the old result; None if it has none.
        is_angle: True if 360 is the same as 0.
    """

    group: str
    name: str
    unit: str
    old: float | None
    new: float | None
    old_error: float | None = None
    new_error: float | None = None
    is_angle: bool = False

    @property
    def difference(self) -> float | None:
        """New less old; of an angle the nearest."""
        if self.old is None or self.new is None or not math.isfinite(self.old) or not math.isfinite(self.new):
            return None
        found = self.new - self.old
        return (found + 180.0) % 360.0 - 180.0 if self.is_angle else found

    @property
    def error(self) -> float | None:
        """Standard error of the difference; None unless both values have one."""
        if self.difference is None or self.old_error is None or self.new_error is None:
            return None
        found = math.hypot(self.old_error, self.new_error)
        return found if found > 0.0 and math.isfinite(found) else None

    @property
    def is_beyond(self) -> bool | None:
        """True if the difference exceeds `CERTAIN` of its standard errors."""
        return None if self.error is None or self.difference is None else abs(self.difference) > CERTAIN * self.error


def run_numbers(pairs: tuple[RunPair, ...]) -> Iterator[NumberPair]:
    """Yield numbers of windows, those of a whole run once."""
    seen = set()
    for pair in pairs:
        new, old, group = pair.new, pair.old, pair_name(pair)
        yield NumberPair(group, "Tip peak", "mm", old.tip_peak_mm, new.tip_peak_mm)
        yield NumberPair(group, "Tip rms", "mm", old.tip_rms_mm, new.tip_rms_mm)
        errors = old.order_error_mm, new.order_error_mm
        yield NumberPair(group, "Order amplitude", "mm", old.order_mm, new.order_mm, *errors)
        yield NumberPair(group, "Spectrum peak", "m/s²", old.spectrum_peak_m_s2, new.spectrum_peak_m_s2)
        yield NumberPair(group, "Frequency of the spectrum peak", "Hz", old.spectrum_peak_hz, new.spectrum_peak_hz)
        yield NumberPair(group, "Spectrum area", "m/s²·Hz", old.spectrum_area, new.spectrum_area)
        if new.recording in seen:
            continue
        seen.add(new.recording)
        yield NumberPair(group, "Tip on the whole ramp", "mm", old.ramp_peak_mm, new.ramp_peak_mm)
        errors = old.f_al_error_hz, new.f_al_error_hz
        yield NumberPair(group, "f_al", "Hz", old.f_al_hz, new.f_al_hz, *errors)
        yield NumberPair(group, "Missed cycles", "", old.missed_cycles, new.missed_cycles)
        for name, own, other in zip(LATENESS, _lateness(new), _lateness(old), strict=True):
            yield NumberPair(group, name, "µs", other, own)


LATENESS = ("SYNC lateness, p99", "Largest SYNC lateness")


def _lateness(run: RunEntry) -> tuple[float | None, float | None]:
    if run.timing is None:
        return None, None
    p99_s, max_s = run.timing.lateness.p99_s, run.timing.lateness.max_s
    return (None if p99_s is None else 1e6 * p99_s), (None if max_s is None else 1e6 * max_s)


def model_numbers(new: Material, old: Material) -> Iterator[NumberPair]:
    """Yield f_al and the worst margins of each loop in both results."""
    for axis in sorted(set(new.model_axes) & set(old.model_axes)):
        group = f"axis {axis}: margins from the model, with the active filters"
        yield NumberPair(group, "f_al", "Hz", old.f_al_hz[axis], new.f_al_hz[axis])
        before, after = (worst_of(each.margins(axis, each.acting(axis)).values()) for each in (old, new))
        for name, unit, key in MARGINS:
            yield NumberPair(group, name, unit, getattr(before, key), getattr(after, key))


MARGINS = (
    ("Largest M_s", "", "sensitivity_peak"),
    ("Smallest gain margin", "dB", "gain_margin_db"),
    ("Smallest phase margin", "°", "phase_margin_deg"),
)


def error_numbers(new: AteResult, old: AteResult) -> Iterator[NumberPair]:
    """Yield the numbers of two transmission errors, if both have one."""
    if new.ate is None or old.ate is None:
        return
    group = f"axis {new.axis}: transmission error"
    own, other = ({each.name: each.value for each in part.numbers()} for part in (new.ate, old.ate))
    for name in dict.fromkeys((*own, *other)):
        text, _, unit = symbol_of(name).partition(" (")
        errors = old.ate.standard_error.get(name), new.ate.standard_error.get(name)
        is_angle = name.endswith("_deg")
        yield NumberPair(group, text, unit.removesuffix(")"), other.get(name), own.get(name), *errors, is_angle=is_angle)
    yield NumberPair(group, "Resonance of the arm", "Hz", old.ate.arm_hz, new.ate.arm_hz)
    yield NumberPair(group, "ζ of the arm", "", old.ate.damping, new.ate.damping)


def plant_numbers(new: PlantResult, old: PlantResult) -> Iterator[NumberPair]:
    """Parameters of two plants; none if one has no plant."""
    own, other = new.parameters or {}, old.parameters or {}
    for each in PARAMETERS:
        before, after = other.get(each.name), own.get(each.name)
        if before is not None and after is not None:
            values = each.scale * before.value, each.scale * after.value
            errors = each.scale * before.standard_error, each.scale * after.standard_error
            yield NumberPair(f"axis {new.axis}: plant", each.title, each.page_unit, *values, *errors)


def numbers_table(pairs: list[NumberPair]) -> ReportTable:
    """Tabulate pairs of numbers by group."""
    rows: list[list[Cell]] = []
    groups: dict[int, str] = {}
    for pair in pairs:
        if pair.old is None and pair.new is None:
            continue
        if not groups or list(groups.values())[-1] != pair.group:
            groups[len(rows)] = pair.group
        rows.append(
            [pair.name, with_error(pair.old, pair.old_error), with_error(pair.new, pair.new_error), pair.unit, *_told(pair)]
        )
    caption = (
        f"A difference is beyond chance if it exceeds {CERTAIN:g} of its standard errors. A number without a standard error is "
        "not judged: one run of each does not show how much runs differ."
    )
    header = ("", "old", "new", "unit", "difference", "beyond chance")
    return ReportTable("numbers", "Old and new", header, rows, {0, 3, 5}, caption, groups=groups)


def _told(pair: NumberPair) -> tuple[str, str]:
    difference, error = pair.difference, pair.error
    if difference is None:
        return NONE, NONE
    if error is None and difference == 0.0:
        return "0", NONE
    if error is None:
        percent = "" if not pair.old or pair.is_angle else f" ({100.0 * difference / abs(pair.old):+.1f} %)"
        return number(difference, "{:+.4g}") + percent.replace("-", "−"), NONE
    text = with_error(difference, error)
    told = f"{'yes' if pair.is_beyond else 'no'}: {abs(difference) / error:.1f} standard errors"
    return text if difference < 0.0 else f"+{text}", told


def pair_name(pair: RunPair) -> str:
    """Return the name of two runs' window, differences in brackets."""
    changed = [
        f"{before} → {after}"
        for before, after in (
            (treatment_name(pair.old.treatment), treatment_name(pair.new.treatment)),
            (f"{pair.old.loop}-closed", f"{pair.new.loop}-closed"),
        )
        if before != after
    ]
    return run_name(pair.new) + (f" ({'; '.join(changed)})" if changed else "")
