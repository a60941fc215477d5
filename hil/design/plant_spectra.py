"""Spectra of a periodic excitation and of the responses to it.

Each period has its own spectrum; slow drifts by gravity and the orders of the transmission error are removed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.control.arrays import Complex, Real

Lines = NDArray[np.int64]

TREND_ORDER = 4
"""Accuracy: degree of what is slow, a polynomial of the time, gravity along the way and the ramp itself: 3 and 6 change 0.04."""


@dataclass(frozen=True)
class Stretch:
    """Whole periods at constant speed, in one direction, one row per SYNC.

    Attributes:
        excitation: The excitation that was sent: N·m, or rad for a reference; shape (n,).
        angle_rad: Motor angle less the bias motion; shape (n,).
        torque_nm: The torque that the drive reported; shape (n,).
        tip_m_s2: Tip acceleration; shape (n,); None without accelerometer.
        orders_hz: Frequencies of the transmission error's orders at this speed, none on a line (`quiet_bias_rps`).
        wave: Number of the excitation's wave.
    """

    excitation: Real
    angle_rad: Real
    torque_nm: Real
    tip_m_s2: Real | None
    orders_hz: tuple[float, ...] = ()
    wave: int = 0


@dataclass(frozen=True)
class Spectra:
    """Spectra on the excited lines, one per period.

    All but the frequency have the shape (periods, lines).

    Attributes:
        frequency_hz: Frequencies of the lines; shape (lines,).
        excitation: Spectra D of the excitation.
        angle: Spectra Y of the motor angle.
        torque: Spectra U of the torque.
        tip: Spectra A of the tip acceleration; None without accelerometer.
        waves: Number of the excitation's wave in each period; shape (periods,); None where all have the same.
    """

    frequency_hz: Real
    excitation: Complex
    angle: Complex
    torque: Complex
    tip: Complex | None
    waves: Lines | None = None

    @property
    def periods(self) -> int:
        """Number of periods."""
        return len(self.angle)


def spectra(stretches: Sequence[Stretch], samples: int, lines: Lines, sync_s: float) -> Spectra:
    """Compute the spectra of the periods of some stretches.

    A drift, and a wave of an order of the transmission error, differ from the periodic signal in that they change from period to
    period, so their removal leaves the signal whole. Over all periods of a stretch the waves sum to nothing; from one to the
    next they would look like noise of the mean.

    What follows another wave of the excitation is turned and scaled to what it would be under the first.

    Args:
        stretches: Stretches of whole periods.
        lines: Excited bins; shape (m,).

    Raises:
        ValueError: A stretch is not a whole number of periods, or only one.
    """
    names = ("excitation", "angle_rad", "torque_nm", "tip_m_s2")
    by_name: dict[str, list[Complex] | None] = {name: [] for name in names}
    for stretch in stretches:
        for name in names:
            values, periods = getattr(stretch, name), by_name[name]
            if values is None or periods is None:
                by_name[name] = None
                continue
            if len(values) % samples or len(values) < 2 * samples:
                raise ValueError(
                    f"{len(values)} rows are not a whole number of periods of {samples} rows; at least two periods are needed"
                )
            steady = values.reshape(-1, samples)
            if name != "excitation":
                steady = _without_changes(steady, sync_s, stretch.orders_hz)
            periods.append(np.fft.rfft(steady, axis=1)[:, lines] * (2.0 / samples))
    waves = np.repeat([stretch.wave for stretch in stretches], [len(stretch.angle_rad) // samples for stretch in stretches])
    whole = {name: None if periods is None else np.concatenate(periods) for name, periods in by_name.items()}
    frequency = lines / (samples * sync_s)
    excitation, angle, torque = whole["excitation"], whole["angle_rad"], whole["torque_nm"]
    if excitation is None or angle is None or torque is None:
        raise ValueError("excitation, angle and torque are needed")
    tip = whole["tip_m_s2"]
    if np.all(waves == waves[0]):
        return Spectra(frequency, excitation, angle, torque, tip)
    turn = excitation[0] / excitation
    return Spectra(frequency, turn * excitation, turn * angle, turn * torque, None if tip is None else turn * tip, waves)


def _without_changes(rows: Real, sync_s: float, orders_hz: Sequence[float]) -> Real:
    """Subtract a polynomial of the time, and waves, from rows of periods."""
    periods, samples = rows.shape
    time = np.linspace(-1.0, 1.0, periods * samples)
    phase = 2.0 * np.pi * sync_s * np.outer(np.arange(periods * samples), orders_hz)
    basis = np.hstack([np.stack([time**power for power in range(1, TREND_ORDER + 1)], axis=1), np.cos(phase), np.sin(phase)])
    per_period = basis.reshape(periods, samples, -1)
    changing = (per_period - per_period.mean(axis=0)).reshape(periods * samples, -1)
    wanted = (rows - rows.mean(axis=0)).ravel()
    coefficients = np.linalg.lstsq(changing, wanted, rcond=None)[0]
    return np.asarray(rows - (basis @ coefficients).reshape(periods, samples))
