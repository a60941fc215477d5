"""Parameters of the variable notch filter and of a fixed filter.

`notch.h` has the filters themselves.
"""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.core.library import CORE

NOTCH_OFF: int = CORE.call.NOTCH_OFF
NOTCH_SWITCHED: int = CORE.call.NOTCH_SWITCHED
NOTCH_TRAPEZOID: int = CORE.call.NOTCH_TRAPEZOID
"""ζ_rd over the motor speed: no filter; ζ_rdth inside [f_s, f_e]; a trapezoid that rises and falls over `ramp_rps`."""

NOTCH_FIXED: int = CORE.call.NOTCH_FIXED
"""Mode of a second-order section with given coefficients at every speed, as drives without the variable notch have it."""

NOTCHES: int = CORE.call.NOTCHES
"""Filters per axis, in series: one per harmonic order of the transmission error."""


NOTCH_CONFIG, NOTCH_STATE = CORE.dtype("notch_config"), CORE.dtype("notch_state")


@dataclass(frozen=True)
class Notch:
    """Variable notch filter of one harmonic order k.

    Eq. (6), (7) and Table 3 of the paper.

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
            raise ValueError(f"notch mode {self.mode}; expected 0 (off), 1 (switched) or 2 (trapezoid)")
        if not 1 <= self.order <= 8:
            raise ValueError(f"notch order {self.order} is not within 1 … 8")
        if not 0.0 < self.start_rps < self.end_rps:
            raise ValueError(f"notch range {self.start_rps} … {self.end_rps} rev/s; expected a start above 0 and a larger end")
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
    """Filter with fixed coefficients.

    y_n = b₀ u_n + b₁ u_{n−1} + b₂ u_{n−2} − a₁ y_{n−1} − a₂ y_{n−2}

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


def notch_coefficients(
    zero_hz: float, pole_hz: float, zeta_rn: float, zeta_rd: float, period_s: float
) -> tuple[float, float, float, float, float]:
    """Return the coefficients b₀, b₁, b₂, a₁, a₂ of the notch.

    They follow by the bilinear transform without prewarping.

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
    found = np.empty(5)
    CORE.call.notch_coefficients(zero_hz, pole_hz, zeta_rn, zeta_rd, period_s, CORE.pointer(found))
    b0, b1, b2, a1, a2 = found.tolist()
    return b0, b1, b2, a1, a2


def notch_weight(mode: int, speed_rps: float, start_rps: float, end_rps: float, ramp_rps: float) -> float:
    """Return the weight of the filter at a speed, 0 … 1.

    It is always 1 for a switched filter, and the height of the trapezoid for one with slopes.

    Args:
        mode: `NOTCH_SWITCHED` or `NOTCH_TRAPEZOID`.
        speed_rps: f_m.
        start_rps: f_s.
        end_rps: f_e.
        ramp_rps: Width of either slope.
    """
    return float(CORE.call.notch_weight(mode, speed_rps, start_rps, end_rps, ramp_rps))
