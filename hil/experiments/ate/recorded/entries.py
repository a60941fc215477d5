"""Entries of result.json for the fits."""

from collections.abc import Sequence

from hil.control.angles import ARCSEC
from hil.design.recorded.fit import SectionFit
from hil.design.recorded.fixed_lines import FixedFrequency
from hil.design.recorded.joint import Change, values_of
from hil.design.recorded.scan import FALSE_ALARM, BlindScan
from hil.experiments.ate.recorded.request import FoundStretch
from hil.recordings.reading import Recorded
from hil.results.recorded_ate import FixedLine, OrderChange, OrderEntry, RecordedFile, RecordedStretch, ScanEntry, ScanPeak


def file_entry(each: Recorded, clock: str | None = None) -> RecordedFile:
    """Entry of a recording."""
    return RecordedFile(
        path=str(each.path),
        columns=tuple(column.words + (", by its name" if column.is_guessed else "") for column in each.column.values()),
        rows=len(each.time_s),
        duration_s=float(each.time_s[-1]),
        period_s=each.period_s,
        jitter_s=each.jitter_s,
        clock=clock,
    )


def stretch_entry(each: FoundStretch, fit: SectionFit) -> RecordedStretch:
    """Entry of a stretch or a part, with its orders."""
    values = tuple(
        OrderEntry(
            order=order,
            a_arcsec=value.a_arcsec,
            phi_deg=value.phi_deg,
            a_error_arcsec=value.a_error_arcsec,
            phi_error_deg=value.phi_error_deg,
        )
        for order, value in values_of(fit).items()
    )
    stretch = each.stretch
    return RecordedStretch(
        file=each.file,
        direction=stretch.direction,
        turns=stretch.turns,
        speed_rps=stretch.speed_rps,
        from_s=stretch.from_s,
        to_s=stretch.to_s,
        degree=fit.degree,
        values=values,
    )


def change_entry(change: Change) -> OrderChange:
    """Entry of an order's change between the stretches."""
    return OrderChange(
        order=change.order,
        probability=change.probability,
        widened=change.widened,
        phi_span_deg=change.phi_span_deg,
        is_seen=change.is_seen,
    )


def scan_entry(scan: BlindScan, lines: Sequence[FixedFrequency], scale: float) -> ScanEntry:
    """Convert a blind scan to its entry.

    Its amplitudes are in arcsec of the joint; those of lines are in the unit of the signal.

    Args:
        scan: The scan.
        lines: Lines of a fixed frequency.
        scale: Size of the unit of the signal.
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
