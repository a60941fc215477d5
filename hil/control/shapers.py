"""Input shapers: impulses with which a set-point is convolved.

A mode that the set-point excites has died away when it ends.

A mode with the frequency ω and the damping ζ answers each impulse with a decaying wave. Impulses A_i at the times t_i, positive
and of the sum 1, leave of it, in parts of what one impulse at t = 0 would have left at the time t_n of the last,

    V(ω, ζ) = e^{−ζω t_n} √(C² + S²),   C, S = Σ A_i e^{ζω t_i} (cos, sin)(ω √(1 − ζ²) t_i)

All impulses are shapes of the undamped mode, weighted with e^{−ζω_0 t_i}: the waves of the damped mode then meet as those of the
undamped one do. Times are parts of the damped period T_d = 2π/(ω_0 √(1 − ζ²)).

Source: ZV and ZVD, V(ω, ζ): Singer and Seering, J. Dyn. Sys. Meas. Control 112(1), 1990. EI: Singhose, Seering and Singer,
J. Mech. Des. 116(2), 1994. Two-hump EI: Singhose, Porter, Tuttle and Singer, J. Dyn. Sys. Meas. Control 119(2), 1997. MZV: the
documentation of the printer firmware Klipper (resonance compensation).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hil.control.arrays import Real
from hil.control.treatments import ShaperName

EI_TOLERANCE = 0.05
"""Remaining vibration V that EI allows at the mode, and two-hump EI at both sides of it, to be below it in a wider range."""
MOST_SHAPED_DAMPING = 0.3
"""Damping ratio up to which a mode is shaped for: beyond it nothing rings."""


@dataclass(frozen=True)
class SwingingMode:
    """A mode that rings.

    Attributes:
        frequency_hz: Its undamped frequency ω_0/2π.
        damping: Its damping ratio ζ.
    """

    frequency_hz: float
    damping: float

    def __post_init__(self) -> None:
        """Refuse what does not ring."""
        if not (self.frequency_hz > 0.0 and math.isfinite(self.frequency_hz)):
            raise ValueError(f"a mode of {self.frequency_hz} Hz: its frequency must be above 0")
        if not 0.0 <= self.damping <= MOST_SHAPED_DAMPING:
            raise ValueError(f"a mode with the damping {self.damping}; a shaper needs 0 to {MOST_SHAPED_DAMPING:g}")

    @property
    def period_s(self) -> float:
        """Damped period T_d."""
        return 1.0 / (self.frequency_hz * math.sqrt(1.0 - self.damping**2))


def _two_hump_ei() -> list[float]:
    square = EI_TOLERANCE**2
    x = (square * (math.sqrt(1.0 - square) + 1.0)) ** (1.0 / 3.0)
    outer = (3.0 * x**2 + 2.0 * x + 3.0 * square) / (16.0 * x)
    return [outer, 0.5 - outer, 0.5 - outer, outer]


_SHAPES: dict[ShaperName, tuple[float, list[float]]] = {
    "zv": (0.5, [0.5, 0.5]),
    "zvd": (0.5, [0.25, 0.5, 0.25]),
    "mzv": (0.375, [1.0 - math.sqrt(0.5), 1.0 - 2.0 * (1.0 - math.sqrt(0.5)), 1.0 - math.sqrt(0.5)]),
    "ei": (0.5, [0.25 * (1.0 + EI_TOLERANCE), 0.5 * (1.0 - EI_TOLERANCE), 0.25 * (1.0 + EI_TOLERANCE)]),
    "two-hump-ei": (0.5, _two_hump_ei()),
}
"""Time between impulses in damped periods, and the impulses of the undamped mode."""

NAMES: tuple[ShaperName, ...] = tuple(_SHAPES)


@dataclass(frozen=True)
class Shaper:
    """Impulses of a shaper.

    Attributes:
        amplitudes: A_i, positive, of the sum 1.
        times_s: t_i, rising from 0.
    """

    amplitudes: tuple[float, ...]
    times_s: tuple[float, ...]

    @property
    def duration_s(self) -> float:
        """By how much a motion gets longer: t_n."""
        return self.times_s[-1]

    @property
    def delay_s(self) -> float:
        """Return the mean delay of a motion, Σ A_i t_i."""
        return float(np.dot(self.amplitudes, self.times_s))

    def then(self, other: "Shaper") -> "Shaper":
        """Both, one after the other: for two modes."""
        pairs = sorted(
            (t + u, a * b)
            for t, a in zip(self.times_s, self.amplitudes, strict=True)
            for u, b in zip(other.times_s, other.amplitudes, strict=True)
        )
        return Shaper(tuple(a for _, a in pairs), tuple(t for t, _ in pairs))

    def remaining(self, frequency_hz: Real | float, damping: float) -> Real:
        """Remaining vibration V of modes; of the shape of `frequency_hz`."""
        omega = 2.0 * math.pi * np.asarray(frequency_hz, dtype=np.float64)[..., np.newaxis]
        times, weights = np.array(self.times_s), np.array(self.amplitudes)
        waves = weights * np.exp(damping * omega * (times - self.duration_s))
        angle = omega * math.sqrt(1.0 - damping**2) * times
        return np.asarray(np.hypot(np.sum(waves * np.cos(angle), axis=-1), np.sum(waves * np.sin(angle), axis=-1)))

    def shaped(self, set_points: Real, period_s: float) -> Real:
        """Return set-points convolved with the impulses.

        Exact at the instants of SYNC for set-points that are straight in between.

        Each is a mean of earlier ones with weights A_i: no position, speed or acceleration goes beyond those without.

        Args:
            set_points: Set-points from a rest to a rest, a row per SYNC; shape (n,) or (n, axes).
            period_s: Time between them.

        Returns:
            Shape (n + m,) or (n + m, axes): m rows longer, the duration in periods, rounded up.
        """
        rows = np.asarray(set_points, dtype=np.float64)
        columns = rows[:, np.newaxis] if rows.ndim == 1 else rows
        at = np.arange(len(columns) + math.ceil(round(self.duration_s / period_s, 9)), dtype=np.float64)
        known, made = np.arange(len(columns), dtype=np.float64), np.zeros((len(at), columns.shape[1]))
        for weight, time_s in zip(self.amplitudes, self.times_s, strict=True):
            for number, column in enumerate(columns.T):
                made[:, number] += weight * (np.interp(at - time_s / period_s, known, column) - column[0])
        made += columns[0]
        return made[:, 0] if rows.ndim == 1 else made


def shaper(name: ShaperName, mode: SwingingMode) -> Shaper:
    """The impulses of a shaper for a mode.

    >>> shaper("zv", SwingingMode(10.0, 0.0))
    Shaper(amplitudes=(0.5, 0.5), times_s=(0.0, 0.05))
    """
    step, shape = _SHAPES[name]
    times = [step * i * mode.period_s for i in range(len(shape))]
    decay = 2.0 * math.pi * mode.frequency_hz * mode.damping
    weights = [a * math.exp(-decay * t) for a, t in zip(shape, times, strict=True)]
    whole = math.fsum(weights)
    return Shaper(tuple(a / whole for a in weights), tuple(times))


def shaper_for(name: ShaperName, modes: Sequence[SwingingMode]) -> Shaper:
    """The impulses for several modes: those of each, one after the other.

    Raises:
        ValueError: There is no mode.
    """
    if not modes:
        raise ValueError(f"{name} shaper: no mode given; expected at least one")
    made = shaper(name, modes[0])
    for mode in modes[1:]:
        made = made.then(shaper(name, mode))
    return made
