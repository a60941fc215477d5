"""The two laws that are compared with the observer.

Both know what the observer knows: the arm as one resonance, the band, the noise at rest, the bounds, and the window of k f_m.

- Filtered-x LMS: w_k is moved in every cycle by μ T 2 y f_k*/|f_k|², product and square low-passed, where f_k is what the
  order with d_k = 1 makes at the tip through the arm's model. Source: Widrow and Stearns, Adaptive Signal
  Processing (1985), chapter 11. μ is a quarter of the arm's own decay: more makes the envelope's loop swing.
- Repetition: once in each revolution of the motor w_k is moved by γ Σ y f_k* Δθ/Σ |f_k|² Δθ/2 over it. The samples are weighted
  by the angle between them, since they are not equidistant in it; what repeats is stored as its sines of the orders.
"""

import cmath
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from hil.control.following import ArmModel, Followed, FollowingSettings

BandPass = tuple[float, float, float, float, float]

LMS_OF_DECAY, LMS_MOST_PER_S = 0.25, 4.0
REPEATED = 0.5
"""γ, the part of what is left that a revolution takes away."""
SEEN_S = 0.15
"""Time over which filtered-x LMS looks whether there is anything to follow."""


class _Section:
    """One section of the band-pass for a complex signal."""

    def __init__(self, band: BandPass) -> None:
        self.band, self.first, self.second = band, 0j, 0j

    def __call__(self, value: complex) -> complex:
        b0, b1, b2, a1, a2 = self.band
        out = b0 * value + self.first
        self.first, self.second = b1 * value - a1 * out + self.second, b2 * value - a2 * out
        return out


class _Order:
    """An order, and its effect at the tip for d = 1."""

    def __init__(self, order: Followed, band: BandPass) -> None:
        self.order, self.factor = order, 1.0 + 0.0j
        self.sections = (_Section(band), _Section(band))
        self.x, self.v, self.before, self.made = 0j, 0j, 0j, 0j
        self.sum, self.weight = 0j, 0.0


