"""The variable notch filter: its coefficients at one speed, and the filter that follows the motor; and a fixed filter."""

import math
from dataclasses import dataclass, fields
from typing import Any, Protocol

from numpy.typing import NDArray

from hil.control.compiled import inlined
from hil.control.records import record_dtype

NOTCH_OFF, NOTCH_SWITCHED, NOTCH_TRAPEZOID = 0, 1, 2
"""ζ_rd over the motor speed: no filter; ζ_rdth inside [f_s, f_e]; a trapezoid that rises and falls over `ramp_rps`."""

NOTCH_FIXED = 3
"""Mode of a second-order section with given coefficients at every speed, as drives without the variable notch have it."""

NOTCHES = 2
"""Filters per axis, in series: one per harmonic order of the transmission error."""


class NotchConfigRow(Protocol):
    """Parameters of one filter as the compiled law reads them: those of `Notch`, then those of `FixedFilter`."""

    mode: int
    order: float
    start_rps: float
    end_rps: float
    offset_hz: float
    zeta_rn: float
    zeta_rdth: float
    hysteresis_rps: float
    speed_lowpass_hz: float
    ramp_rps: float
    b0: float
    b1: float
    b2: float
    a1: float
    a2: float


class NotchStateRow(Protocol):
    """Memory of one filter.

    s1, s2: two delays, transposed direct form II; speed_rps: f_m, the low-passed speed; mean_nm: the low-passed torque; active:
    1 while the filter acts; frequency_hz and zeta_rd: zero frequency and pole damping at present.
    """

    s1: float
    s2: float
    speed_rps: float
    mean_nm: float
    active: int
    frequency_hz: float
    zeta_rd: float


NOTCH_CONFIG = record_dtype(NotchConfigRow)
NOTCH_STATE = record_dtype(NotchStateRow)

START_LOWPASS_HZ = 20.0
"""Corner of the low-pass that gives the torque on which a filter starts.

A coarse encoder makes the torque command noisy. Started on one noisy sample the filter takes that sample's error for a
step: 0.013 mm at the tip with 13 bits and no transmission error at all, 0.003 mm from the low-passed torque (corners
from 10 to 50 Hz do equally well; below 5 Hz the lag of the mean shows, 0.005 mm and more).
"""


@dataclass(frozen=True)
class Notch:
    """The variable notch filter of one harmonic order k, eq. (6), (7) and Table 3 of the paper.

    Attributes:
        mode: `NOTCH_OFF`, `NOTCH_SWITCHED` or `NOTCH_TRAPEZOID`.
        order: k, so that ω_rn = 2π k f_m.
        start_rps: f_s, the motor speed from which the filter acts.
        end_rps: f_e, the motor speed up to which it acts.
        offset_hz: ω_d / 2π, the pole frequency above the zero frequency.
        zeta_rn: Damping of the zeros.
        zeta_rdth: Damping of the poles inside [f_s, f_e].
        hysteresis_rps: Distance by which the speed must leave [f_s, f_e] before the filter is taken out.
        speed_lowpass_hz: Corner of the first-order low-pass that gives f_m from the measured speed.
        ramp_rps: Width of either slope of the trapezoid.

    Raises:
        ValueError: A parameter outside its range, with the value.
    """

    mode: int = NOTCH_SWITCHED
    order: int = 2
    start_rps: float = 4.0
    end_rps: float = 9.0
    offset_hz: float = 0.5
    zeta_rn: float = 0.028
    zeta_rdth: float = 0.1
    hysteresis_rps: float = 0.15
    speed_lowpass_hz: float = 50.0
    ramp_rps: float = 1.0

    def __post_init__(self) -> None:
        """Refuse values that do not make a filter."""
        if self.mode not in (NOTCH_OFF, NOTCH_SWITCHED, NOTCH_TRAPEZOID):
            raise ValueError(f"notch mode {self.mode} is none of 0 (off), 1 (switched), 2 (trapezoid)")
        if not 1 <= self.order <= 8:
            raise ValueError(f"notch order {self.order} is not within 1 … 8")
        if not 0.0 < self.start_rps < self.end_rps:
            raise ValueError(f"notch range {self.start_rps} … {self.end_rps} rev/s must rise from above 0")
        for name in ("zeta_rn", "zeta_rdth", "speed_lowpass_hz", "ramp_rps"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"notch {name} = {getattr(self, name)} must be above 0")
        for name in ("offset_hz", "hysteresis_rps"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"notch {name} = {getattr(self, name)} must not be below 0")
        # at f_m = 0 the filter's gain (ω_rd/ω_rn)² has no bound: it must be out before the motor stands
        if not self.hysteresis_rps < self.start_rps:
            raise ValueError(f"notch hysteresis_rps = {self.hysteresis_rps} must be below start_rps = {self.start_rps}")

    def write(self, row: NDArray[Any]) -> None:
        """Put the parameters into one record of a `NOTCH_CONFIG` array."""
        for field in fields(self):
            row[field.name] = getattr(self, field.name)


