"""Entries of result.json for the fits."""

from collections.abc import Sequence

from hil.control.angles import ARCSEC
from hil.design.recorded.fit import SectionFit
from hil.design.recorded.fixed_lines import FixedFrequency
from hil.design.recorded.joint import values_of
from hil.design.recorded.scan import FALSE_ALARM, BlindScan
from hil.experiments.ate.recorded.request import FoundStretch
from hil.recordings.reading import Recorded
from hil.results.recorded_ate import FixedLine, OrderEntry, RecordedFile, RecordedStretch, ScanEntry, ScanPeak


def file_entry(each: Recorded, clock: str | None = None) -> RecordedFile:
    """Entry of a recording."""
    columns = tuple(column.words + (", by its name" if column.is_guessed else "") for column in each.column.values())
    return RecordedFile(
        path=str(each.path), columns=columns, rows=len(each.time_s), duration_s=float(each.time_s[-1]), period_s=each.period_s,
        jitter_s=each.jitter_s, clock=clock,
    )  # fmt: skip


def stretch_entry(each: FoundStretch, fit: SectionFit) -> RecordedStretch:
    """Entry of a stretch or a part, with its orders."""
    values, stretch = tuple(OrderEntry(order=order, **vars(value)) for order, value in values_of(fit).items()), each.stretch
    return RecordedStretch(
        file=each.file, direction=stretch.direction, turns=stretch.turns, speed_rps=stretch.speed_rps, from_s=stretch.from_s,
        to_s=stretch.to_s, degree=fit.degree, values=values,
    )  # fmt: skip


def scan_entry(scan: BlindScan, lines: Sequence[FixedFrequency], scale: float) -> ScanEntry:
    """Convert a blind scan to its entry.

    Its amplitudes are in arcsec of the joint; those of lines are in the unit of the signal.

    `scale` is the unit of the signal.
    """

    def peak(order: float, amplitude: float, level: float) -> ScanPeak:
        return ScanPeak(order=round(order, 3), amplitude=amplitude / ARCSEC, level=level / ARCSEC)

    top = scan.highest
    return ScanEntry(
        unit="arcsec",
        false_alarm=FALSE_ALARM,
        highest=peak(top.order, top.amplitude, top.level),
        peaks=tuple(peak(each.order, each.amplitude, each.level) for each in scan.peaks[:20]),
        lines=tuple(FixedLine(hz=each.hz, order=each.order, amplitude=each.amplitude / scale) for each in lines),
    )
