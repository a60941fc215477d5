"""Margins of a loop over motor speeds and plants, for searches."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.control.arrays import Complex, Real
from hil.control.notch import NOTCH_OFF, NOTCH_SWITCHED, Notch
from hil.core.library import CORE
from hil.design.frequency import Loop

_COMPLEX = CORE.dtype("complex_real")
FINE_BAND = (0.33, 2.7)
"""Accuracy: band in which filters act, and loops are computed finely, in units of f_a of the arm on its gear: a factor of 2
changes M_s of Table 3 by 0.004 %."""


@dataclass(frozen=True)
class SpeedMargins:
    """Margins over plants and speeds; every array has the shape (plants, speeds).

    Attributes:
        speeds_rps: Motor speeds; shape (speeds,).
        gain_margin_db: Gain margin, up or down; inf where the phase never crosses −180°.
        phase_margin_deg: Phase margin, up or down; 180 where |L| never crosses 1.
        turns: Turns of 1 + L round 0 against the loop without filters: not 0 where a filter, whose own poles are stable, has
            made a stable loop unstable.
    """

    speeds_rps: Real
    sensitivity_peak: Real
    gain_margin_db: Real
    phase_margin_deg: Real
    turns: Real


def widened(notch: Notch) -> Notch:
    """Widen the range of a filter by its hysteresis."""
    if notch.mode != NOTCH_SWITCHED:
        return notch
    h = notch.hysteresis_rps
    return replace(notch, start_rps=notch.start_rps - h, end_rps=notch.end_rps + h, hysteresis_rps=0.0)


class OpenLoops:
    """Open loops of one law around several plants, by their responses.

    Attributes:
        law: The loop that has gains, sampling time and delay; its plant does not count here.
    """

    def __init__(self, law: Loop, frequency_hz: Real, bare: Complex) -> None:
        """Keep the responses.

        Args:
            law: The loop, without filters.
            frequency_hz: Frequencies, rising; shape (m,).
            bare: Open loops without filters; shape (plants, m).
        """
        self.law = law
        self._delay = np.exp(-2j * math.pi * frequency_hz * law.period_s)
        self._bare = np.array(bare, dtype=np.complex128)

    def margins(self, notches: Sequence[Notch], speeds_rps: Real) -> SpeedMargins:
        """Compute the margins with the filters frozen at each speed."""
        filters = replace(self.law, notches=tuple(widened(notch) for notch in notches if notch.mode != NOTCH_OFF))
        width = max(1, len(filters.notches))
        coefficients = np.zeros((len(speeds_rps), width, 5))
        coefficients[:, :, 0] = 1.0  # no filter: y = u
        for row, speed in enumerate(speeds_rps):
            for column, values in enumerate(filters.filters(float(speed))):
                coefficients[row, column] = values
        plants, count = self._bare.shape
        out, room = np.zeros((plants, len(speeds_rps), CORE.call.MARGIN_COLUMNS)), np.empty(count, np.complex128)
        delay, bare, response = (CORE.pointer(each.view(_COMPLEX), "complex_real") for each in (self._delay, self._bare, room))
        CORE.call.scan_margins(
            delay, bare, count, plants, CORE.pointer(coefficients), len(speeds_rps), width, response, CORE.pointer(out)
        )
        return SpeedMargins(np.asarray(speeds_rps), out[:, :, 0], out[:, :, 1], out[:, :, 2], out[:, :, 3])


def looked_at_hz(dips_hz: Sequence[float], period_s: float, step: float, high_hz: float = math.inf) -> Real:
    """Choose the frequencies at which loops are computed.

    Args:
        dips_hz: Resonances of the plants with the motor held; the first gives the step.
        step: Step in units of the first.
        high_hz: Frequency up to which it is fine at most.
    """
    low_hz, high_hz = FINE_BAND[0] * min(dips_hz), min(FINE_BAND[1] * max(dips_hz), 0.45 / period_s, high_hz)
    fine = np.arange(low_hz, high_hz, step * dips_hz[0])
    coarse = np.geomspace(dips_hz[0] / 24.0, 0.49 / period_s, round(1.125 / step))
    return np.unique(np.concatenate([coarse, fine]))


class LoopFamily(OpenLoops):
    """Loops with equal gains around several plants.

    Attributes:
        loops: Loops without filters, one per plant.
    """

    def __init__(self, loops: Sequence[Loop], step: float = 1.0 / 320.0) -> None:
        """Compute the open loops.

        Args:
            step: Frequency step in the band of the filters in units of f_a; 1/320 gives M_s to 0.005, the phase margin to 0.5°.

        Raises:
            ValueError: There is no loop, or the loops have different periods.
        """
        if not loops or len({loop.period_s for loop in loops}) != 1:
            raise ValueError("the loops need one common sampling period, and at least one loop is needed")
        self.loops = [replace(loop, notches=()) for loop in loops]
        frequency = looked_at_hz([loop.plant.antiresonance_hz for loop in self.loops], self.loops[0].period_s, step)
        super().__init__(self.loops[0], frequency, np.array([loop.open_loop(frequency) for loop in self.loops]))

    def gain_on_the_line(self, notches: Sequence[Notch], order: float, speeds_rps: Real) -> Real:
        """Gain |X| = |θ_l/θ_sync| at k f_m, for every plant and speed.

        Filters are frozen at each speed; shape (plants, speeds).
        """
        line = order * np.asarray(speeds_rps, dtype=np.float64)
        base = self.loops[0]
        filters = replace(base, notches=tuple(widened(notch) for notch in notches if notch.mode != NOTCH_OFF))
        law = base.controller(line)
        if filters.notches:
            law = law * np.array(
                [filters.notch_response(np.array([f]), float(v))[0] for f, v in zip(line, speeds_rps, strict=True)]
            )
        gains = []
        for loop in self.loops:
            a, b, c = loop.plant.terms(2j * math.pi * line)
            m = loop.plant.reduction_ratio**2 * (a + law)
            gains.append(np.abs(c * m / (m * (b + c) + b * c)))
        return np.array(gains)