NO_NOTCH = Notch(mode=NOTCH_OFF)


@dataclass(frozen=True)
class FixedFilter:
    """A filter that does not follow the speed: y_n = b₀ u_n + b₁ u_{n−1} + b₂ u_{n−2} − a₁ y_{n−1} − a₂ y_{n−2}.

    Raises:
        ValueError: A coefficient that is not finite, or poles on or outside the unit circle.
    """

    b0: float
    b1: float
    b2: float
    a1: float
    a2: float

    def __post_init__(self) -> None:
        """Refuse an unstable filter."""
        for field in fields(self):
            if not math.isfinite(getattr(self, field.name)):
                raise ValueError(f"filter coefficient {field.name} = {getattr(self, field.name)} is not finite")
        # Jury's criterion; it also makes 1 + a₁ + a₂, which the gain at rest divides by, greater than 0
        if not (abs(self.a2) < 1.0 and abs(self.a1) < 1.0 + self.a2):
            raise ValueError(f"filter with a1 = {self.a1}, a2 = {self.a2} is not stable")

    def write(self, row: NDArray[Any]) -> None:
        """Put the filter into one record of a `NOTCH_CONFIG` array."""
        row["mode"] = NOTCH_FIXED
        for field in fields(self):
            row[field.name] = getattr(self, field.name)


@inlined
def notch_coefficients(
    zero_hz: float, pole_hz: float, zeta_rn: float, zeta_rd: float, period_s: float
) -> tuple[float, float, float, float, float]:
    """Coefficients b₀, b₁, b₂, a₁, a₂ of the notch, by the bilinear transform without prewarping.

    F_n(s) = (s² + 2 ζ_rn ω_rn s + ω_rn²) / (s² + 2 ζ_rd ω_rd s + ω_rd²) · ω_rd² / ω_rn²,  F_n(0) = 1,
    s = 2/T · (1 − z⁻¹)/(1 + z⁻¹),  y_n = b₀ u_n + b₁ u_{n−1} + b₂ u_{n−2} − a₁ y_{n−1} − a₂ y_{n−2}.

    Args:
        zero_hz: ω_rn / 2π.
        pole_hz: ω_rd / 2π.
        zeta_rn: Damping of the zeros.
        zeta_rd: Damping of the poles.
        period_s: Sampling time T.

    Source: the paper, eq. (6); bilinear transform from its section 5.1.
    """
    c = 2.0 / period_s
    wn = 2.0 * math.pi * zero_hz
    wd = 2.0 * math.pi * pole_hz
    gain = wd * wd / (wn * wn)
    n0, n1, n2 = gain * wn * wn, gain * 2.0 * zeta_rn * wn * c, gain * c * c
    d0, d1, d2 = wd * wd, 2.0 * zeta_rd * wd * c, c * c
    a0 = d2 + d1 + d0
    return (
        (n2 + n1 + n0) / a0,
        2.0 * (n0 - n2) / a0,
        (n2 - n1 + n0) / a0,
        2.0 * (d0 - d2) / a0,
        (d2 - d1 + d0) / a0,
    )


