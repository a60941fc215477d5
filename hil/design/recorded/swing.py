"""Swing of a joint behind its gear.

An arm on a spring moves wider than its gear drives it, and more so at higher speed.

Behind a motor at f_m order k passes with k f_m. Well below the arm's resonance f_a two encoders see it wider by
1/(1 − (k f_m/f_a)²) ≈ 1 + c (k f_m)² with c = 1/f_a². At one speed this looks like a larger error; where the
speed changes the recording can.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hil.control.arrays import Real
from hil.design.estimation import FAR_SIGMAS
from hil.design.recorded.fit import AngleSection, fit_section, waves_of_angle

TOLD_WITHIN = 0.1
"""Probability: standard error of c (k f_m)² at its largest from which the swing is told from a larger error."""
LARGEST_SWING = 0.3
"""Accuracy: c (k f_m)² up to which the first order of the swing holds: the second is a tenth."""


@dataclass(frozen=True)
class JointSwing:
    """Swing as recordings show it.

    Attributes:
        per_hz2: c = 1/f_a² in s².
        highest_hz: Highest frequency k f_m with which an order passed.
    """

    per_hz2: float
    error_per_hz2: float
    highest_hz: float

    @property
    def is_told(self) -> bool:
        """True if the recordings separate the swing from a larger error."""
        at_most = self.highest_hz**2
        return (
            self.error_per_hz2 * at_most < TOLD_WITHIN
            and -FAR_SIGMAS * self.error_per_hz2 < self.per_hz2 < LARGEST_SWING / at_most
        )


def swung_waves(angle_rad: Real, speed_rps: Real, per_hz2: float) -> Callable[[Sequence[float]], Real]:
    """Waves of a joint's angle with the swing of the arm.

    The angle is wider by 1 + c (k f_m)².

    Args:
        angle_rad: Motor angle; shape (n,).
        speed_rps: Motor speed f_m in rev/s; shape (n,).
        per_hz2: c in s².
    """
    plain = waves_of_angle(angle_rad)

    def waves(orders: Sequence[float]) -> Real:
        wider = [1.0 + per_hz2 * (k * speed_rps) ** 2 for k in orders for _ in range(2)]
        return plain(orders) * np.column_stack(wider)

    return waves


def swing_of(
    sections_at: Sequence[Callable[[float], AngleSection]], orders: Sequence[float], highest_hz: float
) -> JointSwing | None:
    """Estimate the swing that some stretches show together.

    Returns None if no stretch can be fitted.

    Each is fitted with one column more, what c = 1 s² changes of the waves without swing. Those are not known before c: a fit
    without the column takes the swing for a larger error, and would state c as many times too small. So the column is made of
    the waves of the last fit, until they stay. The standard error of c is that of the blocks, as for all unknowns.

    Args:
        sections_at: Each stretch for a swing c in s².
        highest_hz: Highest frequency k f_m with which an order passed.
    """
    found, weights = [], []
    for section_at in sections_at:
        plain, swung = section_at(0.0), section_at(1.0)
        wider = swung.waves(orders) - plain.waves(orders)
        try:
            unknowns = fit_section(plain, orders, repeats=0).unknowns
            for _ in range(2):  # a swing that reaches 64 % is 16 % too small without, and right to 0.03 % after two rounds
                unknowns = fit_section(_with_column(plain, wider @ unknowns), orders, repeats=0).unknowns[:-1]
            fit = fit_section(_with_column(plain, wider @ unknowns), orders)
        except ValueError:  # too few samples for them
            continue
        variance = float(fit.covariance[-1, -1])
        if variance > 0.0:
            found.append(float(fit.unknowns[-1]))
            weights.append(1.0 / variance)
    if not found:
        return None
    return JointSwing(float(np.average(found, weights=weights)), 1.0 / math.sqrt(sum(weights)), highest_hz)


def _with_column(section: AngleSection, column: Real) -> AngleSection:
    return AngleSection(section.angle_rad, section.signal, lambda orders: np.column_stack([section.waves(orders), column]))
