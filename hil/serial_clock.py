"""When the samples of a serial accelerometer were taken, and what it measured at a SYNC; sans IO, seconds of any one clock."""

import math
from bisect import bisect_right
from collections import deque
from typing import Literal

from hil.serial_framing import Sample, Vector

AtSync = Literal["latest", "interpolated"]

PHASE_SAMPLES = 64
"""Arrivals among which the least late one tells the sensor's phase."""
MAX_SAMPLES = 1024
"""Samples that are kept; older ones give way."""


class SampleClock:
    """Times of samples that arrive late, in bursts, and now and then not at all.

    A sample cannot arrive before it was taken, and the sensor's period is known. So of the arrivals a_j of the last
    `PHASE_SAMPLES` samples, counted by k, the least late one fixes the phase: t_k = k T + min_j (a_j − j T). An operating system
    that hands over eight samples at once, or one late, so does not move them. Times never go back: t_k ≥ t_{k−1}, and
    t_k ≤ a_k.

    A lost sample is counted by the sensor's counter, if it sends one. Without, the samples behind a loss are dated too early by a
    period until the window has passed.

    Attributes:
        lost: Samples that the sensor's counter says have not arrived.
    """

    def __init__(self, rate_hz: float, counter_modulo: int | None = None) -> None:
        """Nothing has arrived.

        Args:
            rate_hz: Samples per second, as the sensor's data sheet has it.
            counter_modulo: Where the sensor's counter begins anew; None where it has none.
        """
        self.lost = 0
        self._period_s = 1.0 / rate_hz
        self._modulo = counter_modulo
        self._counter: int | None = None
        self._number = 0
        self._phases: deque[float] = deque(maxlen=PHASE_SAMPLES)
        self._last_s = self._last_arrival_s = -math.inf

    def time_s(self, arrival_s: float, counter: int | None = None) -> float:
        """When the sample was taken that arrived now; arrivals do not go back."""
        arrival_s = max(arrival_s, self._last_arrival_s)
        step = self._step(counter)
        if arrival_s - self._last_arrival_s > PHASE_SAMPLES * self._period_s:
            self._phases.clear()  # it was silent: its clock may be another
        self._last_arrival_s = arrival_s
        self._number += step
        self._phases.append(arrival_s - self._number * self._period_s)
        self._last_s = max(self._last_s, self._number * self._period_s + min(self._phases))
        return self._last_s

    def _step(self, counter: int | None) -> int:
        """Samples since the last one, as the sensor counts; a jump by half its range or more is a restart."""
        before, self._counter = self._counter, counter
        if counter is None or before is None or self._modulo is None:
            return 1
        step = (counter - before) % self._modulo
        if not 0 < step < min(self._modulo // 2, 10 * MAX_SAMPLES):
            self._phases.clear()
            return 1
        self.lost += step - 1
        return step


class SampleHistory:
    """The last samples with their times, and what was measured at an instant among them."""

    def __init__(self) -> None:
        """Empty."""
        self._times: list[float] = []
        self._values: list[Vector] = []

    def add(self, time_s: float, sample: Sample) -> None:
        """Keep a sample; times do not go back."""
        if len(self._times) >= 2 * MAX_SAMPLES:
            del self._times[:MAX_SAMPLES], self._values[:MAX_SAMPLES]
        self._times.append(time_s)
        self._values.append(sample.acceleration_m_s2)

    def at(self, instant_s: float, how: AtSync, max_age_s: float) -> Vector | None:
        """What was measured at an instant.

        Args:
            instant_s: Of the SYNC.
            how: `latest`: the newest sample that was taken by then. `interpolated`: between it and the one behind, where that has
                come already; else the latest.
            max_age_s: A sample older than this at the instant says nothing about it.

        Returns:
            X, Y, Z in m/s², or None where there is no such sample.
        """
        behind = bisect_right(self._times, instant_s)
        if not behind or instant_s - self._times[behind - 1] > max_age_s:
            return None
        before_s, before = self._times[behind - 1], self._values[behind - 1]
        if how == "latest" or behind == len(self._times):
            return before
        after_s, after = self._times[behind], self._values[behind]
        if after_s - before_s > max_age_s:
            return before
        share = (instant_s - before_s) / (after_s - before_s)
        x, y, z = (a + share * (b - a) for a, b in zip(before, after, strict=True))
        return x, y, z
