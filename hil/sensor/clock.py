"""Times of a serial accelerometer's samples, and its measurement at SYNC; pure."""

import math
from bisect import bisect_right
from collections import deque
from typing import Literal

from hil.sensor.framing import Sample, Vector

AtSync = Literal["latest", "interpolated"]

PHASE_SAMPLES = 64
"""Number of arrivals among which the least late one gives the sensor's phase."""
MAX_SAMPLES = 1024
"""Number of samples that are kept; older ones are dropped."""


class SampleClock:
    """Times of samples that arrive late, in bursts, or not at all.

    A sample cannot arrive before it was taken, and the sensor's period is known. So of the arrivals a_j of the last
    `PHASE_SAMPLES` samples, counted by k, the least late one fixes the phase: t_k = k T + min_j (a_j − j T). Samples that
    the operating system delivers late, or eight at once, do not change the phase. Times never go back: t_k ≥ t_{k−1}, and
    t_k ≤ a_k.

    The sensor's counter, if it sends one, shows lost samples. Without a counter, the samples behind a loss are dated a period too
    early until the window has passed.

    Attributes:
        lost: Samples that did not arrive, by the sensor's counter.
    """

    def __init__(self, rate_hz: float, counter_modulo: int | None = None) -> None:
        """Start without samples.

        Args:
            rate_hz: Samples per second, as the sensor's data sheet has it.
            counter_modulo: Count at which the sensor's counter starts again; None if it has none.
        """
        self.lost = 0
        self._period_s = 1.0 / rate_hz
        self._modulo = counter_modulo
        self._counter: int | None = None
        self._number = 0
        self._phases: deque[float] = deque(maxlen=PHASE_SAMPLES)
        self._last_s = self._last_arrival_s = -math.inf

    def time_s(self, arrival_s: float, counter: int | None = None) -> float:
        """Return the time of a sample arriving now; arrivals never go back."""
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
        """Count samples by the sensor's counter; half its range means a restart."""
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
    """The last samples with their times, for the measurement at an instant."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._values: list[Vector] = []

    def add(self, time_s: float, sample: Sample) -> None:
        """Keep a sample; times do not go back."""
        if len(self._times) >= 2 * MAX_SAMPLES:
            del self._times[:MAX_SAMPLES], self._values[:MAX_SAMPLES]
        self._times.append(time_s)
        self._values.append(sample.acceleration_m_s2)

    def at(self, instant_s: float, how: AtSync, max_age_s: float) -> Vector | None:
        """The measurement of an instant.

        Args:
            instant_s: Time of the SYNC.
            how: `latest`: the newest sample that was taken by then. `interpolated`: interpolation between it and the next
                one, if that has arrived; else the latest.
            max_age_s: Largest age of a sample at the instant; older ones do not count.

        Returns:
            X, Y, Z in m/s², or None without such a sample.
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
        fraction = (instant_s - before_s) / (after_s - before_s)
        x, y, z = (a + fraction * (b - a) for a, b in zip(before, after, strict=True))
        return x, y, z
