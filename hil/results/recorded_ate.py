"""Result of `hil identify ate --recording`: a transmission error."""

from typing import Literal

from pydantic import Field

from hil.bench.model import IdentifiedError
from hil.design.recorded.fixed_lines import FixedFrequency
from hil.design.recorded.scan import Peak
from hil.results.base import Result, ResultPart

Form = Literal["two encoders", "tip acceleration", "motor torque"]
"""Signals from which an error was identified, beside the motor angle."""
SIGNAL_UNIT: dict[Form, str] = {"two encoders": "arcsec", "tip acceleration": "m/s²", "motor torque": "N·m"}
"""Unit of map.csv and fit.csv."""


class RecordedFile(ResultPart):
    """A recording as it was read.

    Attributes:
        jitter_s: Range of the steps between time stamps, from the 1st to the 99th percentile.
        clock: Source of time: the stamps, even sampling, or the motor's angle; None if no time was needed.
    """

    path: str
    columns: tuple[str, ...]
    rows: int
    duration_s: float
    period_s: float
    jitter_s: float
    clock: str | None = None


class OrderEntry(ResultPart):
    """One order in one stretch; errors are standard errors."""

    order: float
    a_arcsec: float
    phi_deg: float
    a_error_arcsec: float
    phi_error_deg: float


class RecordedStretch(ResultPart):
    """A stretch of a recording, or a part of one.

    Attributes:
        file: Number of its file, from 0.
        speed_rps: Median of its speed.
        from_s: Its beginning, from the first row.
        degree: Degree of the slow part that was chosen.
    """

    file: int
    direction: int
    turns: float
    speed_rps: float
    from_s: float
    to_s: float
    degree: int
    values: tuple[OrderEntry, ...]


class OrderChange(ResultPart):
    """An order against itself in several stretches or parts.

    Attributes:
        widened: Factor by which the differences widen its standard errors.
        is_seen: True if noise does not explain them.
    """

    order: float
    probability: float
    widened: float
    phi_span_deg: float
    is_seen: bool


class ScanEntry(ResultPart):
    """Blind scan of the orders.

    The curve is in scan.csv, that over the speed in map.csv.

    Attributes:
        unit: Unit of the amplitudes: of the joint, through the arm for a sensor behind it.
        false_alarm: Probability with which noise alone reaches the level anywhere in the scan.
        highest: Highest order, above the level or not, with the level there; both in arcsec.
        peaks: Orders above the level, the highest first.
        lines: Lines at a fixed frequency that were taken out before.
    """

    unit: str
    false_alarm: float
    highest: Peak
    peaks: tuple[Peak, ...] = ()
    lines: tuple[FixedFrequency, ...] = ()


class RecordedAteResult(Result):
    """Result of an identification of the transmission error from recordings.

    Attributes:
        form: Signals that were used beside the motor angle.
        ratio_found: N as two encoders show it; None without them.
        parts: Parts of the stretches, in which a change is looked for.
        changes: Each order against itself in these parts.
        scan: Blind scan; None if nothing could be scanned.
        ate: Entry of the model file; None if nothing was identified.
        plant: Plant that made an angle of the signal, in words; None for two encoders.
    """

    kind: Literal["identify-ate-recording"] = "identify-ate-recording"
    robot: str
    axis: int
    started_utc: str
    versions: dict[str, str]
    form: Form
    reduction_ratio: float
    ratio_found: float | None = None
    orders: tuple[float, ...]
    files: tuple[RecordedFile, ...]
    stretches: tuple[RecordedStretch, ...] = ()
    parts: tuple[RecordedStretch, ...] = ()
    changes: tuple[OrderChange, ...] = ()
    scan: ScanEntry | None = None
    ate: IdentifiedError | None = None
    is_identified: bool = False
    notes: tuple[str, ...] = Field(default=())
    not_identified: str | None = None
    plant: str | None = None
