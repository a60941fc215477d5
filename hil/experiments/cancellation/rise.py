"""Comparison of the tip's peaks with and without a cancellation.

They are compared window by window; parts that raise a peak are not used.

An order may fall while the tip's peak in its window rises: on a soft arm the ramp's own start rings there too, and the order
may lessen it by chance. The peaks are those by which a run is judged, of the mean of all runs alike, and a rise counts beyond
what the sensor's noise explains.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.analysis import TipScale, motor_speed_rps
from hil.experiments.cancellation.effect import Part, Sighting
from hil.experiments.window import noise_variance
from hil.recording import Recording

Real = NDArray[np.float64]
Rows = NDArray[np.bool_]

WORSE_FRACTION, WORSE_MM = 0.05, 0.002
"""Rise of a peak that is harmless, whichever is more."""
RISE_SIGMAS, LAST_SIGMAS = 3.0, 1.0
"""Standard errors by which a rise stands, and those that are enough where no more runs are made."""
OPEN_SLACK = 0.3
"""Slack for peaks of which more runs are made."""
LEAST_ROWS = 8
"""Rows that a window must have."""


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
    def beyond_mm(self) -> float:
        """Rise beyond the tolerance; negative if there is none."""
        return self.after_mm - self.before_mm - max(WORSE_MM, WORSE_FRACTION * self.before_mm)

    def exceeds(self, sigmas: float) -> bool:
        """True if the rise exceeds the noise by so many standard errors."""
        return self.beyond_mm > max(0.0, sigmas * self.error_mm)

    @property
    def is_fall(self) -> bool:
        """True if the peak has fallen beyond noise and tolerance."""
        return self.before_mm - self.after_mm > max(WORSE_MM, WORSE_FRACTION * self.before_mm, LAST_SIGMAS * self.error_mm)

    @property
    def is_open(self) -> bool:
        """True if a rise is likely, and more runs could show it."""
        return self.exceeds(LAST_SIGMAS) and not self.exceeds(RISE_SIGMAS)

    @property
    def is_excluded(self) -> bool:
        """True if the noise leaves no room for a harmful rise."""
        return self.beyond_mm + LAST_SIGMAS * self.error_mm <= 0.0

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
class Look:
    """One run of a trial, with its cancellation and its vibration.

    Attributes:
        gains: Fraction of each part that acted.
        sighting: Its vibration and the waves in it.
    """

    gains: Mapping[Part, float]
    sighting: Sighting


@dataclass(frozen=True)
class Windows:
    """Windows in which the peaks of a motion are judged.

    Attributes:
        rows: Rows of each window among those that are read, by its order; None for the only one of a motion of several axes.
        to_mm: Factor from acceleration to displacement.
        noise_mm: Standard deviation of the sensor's noise in the band.
    """

    rows: Mapping[float | None, Rows]
    to_mm: float
    noise_mm: float

    @classmethod
    def of(cls, recording: Recording, read: Rows, scale: TipScale) -> "Windows":
        """Windows of a motion.

        Args:
            recording: One recording of it.
            read: Rows that are read; shape (n,).
            scale: Scale of its axes.
        """
        to_mm, band_hz = 1e3 / (2.0 * math.pi * scale.f_al_hz) ** 2, scale.band_hz[1] - scale.band_hz[0]
        passed = min(1.0, 2.0 * recording.period_s * band_hz)
        noise_mm = to_mm * math.sqrt(passed * noise_variance(recording.felt_m_s2, recording))
        if len(recording.axes) > 1 or not scale.windows_rps:
            return cls({None: np.ones(int(np.count_nonzero(read)), dtype=np.bool_)}, to_mm, noise_mm)
        speed = np.abs(motor_speed_rps(recording, recording.axes[0]))[read]
        rows: dict[float | None, Rows] = {}
        for order, (low, high) in scale.windows_rps.items():
            inside = np.asarray((speed >= low) & (speed <= high))
            if np.count_nonzero(inside) >= LEAST_ROWS:
                rows[order] = inside
        return cls(rows or {None: np.ones(len(speed), dtype=np.bool_)}, to_mm, noise_mm)

    def peaks_mm(self, vibration_m_s2: Real) -> dict[float | None, float]:
        """Largest displacement in each window."""
        tip = self.to_mm * np.abs(vibration_m_s2)
        return {order: float(tip[rows[: len(tip)]].max()) for order, rows in self.rows.items()}

    def compared(self, without: Sequence[Real], with_it: Sequence[Real]) -> list[PeakChange]:
        """Compare the peaks in each window, the worst rise first.

        Args:
            without: Vibration in the runs without it, in the band and the rows that are read.
            with_it: The same in those with it.
        """
        before, after = (self.peaks_mm(_mean(each)) for each in (without, with_it))
        error_mm = self.noise_mm * math.sqrt(1.0 / len(without) + 1.0 / len(with_it))
        found = [PeakChange(order, before[order], after[order], error_mm) for order in before]
        return sorted(found, key=lambda each: -each.beyond_mm)

    def rise(self, looks: Sequence[Look], used: Collection[Part]) -> PeakChange | None:
        """Worst rise of a window by the used parts, or None.

        None if no run has shown exactly these parts.

        Args:
            looks: All runs.
            used: Parts that are cancelled as a whole, and no others.
        """
        without, with_them = alike(looks, ()), alike(looks, used)
        if not without or not with_them:
            return None
        return next(iter(self.compared(_vibrations(without), _vibrations(with_them))), None)

    def riser(self, looks: Sequence[Look], used: Collection[Part], rise: PeakChange, slack: float = 0.0) -> Part | None:
        """Part whose removal lowers the rising window most, or None.

        None if the peaks of all windows together would rise too much.

        What a part has taken away is given back to the vibration as it was measured. That is not to make the peaks of all windows
        together larger; where the window rises beyond what the ramp itself makes in it, by no more than is harmless.

        Args:
            looks: All runs.
            used: Parts that are cancelled.
            rise: The rise.
            slack: Fraction by which they may be larger still, before the noise has been averaged.
        """
        without, with_them = alike(looks, ()), alike(looks, used)
        vibration = _mean(_vibrations(with_them))
        is_own = rise.after_mm <= (1.0 + WORSE_FRACTION) * self.jolt_mm(looks)[rise.order]
        most = sum(self.peaks_mm(vibration).values()) * (1.0 + slack + (0.0 if is_own else WORSE_FRACTION))
        best: tuple[float, Part] | None = None
        for part in used:
            there = complex(np.mean([look.sighting.amplitude[part] for look in without]))
            left = complex(np.mean([look.sighting.amplitude[part] for look in with_them]))
            wave = with_them[0].sighting.wave(part, there - left)
            count = min(len(wave), len(vibration))
            peaks = self.peaks_mm(vibration[:count] + wave[:count])
            if sum(peaks.values()) <= most and peaks[rise.order] < (best[0] if best else rise.after_mm):
                best = peaks[rise.order], part
        return None if best is None else best[1]

    def jolt_mm(self, looks: Sequence[Look]) -> dict[float | None, float]:
        """Largest displacement in each window without any order.

        It is what the motion itself and the noise cause.
        """
        rests = []
        for look in alike(looks, ()):
            seen = look.sighting
            waves = sum((seen.wave(part, size) for part, size in seen.amplitude.items()), np.zeros(len(seen.vibration)))
            rests.append(seen.vibration - waves)
        return self.peaks_mm(_mean(rests))


def alike(looks: Sequence[Look], used: Collection[Part]) -> list[Look]:
    """Runs in which exactly these parts acted with full gain."""
    return [look for look in looks if all(gain == float(part in used) for part, gain in look.gains.items())]


def _vibrations(looks: Sequence[Look]) -> list[Real]:
    return [look.sighting.vibration for look in looks]


def _mean(vibrations: Sequence[Real]) -> Real:
    """Mean of the vibration of runs of the same motion."""
    count = min(len(each) for each in vibrations)
    return np.asarray(np.mean([each[:count] for each in vibrations], axis=0))
