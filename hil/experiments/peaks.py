"""Comparison of the tip's peaks without and with a treatment, window by window."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from hil.analysis import TipScale, motor_speed_rps
from hil.control.arrays import Real, Rows
from hil.design.notch_problem import WORSE_FRACTION, WORSE_MM
from hil.experiments.decision import Decision
from hil.experiments.window import noise_variance
from hil.recording import Recording

LEAST_ROWS = 8
"""Measured: rows that a window must have: the windows that 14 drawn robots (10700, 10712, 10730, 10735, 10740 to 10749) reach
have 21 at least."""


class PeakChange(NamedTuple):
    """Tip peak in a window, without and with a cancellation.

    Attributes:
        order: Order of the window; None if there is one window alone.
        before_mm: Peak without.
        after_mm: Peak with it.
        error_mm: Standard error of their difference, by the sensor's noise.
    """

    order: float | None
    before_mm: float
    after_mm: float
    error_mm: float

    @property
    def rises(self) -> Decision:
        """Claim that the peak rises by more than is harmless."""
        return Decision.of(self.beyond_mm, self.error_mm)

    @property
    def falls(self) -> Decision:
        """Claim that the peak falls by more than would be harmless as a rise."""
        return Decision.of(self.before_mm - self.after_mm - self.harmless_mm, self.error_mm)

    @property
    def beyond_mm(self) -> float:
        """Rise beyond what is harmless; negative if there is none."""
        return self.after_mm - self.before_mm - self.harmless_mm

    @property
    def harmless_mm(self) -> float:
        """Rise of the peak that is harmless."""
        return max(WORSE_MM, WORSE_FRACTION * self.before_mm)

    @property
    def words(self) -> str:
        """Change with its window, as a part of a sentence."""
        where = "" if self.order is None else f" in the window of order {self.order:g}"
        return f"the tip's peak{where} {self.change}"

    @property
    def change(self) -> str:
        """Change in words, without the window."""
        way = "rises" if self.after_mm > self.before_mm else "falls"
        return f"{way} from {self.before_mm:.4f} to {self.after_mm:.4f} ± {self.error_mm:.4f} mm"


@dataclass(frozen=True)
class Windows:
    """Windows in which the peaks of a motion are judged.

    Attributes:
        rows: Rows of each window among those that are read, by its order; None for the only one of a motion of several axes.
        to_mm: Factor from acceleration to displacement.
        noise_mm: Standard deviation of the sensor's noise in the band.
        swing: Rows of half a swing of the arm.
    """

    rows: Mapping[float | None, Rows]
    to_mm: float
    noise_mm: float
    swing: int = 0

    @classmethod
    def of(cls, recording: Recording, read: Rows, scale: TipScale) -> "Windows":
        """Windows of a motion.

        Args:
            recording: One recording of it.
            read: Rows that are read; shape (n,).
        """
        to_mm, band_hz = 1e3 / (2.0 * math.pi * scale.f_al_hz) ** 2, scale.band_hz[1] - scale.band_hz[0]
        passed = min(1.0, 2.0 * recording.period_s * band_hz)
        noise_mm = to_mm * math.sqrt(passed * noise_variance(recording.felt_m_s2, recording))
        if len(recording.axes) > 1 or not scale.windows_rps:
            return cls({None: np.ones(int(np.count_nonzero(read)), dtype=np.bool_)}, to_mm, noise_mm)
        period = 1.0 / scale.f_al_hz / recording.period_s
        # the orders shake the motor too, and windows are those of the motion
        speed = scipy.ndimage.gaussian_filter1d(np.abs(motor_speed_rps(recording, recording.axes[0])), 0.5 * period)[read]
        rows: dict[float | None, Rows] = {}
        for order, (low, high) in scale.windows_rps.items():
            inside = np.asarray((speed >= low) & (speed <= high))
            if np.count_nonzero(inside) >= LEAST_ROWS:
                rows[order] = inside
        return cls(rows or {None: np.ones(len(speed), dtype=np.bool_)}, to_mm, noise_mm, round(0.5 * period))

    def peaks_mm(self, vibration_m_s2: Real) -> dict[float | None, float]:
        """Largest displacement in each window."""
        tip = self.to_mm * np.abs(vibration_m_s2)
        return {order: float(tip[rows[: len(tip)]].max()) for order, rows in self.rows.items()}

    def compared(self, without: Sequence[Real], with_it: Sequence[Real]) -> list[PeakChange]:
        """Compare the peaks in each window, the worst rise first.

        Near the end of a window the tip may already grow towards the next one. Its largest swing is then the last, and a late
        sensor shows it behind the window. So each window is compared as it is, and with half a swing more at its end (but no
        row of another window); the worse of the two counts.

        Args:
            without: Vibration in the runs without it, in the band and the rows that are read.
            with_it: The same in those with it.
        """
        error_mm = self.noise_mm * math.sqrt(1.0 / len(without) + 1.0 / len(with_it))
        any_row = np.any(list(self.rows.values()), axis=0)
        longer = {order: rows | (_delayed(rows, self.swing) & ~any_row) for order, rows in self.rows.items()}
        means, found = (_mean(without), _mean(with_it)), []
        for windows in (self, replace(self, rows=longer)):
            before, after = (windows.peaks_mm(each) for each in means)
            found.append([PeakChange(order, before[order], after[order], error_mm) for order in before])
        worst = [max(each, key=lambda change: change.beyond_mm) for each in zip(*found, strict=True)]
        return sorted(worst, key=lambda each: -each.beyond_mm)

    def largest(self, without: Sequence[Real], with_it: Sequence[Real]) -> PeakChange:
        """Compare the largest peaks of all windows; the arguments are those of `compared`."""
        changes = self.compared(without, with_it)
        before, after = max(each.before_mm for each in changes), max(each.after_mm for each in changes)
        return PeakChange(None, before, after, changes[0].error_mm)


def _delayed(rows: Rows, count: int) -> Rows:
    """Rows with so many more behind each stretch of them."""
    return scipy.ndimage.binary_dilation(rows, np.r_[np.zeros(count), np.ones(count + 1)]) if count else rows


def _mean(vibrations: Sequence[Real]) -> Real:
    """Mean of the vibration of runs of the same motion."""
    count = min(len(each) for each in vibrations)
    return np.asarray(np.mean([each[:count] for each in vibrations], axis=0))