@inlined
def notch_weight(mode: int, speed_rps: float, start_rps: float, end_rps: float, ramp_rps: float) -> float:
    """Weight of the filter at a speed, 0 … 1: always 1 where it switches, the height of the trapezoid where it has slopes.

    Args:
        mode: `NOTCH_SWITCHED` or `NOTCH_TRAPEZOID`.
        speed_rps: f_m.
        start_rps: f_s.
        end_rps: f_e.
        ramp_rps: Width of either slope.
    """
    if mode != NOTCH_TRAPEZOID:
        return 1.0
    rise = (speed_rps - start_rps) / ramp_rps
    fall = (end_rps - speed_rps) / ramp_rps
    return max(0.0, min(1.0, rise, fall))


@inlined
def lowpass_blend(corner_hz: float, period_s: float) -> float:
    """The fraction of the new sample in a first-order low-pass x += blend (u − x); 1 where the corner is beyond reach."""
    w = math.pi * corner_hz * period_s
    return min(1.0, 2.0 * w / (1.0 + w))


@inlined
def _fixed_step(c: NotchConfigRow, s: NotchStateRow, u: float) -> float:
    """One sample of a fixed filter; it starts as if the low-passed torque ū had been its input for ever, ȳ = G(1) ū."""
    if s.active == 0:
        rest = (c.b0 + c.b1 + c.b2) / (1.0 + c.a1 + c.a2) * s.mean_nm
        s.s2 = c.b2 * s.mean_nm - c.a2 * rest
        s.s1 = c.b1 * s.mean_nm - c.a1 * rest + s.s2
        s.active = 1
    y = c.b0 * u + s.s1
    s.s1 = c.b1 * u - c.a1 * y + s.s2
    s.s2 = c.b2 * u - c.a2 * y
    return float(y)


@inlined
def notch_step(c: NotchConfigRow, s: NotchStateRow, period_s: float, speed_rad_s: float, u: float) -> float:
    """One sample of the filter: follow the speed, switch with hysteresis, filter the torque command. A fixed one is always on.

    f_m = |θ̇_m| / 2π behind a first-order low-pass; ω_rn = 2π k f_m; ω_rd = ω_rn + w ω_d and
    ζ_rd = ζ_rn + w (ζ_rdth − ζ_rn) with the weight w of `notch_weight` (at w = 0 poles and zeros are equal: no filter,
    hence no step at the trapezoid's feet).

    The filter runs in transposed direct form II and starts DC-consistent, s₂ = (b₂ − a₂) ū, s₁ = (b₁ − a₁) ū + s₂: as
    if the low-passed torque ū had stood there for ever. Its high-frequency gain is (ω_rd/ω_rn)² > 1, so any other start
    would kick the arm.

    Args:
        c: The filter's parameters.
        s: The filter's memory; changed in place.
        period_s: Sampling time.
        speed_rad_s: Measured motor speed, behind the velocity low-pass.
        u: Torque command of the PI, in N·m.

    Returns:
        The filtered torque command in N·m.
    """
    s.mean_nm += lowpass_blend(START_LOWPASS_HZ, period_s) * (u - s.mean_nm)
    if c.mode == NOTCH_FIXED:
        return float(_fixed_step(c, s, u))
    s.speed_rps += lowpass_blend(c.speed_lowpass_hz, period_s) * (abs(speed_rad_s) / (2.0 * math.pi) - s.speed_rps)
    f_m = s.speed_rps
    was_active = s.active != 0
    margin = c.hysteresis_rps if was_active else 0.0
    if c.mode == NOTCH_OFF or not c.start_rps - margin <= f_m <= c.end_rps + margin:
        s.active = 0
        return u
    weight = notch_weight(c.mode, f_m, c.start_rps, c.end_rps, c.ramp_rps)
    zero_hz = c.order * f_m
    s.frequency_hz = zero_hz
    s.zeta_rd = c.zeta_rn + weight * (c.zeta_rdth - c.zeta_rn)
    b0, b1, b2, a1, a2 = notch_coefficients(zero_hz, zero_hz + weight * c.offset_hz, c.zeta_rn, s.zeta_rd, period_s)
    if not was_active:
        s.s2 = (b2 - a2) * s.mean_nm
        s.s1 = (b1 - a1) * s.mean_nm + s.s2
        s.active = 1
    y = b0 * u + s.s1
    s.s1 = b1 * u - a1 * y + s.s2
    s.s2 = b2 * u - a2 * y
    return float(y)
