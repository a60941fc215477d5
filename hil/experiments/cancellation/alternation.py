"""Runs of a motion without a treatment and with it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hil.analysis import TipScale, band_passed, motor_speed_rps
from hil.bench.bench import Bench
from hil.control.arrays import Real
from hil.experiments.cancellation.waves import seen_rows
from hil.experiments.peaks import PeakChange, Windows
from hil.recording import Recording
from hil.reporter import SILENT, Reporter

TOP_SPEED = 0.98
"""Accuracy: part of the highest speed that a motion has before its last braking: from 10 rev/s with 20 rev/s², 10 ms late."""


@dataclass
class Alternation:
    """Collector of the tip's vibration in alternating runs.

    Attributes:
        run: Runs the motion, with the treatment or without.
        titles: Titles of a run without the treatment, and of one with it.
        period_s: Sampling period, once something has run.
    """

    bench: Bench
    scale: TipScale
    run: Callable[[bool], Recording]
    titles: tuple[str, str]
    reporter: Reporter = SILENT
    period_s: float = 0.0
    _bands: dict[bool, list[Real]] = field(default_factory=lambda: {False: [], True: []})
    _rows: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    _seen: Windows | None = None
    _whole: tuple[Windows, ...] = ()

    @property
    def count(self) -> int:
        """Runs of either kind."""
        return len(self._bands[True])

    def once_more(self) -> None:
        """Run the motion once without and once with the treatment.

        Raises:
            NotPossibleError: The motion does not excite the arm.
            HilError: As the runs.
        """
        suffix = ", once more, for the mean" if self.count else ""
        for acts in (False, True):
            self.reporter.step(f"{self.titles[acts]}{suffix}")
            recording = self.run(acts)
            if self._seen is None:
                self.period_s = recording.period_s
                self._rows = seen_rows(self.bench, recording, self.scale.f_al_hz)
                self._seen = Windows.of(recording, self._rows, self.scale)
                every = np.ones(len(self._rows), dtype=np.bool_)
                whole, until = Windows.of(recording, every, self.scale), _last_braking(recording)
                rows = {**whole.rows, None: every}
                before = {order: own & (np.arange(len(own)) < until) for order, own in rows.items()}
                before = {order: own for order, own in before.items() if np.any(own)}
                self._whole = replace(whole, rows=rows), replace(whole, rows=before)
            self._bands[acts].append(band_passed(recording.felt_m_s2, recording.period_s, self.scale.band_hz))

    def seen(self) -> list[PeakChange]:
        """Compare the peaks in the rows in which orders are read."""
        if self._seen is None:
            raise ValueError("nothing has run")
        without, with_it = ([band[self._rows[: len(band)]] for band in self._bands[acts]] for acts in (False, True))
        return self._seen.compared(without, with_it)

    def everywhere(self, shown: Callable[[Real], Real] | None = None, noise_mm: float | None = None) -> list[PeakChange]:
        """Compare the peaks over the whole motion.

        Args:
            shown: What is made of a vibration in m/s² before it is compared, in mm; over (2π f_al)² unless given.
            noise_mm: Standard deviation of the sensor's noise in that.
        """
        bands: dict[bool, Sequence[Real]] = dict(self._bands)
        spans = self._whole
        if shown is not None:
            bands = {acts: [shown(band) for band in each] for acts, each in bands.items()}
            spans = tuple(replace(each, to_mm=1.0, noise_mm=each.noise_mm if noise_mm is None else noise_mm) for each in spans)
        return [change for each in spans for change in each.compared(bands[False], bands[True])]

    @property
    def noise_m_s2(self) -> float:
        """Standard deviation of the sensor's noise in the band."""
        return self._whole[0].noise_mm / self._whole[0].to_mm


def _last_braking(recording: Recording) -> int:
    speed = np.max([np.abs(motor_speed_rps(recording, number)) for number in recording.axes], axis=0)
    return int(np.flatnonzero(speed > TOP_SPEED * np.max(speed))[-1])