class FollowerBase(ABC):
    """Common part of both laws."""

    def __init__(self, arm: ArmModel, orders: Sequence[Followed], band: BandPass, period_s: float) -> None:
        self._arm, self._period_s, self._set = arm, period_s, FollowingSettings()
        self._orders = [_Order(order, band) for order in orders]
        self._tip = (_Section(band), _Section(band))
        self._angle: float | None = None
        self._speed = self._slower = self._quiet = self._resting = self._turned = 0.0
        self._rests = 0
        self._jolts = (_Section(band), _Section(band))
        self._reference: float | None = None
        self._planned = self._shaken = self._shaking = self._jolted = 0.0

    def factors(self, row: int) -> Mapping[float, complex]:
        """Return the factors of the cancellation."""
        return {each.order.order: each.factor for each in self._orders}

    def step(
        self, angles_rad: list[float], references_rad: list[float], levers_m: list[float], acceleration_m_s2: float | None
    ) -> None:
        """Process one sample of one axis, as `FollowingLaw` does.

        Args:
            references_rad: Set-point of the motion alone.
        """
        angle, period, own = angles_rad[0], self._period_s, self._set
        last = angle if self._angle is None else self._angle
        blend = 1.0 - math.exp(-math.tau * own.speed_lowpass_hz * period)
        self._speed += blend * ((angle - last) / period - self._speed)
        self._slower += blend * (self._speed - self._slower)
        self._angle, speed = angle, 2.0 * self._speed - self._slower
        value: complex = acceleration_m_s2 or 0.0
        for section in self._tip:
            value = section(value)
        tip = value.real
        if abs(speed) < own.slowest_rad_s:
            self._rests += 1
            self._resting += (tip * tip - self._resting) * max(1.0 / self._rests, period / 0.15)
            if self._rests * period > 0.15 and (self._quiet == 0.0 or self._resting < self._quiet):
                self._quiet = self._resting
        self._jolt(references_rad[0], levers_m[0])
        for each in self._orders:
            self._make(each, angle, speed, levers_m[0])
        if abs(speed) >= own.slowest_rad_s:
            self._learn(tip, abs(speed), abs(angle - last))

    def _jolt(self, reference: float, lever_m: float) -> None:
        """Return the motion's own jolt, from its set-points."""
        arm, period = self._arm, self._period_s
        planned = 0.0 if self._reference is None else (reference - self._reference) / period
        value: complex = (planned - self._planned) / period / arm.reduction_ratio
        self._reference, self._planned = reference, planned
        for section in self._jolts:
            value = section(value)
        p, q, r, s = arm.a
        x, v = self._shaken, self._shaking
        self._shaken, self._shaking = p * x + q * v + arm.b[0] * value.real, r * x + s * v + arm.b[1] * value.real
        shakes = lever_m * (arm.stiff[2] * self._shaken + arm.stiff[3] * self._shaking)
        self._jolted = max(shakes**2, self._jolted * (1.0 - min(1.0, arm.stiff[1] * period)))

    def _make(self, each: _Order, angle: float, speed: float, lever_m: float) -> None:
        """Compute an order's effect at the tip for d = 1."""
        arm, own = self._arm, each.order
        _, _, b0, b1 = arm.stiff
        ratio = own.order * abs(speed) / (math.tau * arm.f_al_hz)
        size = -own.amplitude_rad * (own.order * speed) ** 2 if 0.5 < ratio < 2.6 else 0.0
        drive: complex = size * cmath.exp(1j * (own.order * (angle - speed * arm.delay_s) + own.phase_rad))
        for section in each.sections:
            drive = section(drive)
        middle, each.before = 0.5 * (drive + each.before), drive
        p, q, r, s = arm.a
        each.x, each.v = p * each.x + q * each.v + arm.b[0] * middle, r * each.x + s * each.v + arm.b[1] * middle
        each.made = lever_m * (b0 * each.x + b1 * each.v)

    @abstractmethod
    def _learn(self, tip: float, speed: float, turned: float) -> None:
        """Learn from a sample of the tip.

        The motor has a speed, and has turned by `turned` since the last sample.
        """

    def _may(self, each: _Order, left: complex, speed: float, seconds: float) -> bool:
        """Return True if the remainder is significant."""
        own, omega = self._set, each.order.order * speed
        ratio, size = omega / (math.tau * self._arm.f_al_hz), abs(each.made)
        if not own.low_ratio < ratio < own.high_ratio or size == 0.0:
            return False
        if self._jolted >= (own.jolt_part * max(abs(left), 0.1) * size) ** 2 or abs(left) < own.begin_part:
            return False
        noise = max(self._quiet, own.least_noise_m_s2**2) / max(1.0, 3.0 * self._arm.f_al_hz * seconds)
        return abs(left) > own.begin_sigmas * math.sqrt(2.0 * noise) / size and abs(left) * size / omega**2 > own.begin_m

    def _move(self, each: _Order, change: complex) -> None:
        """Move a factor within its bounds."""
        own, wanted = self._set, each.factor + change
        size, turn = min(max(abs(wanted), own.least_gain), own.most_gain), cmath.phase(wanted)
        each.factor = cmath.rect(size, min(max(turn, -own.most_angle_rad), own.most_angle_rad))


class FilteredLms(FollowerBase):
    """Filtered-x LMS in the motor's angle."""

    def _learn(self, tip: float, speed: float, turned: float) -> None:
        rate = min(LMS_OF_DECAY * 0.5 * self._arm.stiff[1], LMS_MOST_PER_S)
        for each in self._orders:
            part = min(1.0, self._period_s / SEEN_S)
            each.sum += part * (tip * each.made.conjugate() - each.sum)
            each.weight += part * (0.5 * abs(each.made) ** 2 - each.weight)
            if each.weight == 0.0:
                continue
            left = each.sum / each.weight
            if self._may(each, left, speed, SEEN_S):
                self._move(each, rate * self._period_s * left)


class Repetition(FollowerBase):
    """Repetitive control over the revolution of the motor."""

    def _learn(self, tip: float, speed: float, turned: float) -> None:
        self._turned += turned
        for each in self._orders:
            each.sum += tip * each.made.conjugate() * turned
            each.weight += 0.5 * abs(each.made) ** 2 * turned
        if self._turned < math.tau:
            return
        for each in self._orders:
            left = each.sum / each.weight if each.weight > 0.0 else 0j
            if self._may(each, left, speed, math.tau / speed):
                self._move(each, REPEATED * left)
            each.sum, each.weight = 0j, 0.0
        self._turned = 0.0
